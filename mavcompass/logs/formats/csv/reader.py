"""Read a Track CSV: any subset of the columns, empty for missing."""

from __future__ import annotations

import csv
import io
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from mavcompass.correction import IDENTITY
from mavcompass.errors import BadRecording
from mavcompass.frames import FloatArray
from mavcompass.logs.common import finite_series
from mavcompass.logs.formats.csv.columns import KNOWN, MOTORS, SCALARS, TIME, VECTORS
from mavcompass.logs.formats.csv.steps import format_steps
from mavcompass.track import InForce, MagSeries, Series, Track

# More damage than that is no damage: it is a file of another kind, or of another writing of numbers.
_MOST_BAD_LINES = 0.1
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
    if TIME not in table.header:
        raise BadRecording(f"{path} has no column {TIME}.", _REMEDY)
    notes = [
        *table.notes,
        *(f"Column {name} is not one of a Track CSV and was passed over." for name in _strange(table.header)),
    ]
    time_s = table.columns([TIME])[:, 0]  # type: ignore[index]
    table, time_s, sorting = _in_order(table, time_s, path)
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
        notes=(*notes, *sorting),
        **found,  # type: ignore[arg-type]
    )


def _strange(header: Sequence[str]) -> list[str]:
    return [name for name in header if name not in KNOWN]


def _in_order(table: _Table, time_s: FloatArray, path: Path) -> tuple[_Table, FloatArray, list[str]]:
    unknown = np.flatnonzero(~np.isfinite(time_s))
    if unknown.size:
        raise BadRecording(f"{path}, line {int(unknown[0]) + 2}: {TIME} is no time.", "Correct that line.")
    if bool((np.diff(time_s) >= 0.0).all()):
        return table, time_s, []
    order = np.argsort(time_s, kind="stable")
    return (
        _Table(table.header, table.values[order]),
        time_s[order],
        ["The rows were not in order of time; they were sorted."],
    )


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
    # A damaged byte costs its line, not the recording; universal newlines as in any text file.
    text = path.read_text(encoding="utf-8-sig", errors="replace")
    first, _, rest = text.partition("\n")
    if not first.isprintable() or "\ufffd" in first:
        raise BadRecording(f"{path} is not a text file with a header of column names.", _REMEDY)
    header = tuple(name.strip() for name in first.strip().split(","))
    repeated = next((name for name in header if header.count(name) > 1), None)
    if repeated is not None:
        raise BadRecording(f"{path} has the column {repeated or '(without a name)'} twice.", _REMEDY)
    rest, notes = _without_cut_off_line(rest, len(header))
    values = _parse_quickly(rest, len(header))
    if values is None:
        values, damaged = _parse_line_by_line(rest, header, path)
        notes = (*notes, *damaged)
    return _Table(header, values, notes)


def _without_cut_off_line(text: str, width: int) -> tuple[str, tuple[str, ...]]:
    """Leave out a last line that was not written to its end, as when the power fails."""
    before, newline, last = text.rpartition("\n")
    if last and last.count(",") + 1 < width:
        return before + newline, ("The last line is cut off; it was left out.",)
    return text, ()


def _parse_quickly(text: str, width: int) -> FloatArray | None:
    """Parse well-formed rows in one go; None where that fails, for the parser that knows the line."""
    if not text.strip() or text.startswith(",") or any(gap in text for gap in (",,", ",\n", "\n,")):
        return None
    try:
        values = np.loadtxt(io.StringIO(text), delimiter=",", ndmin=2, comments=None)
    except ValueError:
        return None
    return values if values.shape[1] == width else None


def _parse_line_by_line(text: str, header: tuple[str, ...], path: Path) -> tuple[FloatArray, tuple[str, ...]]:
    """Parse what can be parsed; lines that cannot are left out, told in a note, and refused where many."""
    rows: list[list[float]] = []
    bad: list[BadRecording] = []
    for number, line in enumerate(text.splitlines(), start=2):
        if not line.strip():
            continue
        try:
            rows.append(_row(line, header, number, path))
        except BadRecording as error:
            bad.append(error)
    if len(bad) > _MOST_BAD_LINES * (len(rows) + len(bad)):
        raise bad[0]
    notes = (f"{len(bad)} damaged lines were left out. The first: {bad[0].what}",) if bad else ()
    return np.array(rows, dtype=np.float64).reshape(len(rows), len(header)), notes


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
