"""Read and write parameter files: Mission Planner's .param, MAVProxy's .parm, QGroundControl's .params.

| suffix | a line | comment |
|---|---|---|
| .param | NAME,VALUE | # |
| .parm | NAME VALUE | # |
| .params | system TAB component TAB NAME TAB VALUE TAB type | # |
"""

from __future__ import annotations

import math
import re
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Literal

import numpy as np

from mavcompass.enums import MavParamType
from mavcompass.errors import UsageError
from mavcompass.files import read_text, write_text

Form = Literal["param", "parm", "params"]
FORMS: tuple[Form, ...] = ("param", "parm", "params")

_NAME = re.compile(r"[A-Za-z][A-Za-z0-9_]{0,15}")


def parameter_form(path: Path) -> Form:
    """Tell a parameter file's form from its suffix; raises UsageError for any other."""
    for form in FORMS:
        if path.suffix.lower() == f".{form}":
            return form
    raise UsageError(
        f"{path.name} does not say in which form the parameters are wanted.",
        "Name it .param (Mission Planner), .parm (MAVProxy) or .params (QGroundControl).",
    )


def read_parameter_file(path: Path) -> dict[str, float]:
    """Read the parameters of a file; see `parse_parameters` and `read_parameter_text`."""
    return parse_parameters(read_parameter_text(path), str(path))


def read_parameter_text(path: Path) -> str:
    """Read a parameter file of any of the three forms, whatever its suffix. Raises UsageError for none."""
    try:
        return read_text(path, "utf-8-sig")
    except OSError as error:
        raise UsageError(f"{path} cannot be read ({error.strerror}).", "Check the path.") from error
    except UnicodeDecodeError as error:
        raise UsageError(f"{path} is not a text file.", "Give a .param, .parm or .params file.") from error


def parse_parameters(text: str, origin: str = "the parameter file") -> dict[str, float]:
    """Read parameters from a text of any of the three forms; `origin` names it in errors.

    Raises UsageError, with the line's number, for what is not a parameter, and for a name that comes
    twice with different values.
    """
    values: dict[str, float] = {}
    lines: dict[str, int] = {}
    for number, line in enumerate(text.splitlines(), start=1):
        fields = [field for field in re.split(r"[,\s]+", line.partition("#")[0].strip()) if field]
        if not fields:
            continue
        name, value = _entry(fields, f"{origin}, line {number}")
        if name in values and values[name] != value:
            raise UsageError(
                f"{origin}, line {number}: {name} is {value:g} here and {values[name]:g} in line"
                f" {lines[name]}.",
                "Leave one of the two lines.",
            )
        values[name], lines[name] = value, number
    if not values:
        raise UsageError(f"{origin} holds no parameters.", "Give a .param, .parm or .params file.")
    return values


def _entry(fields: Sequence[str], where: str) -> tuple[str, float]:
    if len(fields) == 5 and fields[0].isdigit() and fields[1].isdigit():
        name, text = fields[2], fields[3]
    elif len(fields) == 2:
        name, text = fields
    else:
        raise UsageError(
            f"{where}: {' '.join(fields)!r} is not a parameter.",
            "A line is NAME,VALUE or NAME VALUE, or QGroundControl's five columns.",
        )
    if not _NAME.fullmatch(name):
        raise UsageError(
            f"{where}: {name!r} is not a parameter's name.",
            "A name has up to 16 letters, digits and underscores.",
        )
    try:
        value = float(text)
    except ValueError:
        raise UsageError(f"{where}: {text!r} is not a number.", f"Correct the value of {name}.") from None
    if not math.isfinite(value):
        raise UsageError(f"{where}: {name} is {text}, which no vehicle can hold.", "Correct the value.")
    return name, value


def write_parameter_file(
    path: Path,
    values: Mapping[str, float],
    comment: Sequence[str] = (),
    types: Mapping[str, int] | None = None,
) -> None:
    """Write parameters in the form that the suffix names, comment lines first.

    `types` are MAV_PARAM_TYPE numbers by name, which only .params holds (default: a 32-bit float).
    Raises UsageError for another suffix and where the file cannot be written.
    """
    write_text(path, parameter_text(values, parameter_form(path), comment, types), "The parameters")


def parameter_text(
    values: Mapping[str, float],
    form: Form = "param",
    comment: Sequence[str] = (),
    types: Mapping[str, int] | None = None,
) -> str:
    """Spell parameters as the text of a parameter file; see `write_parameter_file`."""
    lines = [f"# {line}" for line in comment]
    for name, value in values.items():
        number = format_value(value)
        if form == "params":
            kind = (types or {}).get(name, MavParamType.REAL32)
            lines.append(f"1\t1\t{name}\t{number}\t{int(kind)}")
        else:
            lines.append(f"{name},{number}" if form == "param" else f"{name:<16} {number}")
    return "\n".join(lines) + "\n"


def format_value(value: float) -> str:
    """Spell a value so that reading it back gives the same 32-bit float, whole numbers without a point."""
    if value == int(value) and abs(value) < 2**31:
        return str(int(value))
    return np.format_float_positional(np.float32(value), unique=True, trim="0")
