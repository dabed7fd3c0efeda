"""Read a Track CSV: any subset of the columns, empty for missing."""

from __future__ import annotations

import csv
import io
from collections import Counter
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TextIO

import numpy as np

from mavcompass.correction import IDENTITY
from mavcompass.errors import BadRecording
from mavcompass.frames import FloatArray
from mavcompass.logs.common.chunks import MOST_LINE, GrowingArray
from mavcompass.logs.common.samples import finite_series
from mavcompass.logs.formats.csv.columns import KNOWN, MOTORS, SCALARS, TIME, VECTORS
from mavcompass.logs.formats.csv.steps import format_steps
from mavcompass.track import InForce, MagSeries, Series, Track

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
