"""The checksum of many MAVLink frames at once: CRC-16/MCRF4XX as table look-ups on columns of bytes.

A CRC is affine over GF(2): it is the exclusive-or of one term per byte, which depends on the byte's
distance from the end alone, and of a term for the start value, which depends on the length alone. So
bytes of the same distance from the end are handled together for all frames, and zeros before a frame
change nothing: frames of different lengths go together when their ends are in line.
"""

from __future__ import annotations

from functools import cache

import numpy as np
from numpy.typing import NDArray

_POLYNOMIAL = 0x8408  # x^16 + x^12 + x^5 + 1, least significant bit first
_START = 0xFFFF
_LONGEST = 280

UInt16Array = NDArray[np.uint16]


@cache
def _byte_terms() -> UInt16Array:
    """Return (distance from the end, byte value) -> its term of the CRC; distance 0 is the last byte."""
    terms = np.arange(256, dtype=np.uint16)
    for _ in range(8):
        terms = (terms >> np.uint16(1)) ^ (terms & np.uint16(1)) * np.uint16(_POLYNOMIAL)
    table = np.empty((_LONGEST, 256), dtype=np.uint16)
    table[0] = terms
    for distance in range(1, _LONGEST):
        before = table[distance - 1]
        table[distance] = terms[before & 0xFF] ^ (before >> 8)
    return table


@cache
def _start_terms() -> UInt16Array:
    """Return length -> what the start value leaves in the CRC after so many bytes."""
    step = _byte_terms()[0]
    out = np.empty(_LONGEST + 1, dtype=np.uint16)
    out[0] = _START
    for length in range(1, _LONGEST + 1):
        before = int(out[length - 1])
        out[length] = int(step[before & 0xFF]) ^ (before >> 8)
    return out


def checksums(
    columns: NDArray[np.uint8], lengths: NDArray[np.intp], crc_extras: NDArray[np.uint8]
) -> UInt16Array:
    """Compute the checksums of N frames.

    `columns` (W, N) holds one frame in each column, ends in line, zeros before the shorter ones;
    `lengths` (N,) are the bytes from the length byte to the payload's end, `crc_extras` (N,) the
    messages' extra bytes, which follow each frame's end.
    """
    terms = _byte_terms()
    crc = _start_terms()[lengths + 1]
    crc ^= terms[0].take(crc_extras)
    width = columns.shape[0]
    for row in range(width):
        crc ^= terms[width - row].take(columns[row])
    return crc
