"""The table of a fleet: its columns, and writing it as Parquet."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal

from mavcompass.errors import UsageError
from mavcompass.files import replacing
from mavcompass.fleet.examine import Row, Work
from mavcompass.installation.parts import require

Kind = Literal["text", "number", "count", "flag", "moment"]


@dataclass(frozen=True, slots=True)
class Column:
    """Name one column; `key` is where the rows have its value (a moment: seconds of Unix time)."""

    name: str
    kind: Kind
    about: str
    key: str = ""


def _axes(before: str, after: str, about: str, names: Sequence[str] = ("x", "y", "z")) -> list[Column]:
    return [Column(f"{before}{name}{after}", "number", f"{about}, {name.upper()}") for name in names]


_COMMON = [
    Column("recording", "text", "absolute path or URL"),
    Column("size_bytes", "count", "its size"),
    Column("status", "text", "ok, not_accepted (a calibration not worth writing) or error"),
    Column("error_kind", "text", "of an error: its class, WorkerDied or Timeout"),
    Column("error", "text", "of an error: what happened and what to do"),
    Column("vehicle", "text", "by --vehicle-pattern, serial number, or folder and system id with a letter"),
    Column("device_ids", "text", "the autopilot's ids of all its compasses, comma-separated"),
    Column("accelerometer", "text", "short mark of the accelerometer's calibration, a vehicle's own"),
    Column("autopilot", "text", "ardupilot, px4 or unknown"),
    Column("vehicle_kind", "text", "rover, copter, ..."),
    Column("firmware", "text", "of the autopilot, by its own word"),
    Column("events", "text", "what the autopilot said of crashes and failsafes"),
    Column("recorded_at", "moment", "when the readings begin, UTC", "recorded_unix_s"),
    Column("recorded_at_is", "text", "recording (its own clock) or file (the file's date)"),
    Column("duration_s", "number", "from the first to the last magnetometer reading"),
    Column("compass", "count", "instance, from 1"),
    Column("device_id", "count", "the autopilot's id of the sensor"),
    Column("samples", "count", "magnetometer readings"),
    *_axes("in_force_offset_", "_mgauss", "offset in force at the end of the recording"),
    Column("notes", "text", "what the reader skipped or supposed"),
    Column("seconds", "number", "time spent on it"),
]
_CALIBRATE = [
    Column("method", "text", "of the calibration"),
    Column("accepted", "flag", "worth writing"),
    Column("already_right", "flag", "the values in force are no worse: nothing to write"),
    Column("reasons", "text", "why not"),
    Column("warnings", "text", "what to know although it is accepted"),
    Column("not_observable", "text", "quantities that this motion does not show, comma-separated"),
    Column("heading_sigma_deg", "number", "predicted heading error of the new correction, 1 sigma"),
    Column("heading_change_deg", "number", "correction in force against the new one, rms over the circle"),
    Column("heading_change_max_deg", "number", "the same, largest"),
    Column("residual_rms_mgauss", "number", "measured less fitted"),
    Column("field_horizontal_mgauss", "number", "of the Earth, as the fit has it"),
    Column("field_vertical_mgauss", "number", "of the Earth, as the fit has it, down"),
    *_axes("offset_", "_mgauss", "found: corrected = M ((raw + offset) scale)"),
    *_axes("offset_", "_sigma_mgauss", "its 1 sigma"),
    *_axes("diagonal_", "", "of M, found"),
    *_axes("off_diagonal_", "", "of M, found", ("xy", "xz", "yz")),
    Column("scale", "number", "found"),
    Column("motor_source", "text", "the load of the motor term: current, throttle, outputs or none"),
    *_axes("motor_", "_mgauss", "its share: mG/A, or mG at full throttle"),
]
_DIAGNOSE = [
    Column("verdict", "text", "no_gap, named, ambiguous, named_with_remainder, unknown or not_testable"),
    Column("reference", "text", "the attitude that was used"),
    Column("effects", "text", "the named effects, comma-separated"),
    Column("unknown", "flag", "something is left that no effect explains"),
    Column("unknown_coordinate", "text", "what it goes with"),
    Column("field_gap_mgauss", "number", "simulation against recording, per-axis rms, held-out parts"),
    Column("field_gap_after_mgauss", "number", "with the named effects simulated"),
    Column("field_gap_floor_mgauss", "number", "the noise floor"),
    Column("field_gap_shrink", "number", "share of the gap that the effects close"),
    Column("heading_gap_deg", "number", "simulation against recording, rms, held-out parts"),
    Column("heading_gap_after_deg", "number", "with the named effects simulated"),
    Column("heading_gap_floor_deg", "number", "the noise floor"),
    Column("heading_gap_shrink", "number", "share of the gap that the effects close"),
    Column("causes_json", "text", "the named causes with parameters and intervals, as in the gap JSON"),
    Column("iron_json", "text", "the whole iron (offset mG, gains, motors mG/A): names, values, covariance"),
    Column("scatter_mgauss", "number", "white scatter of the readings, per axis"),
]


def columns_of(work: Work) -> list[Column]:
    """Return the columns of a kind of work, in their order in the file."""
    if work == "calibrate":
        return [*_COMMON, *_CALIBRATE]
    from mavcompass.simulation.effects import catalogue

    sizes = [
        Column(f"effect_{name}_mgauss", "number", f"rms that {name} explains, where it is named")
        for name in catalogue()
    ]
    return [*_COMMON, *_DIAGNOSE, *sizes]


def write_parquet(rows: Sequence[Row], work: Work, path: Path) -> None:
    """Write rows to a Parquet file; an older one stays until the new one is whole.

    Raises UsageError where pyarrow is missing or the file cannot be written.
    """
    require("A Parquet table")
    import pyarrow as pa
    import pyarrow.parquet as pq

    kinds = {
        "text": pa.string(),
        "number": pa.float64(),
        "count": pa.int64(),
        "flag": pa.bool_(),
        "moment": pa.timestamp("us", tz="UTC"),
    }
    columns = columns_of(work)
    fields = [pa.field(c.name, kinds[c.kind], metadata={"about": c.about}) for c in columns]
    arrays = [pa.array([_value(row, c) for row in rows], kinds[c.kind]) for c in columns]
    schema = pa.schema(fields, metadata={"schema": f"mavcompass.fleet-{work}/1"})
    try:
        with replacing(path) as file:
            pq.write_table(pa.Table.from_arrays(arrays, schema=schema), file)
    except OSError as error:
        raise UsageError(
            f"{path} could not be written ({error.strerror or error}).",
            "Give --out a file in a folder that you may write to, and run again: nothing is done twice.",
        ) from error


def _value(row: Row, column: Column) -> Any:
    value = row.get(column.key or column.name)
    return round(value * 1e6) if column.kind == "moment" and value is not None else value
