"""pymavlink's own programs, as installed, run in this process on a DataFlash log written from the case."""

from __future__ import annotations

import contextlib
import io
import os
import re
import runpy
import struct
import sys
import tempfile
from pathlib import Path

import numpy as np

from compassbench.cases import Case, columns
from compassbench.rivals import Refusal, Solution

READINGS = 200  # its minimisation is Python, reading by reading: --reduce is its own advice
FORMATS = {  # name: number, characters, struct's, columns
    "PARM": (1, "QNf", "<Q16sf", "TimeUS,Name,Value"),
    "GPS": (2, "QBLLf", "<QBiif", "TimeUS,Status,Lat,Lng,Alt"),
    "ATT": (3, "Qfff", "<Qfff", "TimeUS,Roll,Pitch,Yaw"),
    "BAT": (4, "Qf", "<Qf", "TimeUS,Curr"),
    "MAG": (5, "Qfffhhh", "<Qfffhhh", "TimeUS,MagX,MagY,MagZ,OfsX,OfsY,OfsZ"),
}
PARAMETERS = ("AHRS_EKF_TYPE", "AHRS_TRIM_X", "AHRS_TRIM_Y", "AHRS_TRIM_Z", "COMPASS_OFS_X")
_NUMBER = r"(-?\d+(?:\.\d+)?(?:e-?\d+)?)"
_VECTOR = rf"Vector3\({_NUMBER}, {_NUMBER}, {_NUMBER}\)"


def log_of(case: Case) -> bytes:
    """Write the case as ArduPilot's own log would hold it."""
    parts = []

    def add(name: str, *values: object) -> None:
        number, _, layout, _ = FORMATS[name]
        parts.append(bytes((0xA3, 0x95, number)) + struct.pack(layout, *values))

    describe = [(128, 89, b"FMT", b"BBnNZ", b"Type,Length,Name,Format,Columns")]
    for name, (number, characters, layout, names) in FORMATS.items():
        size = 3 + struct.calcsize(layout)
        describe.append((number, size, name.encode(), characters.encode(), names.encode()))
    for one in describe:
        parts.append(b"\xa3\x95\x80" + struct.pack("<BB4s16s64s", *one))
    for name in PARAMETERS:
        add("PARM", 0, name.encode(), 0.0)
    latitude, longitude, altitude = case.place
    add("GPS", 0, 3, round(latitude * 1e7), round(longitude * 1e7), altitude)
    sine, cosine = (columns(case.mag_time, case.time, f(case.attitude)) for f in (np.sin, np.cos))
    attitude = np.degrees(np.arctan2(sine, cosine))
    load = None if case.current is None else np.interp(case.mag_time, case.time, case.current)
    for k, (time_s, reading) in enumerate(zip(case.mag_time, case.mag, strict=True)):
        at = round(time_s * 1e6)
        add("ATT", at, *attitude[k])
        if load is not None:
            add("BAT", at, load[k])
        add("MAG", at, *reading, 0, 0, 0)
    return b"".join(parts)


def solve(case: Case, argument: str = "") -> Solution:
    """Run the program and read its last words."""
    program = Path(sys.executable).parent / argument
    said = io.StringIO()
    os.environ["MPLBACKEND"] = "Agg"
    with tempfile.TemporaryDirectory() as folder, contextlib.redirect_stdout(said):
        log = Path(folder) / "case.BIN"
        log.write_bytes(log_of(case))
        words = [str(program)]
        if argument == "magfit_WMM.py":
            words += ["--elliptical", "--reduce", str(max(len(case.mag) // READINGS, 1))]
            words += ["--cmot"] if case.current is not None else []
            words += ["--save-plot"]
        before, sys.argv = sys.argv, [*words, str(log)]
        try:
            runpy.run_path(str(program), run_name="__main__")
        except SystemExit:
            raise Refusal((said.getvalue().strip().splitlines() or ["nothing"])[-1]) from None
        finally:
            sys.argv = before
            if plots := sys.modules.get("matplotlib.pyplot"):
                plots.close("all")
    return read(said.getvalue())


def read(text: str) -> Solution:
    """Read the correction off what a program printed."""
    end = rf"New: {_VECTOR} diag: {_VECTOR} offdiag: {_VECTOR} .*?cmot: {_VECTOR} scale: {_NUMBER}"
    if (full := re.search(end, text, re.S)) is not None:
        n = np.array([float(v) for v in full.groups()])
        matrix = n[12] * np.array([[n[3], n[6], n[7]], [n[6], n[4], n[8]], [n[7], n[8], n[5]]])
        return Solution(n[:3], matrix, n[9:12])
    if (final := re.search(rf"Final\s*: {_VECTOR}", text)) is not None:
        return Solution(np.array([float(v) for v in final.groups()]))
    raise Refusal("it printed no correction")
