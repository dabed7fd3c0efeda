"""Parameter values as they travel: 32-bit floats, and integers in two dress codes."""

from __future__ import annotations

import math
import struct
from dataclasses import dataclass
from typing import Literal

import numpy as np

from mavcompass.enums import MavParamType
from mavcompass.messages import ParamSet, ParamValue
from mavcompass.messages.bits import INTEGER_FORMATS, number_told, single_from_bits
from mavcompass.procedure.script import Context

# ArduPilot sends an integer as the float of the same value; PX4 puts its four bytes into the float's place.
Encoding = Literal["cast", "bytewise"]


@dataclass(frozen=True, slots=True)
class Parameter:
    """Hold a parameter's value and its MAV_PARAM_TYPE, which a write must name."""

    value: float
    type: int = MavParamType.REAL32


def is_single(value: float) -> bool:
    """Tell whether a value is finite and fits the wire's 32-bit float."""
    return math.isfinite(value) and abs(value) <= float(np.finfo(np.float32).max)


def tidy(value: float) -> float:
    """Return the shortest decimal number with the same 32-bit float: 0.1 for 0.10000000149011612.

    A value that is not finite stays as it is, and so does the largest, whose decimal lies beyond it.
    """
    if not is_single(value):
        return value
    shortest = float(str(np.float32(value)))
    return shortest if is_single(shortest) else value


def same_value(left: float, right: float) -> bool:
    """Compare two values as the vehicle stores them, as 32-bit floats."""
    return is_single(left) and is_single(right) and bool(np.float32(left) == np.float32(right))


def holds(parameter: Parameter, wanted: float, encoding: Encoding) -> bool:
    """Tell whether a vehicle that answered with `parameter` stores `wanted`.

    Whole numbers that travel bit for bit must be the same; all others as 32-bit floats.
    """
    if encoding == "bytewise" and parameter.type in INTEGER_FORMATS:
        return parameter.value == wanted
    return same_value(parameter.value, wanted)


def decode(message: ParamValue, encoding: Encoding) -> Parameter:
    """Read a PARAM_VALUE; a 32-bit float becomes its shortest decimal."""
    if encoding == "bytewise" and message.param_type in INTEGER_FORMATS:
        return Parameter(number_told(message.param_value, message.param_type), message.param_type)
    return Parameter(tidy(message.param_value), message.param_type)


def encode(name: str, parameter: Parameter, encoding: Encoding, context: Context) -> ParamSet:
    """Build the PARAM_SET that writes a value."""
    value = parameter.value
    form = INTEGER_FORMATS.get(parameter.type) if encoding == "bytewise" else None
    if form is not None:
        (bits,) = struct.unpack("<I", struct.pack(form, round(value)))
        value = single_from_bits(bits)
    return ParamSet(context.system, context.component, name, value, parameter.type)
