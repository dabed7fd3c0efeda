"""The bits of a 32-bit float that is no number but four bytes of something else.

PX4 puts a whole-number parameter into the place of PARAM_VALUE's float. Many whole numbers are NaNs there, -1
and its neighbours among them, and a processor's conversion between 32 and 64 bits alters the signalling ones.
A float of 64 bits has room for all 32: here such a NaN keeps its payload.
"""

from __future__ import annotations

import math
import struct

from mavcompass.enums import MavParamType

# Where the bytes of each kind of whole number lie among a float's four.
INTEGER_FORMATS: dict[int, str] = {
    MavParamType.UINT8: "<Bxxx",
    MavParamType.INT8: "<bxxx",
    MavParamType.UINT16: "<Hxx",
    MavParamType.INT16: "<hxx",
    MavParamType.UINT32: "<I",
    MavParamType.INT32: "<i",
}
_SINGLE_EXPONENT, _SINGLE_PAYLOAD = 0x7F800000, 0x007FFFFF
_DOUBLE_EXPONENT, _PAYLOAD_SHIFT, _SIGN_SHIFT = 0x7FF0000000000000, 29, 32
_SINGLE_SIGN = 0x80000000


def single_from_bits(bits: int) -> float:
    """Return the float whose 32-bit form these bits (0 to 2^32 - 1) are.

    >>> single_from_bits(0x40490FDB)
    3.1415927410125732
    """
    payload = bits & _SINGLE_PAYLOAD
    if bits & _SINGLE_EXPONENT != _SINGLE_EXPONENT or not payload:
        (number,) = struct.unpack("<f", struct.pack("<I", bits))
        return float(number)
    wide = (bits & _SINGLE_SIGN) << _SIGN_SHIFT | _DOUBLE_EXPONENT | payload << _PAYLOAD_SHIFT
    (number,) = struct.unpack("<d", struct.pack("<Q", wide))
    return float(number)


def bits_of_single(value: float) -> int:
    """Return the bits (0 to 2^32 - 1) of a float's 32-bit form.

    >>> hex(bits_of_single(single_from_bits(0x7F800001)))
    '0x7f800001'
    """
    if not math.isnan(value):
        (bits,) = struct.unpack("<I", struct.pack("<f", value))
        return int(bits)
    (wide,) = struct.unpack("<Q", struct.pack("<d", value))
    payload = wide >> _PAYLOAD_SHIFT & _SINGLE_PAYLOAD
    return wide >> _SIGN_SHIFT & _SINGLE_SIGN | _SINGLE_EXPONENT | payload


def number_told(value: float, kind: int) -> float:
    """Return what PARAM_VALUE's float tells where integers travel as their bytes; `kind` is a MAV_PARAM_TYPE.

    >>> number_told(single_from_bits(0xFFFFFFFF), MavParamType.INT32)
    -1.0
    """
    form = INTEGER_FORMATS.get(kind)
    if form is None:
        return value
    (whole,) = struct.unpack(form, struct.pack("<I", bits_of_single(value)))
    return float(whole)
