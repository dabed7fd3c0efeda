"""Read a Track CSV: any subset of the columns, empty for missing.

A file says nothing of how its numbers were made: whole milligauss, milli-g and milliradians are MAVLink's,
cut toward zero. Whole numbers of which all steps occur are a format's resolution, whatever the sensor's.
Cutting toward zero makes the step about zero twice as wide as the others.
"""

from __future__ import annotations

import csv
import io
import math
from collections import Counter
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TextIO

import numpy as np
from numpy.typing import NDArray

from mavcompass.correction import IDENTITY
from mavcompass.errors import BadRecording
from mavcompass.frames import FloatArray
from mavcompass.logs.common.chunks import MOST_LINE, GrowingArray
from mavcompass.logs.common.samples import finite_series
from mavcompass.track import InForce, MagSeries, Series, Track
from mavcompass.units import STANDARD_GRAVITY_MPS2

_AXES = ("x", "y", "z")
MOTORS = tuple(f"motor{n}" for n in range(1, 9))
# Quantity of the Track -> its columns in the file, in their order.
VECTORS: dict[str, tuple[str, ...]] = {
    "mag": tuple(f"mag_{a}_mgauss" for a in _AXES),
    "acc_mps2": tuple(f"acc_{a}_mps2" for a in _AXES),
    "gyro_radps": tuple(f"gyro_{a}_radps" for a in _AXES),
    "reference_q": ("ref_qw", "ref_qx", "ref_qy", "ref_qz"),
    "attitude_rad": ("roll_rad", "pitch_rad", "yaw_rad"),
    "position_ned_m": ("pos_n_m", "pos_e_m", "pos_d_m"),
    "place": ("lat_deg", "lon_deg", "alt_m"),
}
SCALARS: dict[str, str] = {
    "gps_yaw_rad": "gps_yaw_rad",
    "current_a": "current_a",
    "voltage_v": "voltage_v",
    "throttle": "throttle",
    "temperature_degc": "temperature_degc",
}
TIME = "time_s"
KNOWN = {TIME, *MOTORS, *SCALARS.values(), *(name for names in VECTORS.values() for name in names)}


# More damage than that is no damage: it is a file of another kind, or of another writing of numbers.
_MOST_BAD_LINES = 0.1
# A logger has some hundreds.
_MOST_COLUMNS, _MOST_TOLD = 2000, 10
_PIECE = 1 << 20
_REMEDY = (
    "See the Track CSV columns in the documentation: time_s, mag_x_mgauss, mag_y_mgauss, mag_z_mgauss, ..."
)


@dataclass(frozen=True, slots=True, eq=False)
class _Table:
    header: tuple[str, ...]
    values: FloatArray
    notes: tuple[str, ...] = ()

    def columns(self, names: Sequence[str]) -> FloatArray | None:
        """Return the named columns, (N, k) with contiguous columns; None where one is not in the file."""
        if any(name not in self.header for name in names):
            return None
        return np.asfortranarray(self.values[:, [self.header.index(name) for name in names]])


def read_track_csv(path: Path) -> Track:
    """Read a Track CSV. Rows that lack a quantity do not appear in that quantity's series.

    The file holds one compass, as its numbers are: without a correction inside. Whole milligauss count as
    the format's resolution. Raises BadRecording, with the line, for what cannot be read.
    """
    table = _read_table(path)
    time_s, sorting = _times(table, path)
    found: dict[str, Series] = {}
    for quantity, names in VECTORS.items():
        some = [name for name in names if name in table.header]
        if some and len(some) < len(names):
            missing = ", ".join(name for name in names if name not in some)
            raise BadRecording(f"{path} has {', '.join(some)} but not {missing}.", _REMEDY)
        _add(found, quantity, time_s, table.columns(names))
    for quantity, name in SCALARS.items():
        _add(found, quantity, time_s, table.columns([name]), scalar=True)
    _add(found, "motors", time_s, table.columns([name for name in MOTORS if name in table.header]))
    reported = found.pop("mag", None)
    if reported is None:
        raise BadRecording(
            f"{path} holds no magnetometer: no row has all of {', '.join(VECTORS['mag'])}.", _REMEDY
        )
    steps = format_steps(reported, found.get("acc_mps2"), found.get("gyro_radps"))
    compass = MagSeries(
        1,
        reported,
        (InForce(-np.inf, IDENTITY),),
        quantum_mgauss=steps.field_mgauss,
        truncated=steps.cut and steps.field_mgauss > 0.0,
    )
    return Track(
        source=str(path),
        compasses={1: compass},
        acc_truncation_mps2=steps.force_mps2 if steps.cut else 0.0,
        gyro_truncation_radps=steps.rate_radps if steps.cut else 0.0,
        notes=(*table.notes, *sorting),
        **found,  # type: ignore[arg-type]
    )


def _times(table: _Table, path: Path) -> tuple[FloatArray, list[str]]:
    """Return the rows' times, and what to say of them."""
    time_s = table.values[:, table.header.index(TIME)]
    unknown = np.flatnonzero(~np.isfinite(time_s))
    if unknown.size:
        raise BadRecording(f"{path}, line {int(unknown[0]) + 2}: {TIME} is no time.", "Correct that line.")
    sorting = bool((np.diff(time_s) < 0.0).any())
    return time_s, ["The rows were not in order of time; they were sorted."] if sorting else []


def _add(
    found: dict[str, Series],
    quantity: str,
    time_s: FloatArray,
    values: FloatArray | None,
    *,
    scalar: bool = False,
) -> None:
    if values is None or not values.shape[1]:
        return
    series = finite_series(time_s, values[:, 0] if scalar else values)
    if series is not None:
        found[quantity] = series


def _read_table(path: Path) -> _Table:
    """Read the columns that are known, a piece of the file at a time."""
    # A damaged byte costs its line, not the recording; universal newlines as in any text file.
    with path.open(encoding="utf-8-sig", errors="replace") as file:
        first = file.readline(MOST_LINE + 1).rstrip("\n")
        if not first.isprintable() or "\ufffd" in first:
            raise BadRecording(f"{path} is not a text file with a header of column names.", _REMEDY)
        header = tuple(name.strip() for name in first.strip().split(","))
        if len(first) > MOST_LINE or len(header) > _MOST_COLUMNS:
            raise BadRecording(
                f"{path} has more than {_MOST_COLUMNS} columns, or names without end.", _REMEDY
            )
        repeated = next((name for name, count in Counter(header).items() if count > 1), None)
        if repeated is not None:
            raise BadRecording(f"{path} has the column {repeated or '(without a name)'} twice.", _REMEDY)
        if TIME not in header:
            raise BadRecording(f"{path} has no column {TIME}.", _REMEDY)
        body = _Body(path, header, path.stat().st_size)
        for number, text in _pieces(file, path):
            body.add(number, text)
    return body.table()


def _pieces(file: TextIO, path: Path) -> Iterator[tuple[int, str]]:
    """Cut the rows into pieces of whole lines; yield each with the number of its first line."""
    number = 2
    while piece := file.read(_PIECE):
        end = file.readline(MOST_LINE + 1)
        if len(end) > MOST_LINE or len(piece) - piece.rfind("\n") > MOST_LINE:
            raise BadRecording(
                f"{path} has a line of more than {MOST_LINE} letters near line {number}.", _REMEDY
            )
        yield number, piece + end
        number += piece.count("\n") + end.count("\n")


class _Body:
    """Collect the rows of a file of so many bytes: in bounded pieces, and only the columns that are known."""

    def __init__(self, path: Path, header: tuple[str, ...], size: int) -> None:
        self._path, self._header, self._left = path, header, size
        self._rows = 0
        self._kept = [place for place, name in enumerate(header) if name in KNOWN]
        self._values = GrowingArray(np.dtype(np.float64))
        self._bad = 0
        self._first_bad: BadRecording | None = None
        self._cut_off = False

    def add(self, number: int, text: str) -> None:
        """Parse a piece whose first line has this number."""
        if not text.endswith("\n"):  # the last, which may not have been written to its end
            before, newline, last = text.rpartition("\n")
            self._cut_off = bool(last) and last.count(",") + 1 < len(self._header)
            text = before + newline if self._cut_off else text
        values = _parse_quickly(text, len(self._header))
        if values is None:
            values = np.array(list(self._lines(number, text)), dtype=np.float64).reshape(
                -1, len(self._header)
            )
        self._values.append(values[:, self._kept].ravel())
        self._rows += len(values)
        self._left = max(self._left - len(text), 0)
        # A row has a letter at least, and a comma or the line's end for each column.
        self._refuse_damage(self._left // (len(self._header) + 1))

    def _refuse_damage(self, more: int) -> None:
        """Raise BadRecording where much is damaged, whatever the rows are that may still come."""
        if self._first_bad is not None and self._bad > _MOST_BAD_LINES * (self._rows + self._bad + more):
            raise self._first_bad

    def _lines(self, number: int, text: str) -> Iterator[list[float]]:
        """Parse what can be parsed line by line; those that cannot are left out and counted."""
        for line_number, line in enumerate(text.split("\n"), start=number):
            if line.strip():
                try:
                    yield _row(line, self._header, line_number, self._path)
                except BadRecording as error:
                    self._bad += 1
                    self._first_bad = self._first_bad or error

    def table(self) -> _Table:
        """Return what was read, refusing a file of which much is damaged."""
        names = tuple(self._header[place] for place in self._kept)
        values = self._values.finish().reshape(-1, max(len(names), 1))
        notes: tuple[str, ...] = ()
        self._refuse_damage(0)
        if self._first_bad is not None:
            notes += (f"{self._bad} damaged lines were left out. The first: {self._first_bad.what}",)
        if self._cut_off:
            notes = ("The last line is cut off; it was left out.", *notes)
        strange = [name for name in self._header if name not in KNOWN]
        return _Table(names, values, (*notes, *_passed_over(strange)))


def _passed_over(strange: Sequence[str]) -> list[str]:
    """Tell of columns that are not known."""
    told = [f"Column {name} is not one of a Track CSV and was passed over." for name in strange[:_MOST_TOLD]]
    return [*told, f"So were {len(strange) - _MOST_TOLD} more."] if len(strange) > _MOST_TOLD else told


def _parse_quickly(text: str, width: int) -> FloatArray | None:
    """Parse well-formed rows in one go; None where that fails, for the parser that knows the line."""
    if not text.strip() or text.startswith(",") or any(gap in text for gap in (",,", ",\n", "\n,")):
        return None
    try:
        values = np.loadtxt(io.StringIO(text), delimiter=",", ndmin=2, comments=None)
    except ValueError:
        return None
    return values if values.shape[1] == width else None


def _row(line: str, header: tuple[str, ...], number: int, path: Path) -> list[float]:
    try:
        fields = next(csv.reader([line]))
    except csv.Error as error:
        raise BadRecording(f"{path}, line {number}: {error}.", "Correct that line.") from None
    if len(fields) != len(header):
        raise BadRecording(
            f"{path}, line {number}: {len(fields)} fields where the header has {len(header)}.",
            "Correct that line, or cut the file before it.",
        )
    row = [_number(field, name, number, path) for field, name in zip(fields, header, strict=True)]
    if TIME in header and not np.isfinite(row[header.index(TIME)]):
        raise BadRecording(f"{path}, line {number}: {TIME} is missing.", "Give every row a time.")
    return row


def _number(field: str, name: str, line: int, path: Path) -> float:
    if not field.strip():
        return np.nan
    try:
        return float(field)
    except ValueError:
        if name not in KNOWN:
            return np.nan
        raise BadRecording(
            f"{path}, line {line}: {name} is {field[:40]!r}, which is no number.",
            "Correct it, or leave it empty for missing.",
        ) from None


FIELD_STEP_MGAUSS = 1.0
FORCE_STEP_MPS2 = 1e-3 * STANDARD_GRAVITY_MPS2
RATE_STEP_RADPS = 1e-3
_FEWEST_LEVELS = 6
# Numbers are printed with few decimals.
_NEAR = 0.02
_FEWEST_IN_A_STEP = 5
_WIDER = 1.5
_SURE = 4.0


@dataclass(frozen=True, slots=True)
class Steps:
    """Hold the steps of a format, 0 where a sensor's numbers have none of its own; `cut`: toward zero."""

    field_mgauss: float
    force_mps2: float
    rate_radps: float
    cut: bool


def format_steps(field: Series, force: Series | None, rate: Series | None) -> Steps:
    """Look for whole milligauss (N, 3), milli-g (N, 3) and milliradians per second (N, 3)."""
    found: list[float] = []
    columns: list[NDArray[np.int64]] = []
    usual = (FIELD_STEP_MGAUSS, FORCE_STEP_MPS2, RATE_STEP_RADPS)
    for series, step in zip((field, force, rate), usual, strict=True):
        whole = None if series is None else whole_steps(series.values, step)
        found.append(0.0 if whole is None else step)
        if whole is not None:
            columns.extend(whole.T)
    return Steps(found[0], found[1], found[2], cut_toward_zero(columns))


def whole_steps(values: FloatArray, step: float) -> NDArray[np.int64] | None:
    """Return values as whole numbers of a step; None where they are none, or of a coarser step."""
    counts = values / step
    whole = np.round(counts)
    if not np.isfinite(counts).all() or bool((np.abs(counts - whole) > _NEAR).any()):
        return None
    numbers = whole.astype(np.int64)
    levels = np.unique(numbers)
    if levels.size < _FEWEST_LEVELS or int(np.gcd.reduce(np.diff(levels))) != 1:
        return None
    return numbers


def cut_toward_zero(columns: Iterable[NDArray[np.int64]]) -> bool:
    """Tell by how often zero occurs beside its neighbours whether numbers were cut toward zero, not rounded.

    Rounded numbers, about zero, have logarithms of their counts on a parabola: n_0 = n_1 (n_1 / n_2)^(1/3).
    """
    seen, expected = 0.0, 0.0
    for column in columns:
        zero, one, two = (float(np.count_nonzero(np.abs(column) == k)) for k in range(3))
        if min(one, two) / 2.0 < _FEWEST_IN_A_STEP:
            continue
        seen += zero
        expected += 0.5 * one * max(one / two, 1.0) ** (1.0 / 3.0)
    return seen > _WIDER * expected and seen - expected > _SURE * math.sqrt(max(expected, 1.0))
