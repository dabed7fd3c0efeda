"""The checksum of many MAVLink frames at once: CRC-16/MCRF4XX as table look-ups on columns of bytes.

A CRC is affine over GF(2): it is the exclusive-or of one term per byte, which depends on the byte's
distance from the end alone, and of a term for the start value, which depends on the length alone. So
bytes of the same distance from the end are handled together for all frames.
"""

from __future__ import annotations

from functools import cache

import numpy as np
from numpy.typing import NDArray

from mavcompass.logs.common import IntArray, windows

_POLYNOMIAL = 0x8408  # x^16 + x^12 + x^5 + 1, least significant bit first
_START = 0xFFFF
_LONGEST = 280
# From so many frames of one length on, a look-up for each column of bytes is the faster way.
_WORTH_COLUMNS = 400

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
    data: NDArray[np.uint8], ends: IntArray, lengths: IntArray, crc_extras: NDArray[np.uint8]
) -> UInt16Array:
    """Compute the checksums of N frames in `data`.

    `lengths` (N,) are the bytes of each from its length byte to its payload's end, `ends` (N,) the places
    after the payload's end, `crc_extras` (N,) the messages' extra bytes, which follow each payload.
    """
    crc = _start_terms()[lengths + 1]
    crc ^= _byte_terms()[0].take(crc_extras)
    counts = np.bincount(lengths)
    common = counts >= _WORTH_COLUMNS
    for length in np.flatnonzero(common).tolist():
        group = np.flatnonzero(lengths == length)
        crc[group] ^= _by_columns(windows(data, ends[group] - length, length))
    rest = np.flatnonzero(~common[lengths])
    if rest.size:
        crc[rest] ^= _byte_by_byte(data, ends[rest], lengths[rest])
    return crc


def _by_columns(frames: NDArray[np.uint8]) -> UInt16Array:
    """Add up the terms of many frames of one length, (N, length): one look-up for each column."""
    terms = _byte_terms()
    length = frames.shape[1]
    crc = np.zeros(len(frames), dtype=np.uint16)
    for row, column in enumerate(np.ascontiguousarray(frames.T)):
        crc ^= terms[length - row].take(column)
    return crc


def _byte_by_byte(data: NDArray[np.uint8], ends: IntArray, lengths: IntArray) -> UInt16Array:
    """Add up the terms of a few frames of any lengths: one look-up for all of their bytes."""
    total = np.cumsum(lengths)
    distance = np.repeat(total, lengths) - np.arange(int(total[-1]))  # 1 for the last byte of each
    place = np.repeat(ends, lengths) - distance
    terms = _byte_terms().ravel().take(distance * 256 + data[place])
    return np.asarray(np.bitwise_xor.reduceat(terms, total - lengths))
