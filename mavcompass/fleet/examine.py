"""Examine one recording: a function of plain values, for any process on any machine."""

from __future__ import annotations

import json
import math
import re
import time
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import PurePosixPath
from typing import TYPE_CHECKING, Any, Literal

import numpy as np

from mavcompass.errors import BadRecording, MavCompassError
from mavcompass.fleet.recordings import accelerometer_mark
from mavcompass.printable import plain

if TYPE_CHECKING:
    from mavcompass.calibration.result import CalibrationResult
    from mavcompass.correction import FieldCorrection
    from mavcompass.gap.result import Diagnosis
    from mavcompass.track import MagSeries, Track

Row = dict[str, Any]
Work = Literal["calibrate", "diagnose"]
_AXES = ("x", "y", "z")
_PAIRS = ("xy", "xz", "yz")
_PIECE, _FEWEST_PIECES = 12, 8
_FIRMWARE = re.compile(r"((?:Ardu|APM|PX4)\w* V?\d\S*)")
# What an autopilot says when something happened to the vehicle that may have moved its iron.
_EVENT = re.compile(r"crash|hit ground|failsafe", re.IGNORECASE)


@dataclass(frozen=True, slots=True)
class Job:
    """Say what is done with every recording.

    Attributes:
        instances: the compasses, from 1; empty for all. method, max_error_deg: of `calibrate`.
        reference: of `diagnose`.
        vehicle_pattern: a regular expression whose first group, found in the path, names the vehicle.
    """

    work: Work
    instances: tuple[int, ...] = (1,)
    method: str = "auto"
    max_error_deg: float = 2.0
    reference: str = "auto"
    vehicle_pattern: str | None = None


def examine(job: Job, path: str) -> list[Row]:
    """Return the rows of one recording, one per compass, in the columns of `columns.columns_of`.

    What cannot be read or calibrated gives a row with status "error"; nothing is raised for it.
    """
    from mavcompass.fleet.recordings import as_local_file
    from mavcompass.logs import read_track

    began = time.perf_counter()
    try:
        with as_local_file(path) as file:
            track = read_track(file)
    except (MavCompassError, OSError) as error:
        return [error_row(job, path, type(error).__name__, str(error))]
    rows = list(rows_of(job, path, track))
    each_s = (time.perf_counter() - began) / len(rows)
    return [row | {"seconds": each_s} for row in rows]


def error_row(job: Job, path: str, kind: str, text: str) -> Row:
    """Make the row of a recording that gave no result."""
    return {
        "recording": path,
        "status": "error",
        "vehicle": _named_in(job, path) or _folder(path),
        "error_kind": kind,
        "error": text,
    }


def rows_of(job: Job, path: str, track: Track) -> Iterator[Row]:
    """Yield the rows of a recording that was read, one per compass."""
    about = _about(job, path, track)
    if not track.compasses:
        yield about | _error(BadRecording("It has no magnetometer readings.", "Log the compass."))
        return
    for instance in job.instances or sorted(track.compasses):
        row = about | {"compass": instance} | _about_compass(track, instance)
        try:
            yield row | (
                _calibrated(job, track, instance)
                if job.work == "calibrate"
                else _diagnosed(job, track, instance)
            )
        except MavCompassError as error:
            yield row | _error(error)


def _error(error: MavCompassError) -> Row:
    return {"status": "error", "error_kind": type(error).__name__, "error": str(error)}


def _about(job: Job, path: str, track: Track) -> Row:
    start = min((float(c.time_s[0]) for c in track.compasses.values() if len(c.reported)), default=0.0)
    ids = [str(compass.device_id) for _, compass in sorted(track.compasses.items()) if compass.device_id]
    known = track.utc_offset_s is not None and math.isfinite(track.utc_offset_s + start)
    return {
        "recording": path,
        **_named(job, track, path),
        "device_ids": ",".join(ids) or None,
        "accelerometer": accelerometer_mark(track.parameters),
        "autopilot": track.autopilot,
        "vehicle_kind": track.vehicle,
        "firmware": next((found[1] for text in track.texts if (found := _FIRMWARE.match(text))), None),
        "events": "; ".join(filter(_EVENT.search, track.texts)) or None,
        "recorded_unix_s": track.utc_offset_s + start if known and track.utc_offset_s is not None else None,
        "duration_s": plain(track.duration_s),
        "notes": " ".join(track.notes),
    }


def _named_in(job: Job, path: str) -> str | None:
    found = re.search(job.vehicle_pattern, path) if job.vehicle_pattern else None
    return found.group(1) if found else None


def _folder(path: str) -> str:
    return PurePosixPath(path).parent.name or "unnamed"


def _named(job: Job, track: Track, path: str) -> Row:
    """Name a vehicle by pattern or serial number; few have one set, so else by its folder and system id."""
    if (name := _named_in(job, path)) is not None:
        return {"vehicle": name, "named_by": "pattern"}
    serial = track.parameters.get("BRD_SERIAL_NUM", 0.0)
    if math.isfinite(serial) and serial:
        return {"vehicle": f"serial {serial:.0f}", "named_by": "serial"}
    for parameter in ("MAV_SYSID", "SYSID_THISMAV", "MAV_SYS_ID"):
        if math.isfinite(system := track.parameters.get(parameter, math.nan)):
            return {"vehicle": f"{_folder(path)}, system {system:.0f}", "named_by": "folder"}
    return {"vehicle": _folder(path), "named_by": "folder"}


def _about_compass(track: Track, instance: int) -> Row:
    compass = track.compasses.get(instance)
    if compass is None:
        return {}
    row: Row = {"device_id": compass.device_id, "samples": len(compass.reported)}
    if compass.calibration is not None:
        row |= _numbers("in_force_offset_", "_mgauss", compass.calibration.offsets_mgauss)
    return row


def _calibrated(job: Job, track: Track, instance: int) -> Row:
    from mavcompass import api

    result = api.calibrate(track, job.method, instance, job.max_error_deg)
    return {
        "status": "ok" if result.accepted else "not_accepted",
        "method": result.method,
        "accepted": result.accepted,
        "already_right": result.already_right,
        "reasons": " ".join(result.reasons),
        "warnings": " ".join(result.warnings),
        "not_observable": ",".join(result.not_observable),
        "heading_sigma_deg": plain(result.heading_sigma_deg),
        "heading_change_deg": plain(result.heading_change_deg),
        "heading_change_max_deg": plain(result.heading_change_max_deg),
        "residual_rms_mgauss": plain(result.residual_rms_mgauss),
        "field_horizontal_mgauss": plain(result.horizontal_mgauss),
        "field_vertical_mgauss": plain(result.vertical_mgauss),
        **_correction(result.correction),
        **_offset_sigmas(result),
    }


def _correction(correction: FieldCorrection) -> Row:
    return (
        _numbers("offset_", "_mgauss", correction.offsets_mgauss)
        | _numbers("diagonal_", "", correction.diagonals)
        | _numbers("off_diagonal_", "", correction.off_diagonals, _PAIRS)
        | {"scale": plain(correction.scale), "motor_source": correction.motor_source}
        | _numbers("motor_", "_mgauss", correction.motors.sum(axis=0))
    )


def _offset_sigmas(result: CalibrationResult) -> Row:
    variances = {name: float(result.covariance[i, i]) for i, name in enumerate(result.covariance_names)}
    return {
        f"offset_{axis}_sigma_mgauss": plain(math.sqrt(variances[f"offset_{axis}"]))
        for axis in _AXES
        if variances.get(f"offset_{axis}", -1.0) >= 0.0
    }


def _diagnosed(job: Job, track: Track, instance: int) -> Row:
    from mavcompass.gap import diagnose_gap
    from mavcompass.gap.rehearsal import IRON_NAMES, whole_iron
    from mavcompass.parameter_remarks import remarks_said

    found = diagnose_gap(track, None, (), instance, job.reference)  # type: ignore[arg-type]
    iron = whole_iron(found)
    return {
        "status": "ok",
        "notes": " ".join((*track.notes, *remarks_said(track.autopilot, track.parameters, instance))),
        "verdict": found.verdict,
        "reference": found.reference,
        "effects": ",".join(sorted(found.effects)),
        "unknown": found.unknown,
        "unknown_coordinate": found.unknown_coordinate,
        **{f"effect_{cause.effect}_mgauss": plain(cause.removes_mgauss) for cause in found.causes},
        **_gap("field", "mgauss", found),
        **_gap("heading", "deg", found),
        "causes_json": json.dumps(plain(found.to_json()["causes"]), allow_nan=False),
        "iron_json": None
        if iron is None
        else json.dumps(
            {"names": IRON_NAMES, "values": iron[0].tolist(), "covariance": iron[1].tolist()}, allow_nan=False
        ),
        "scatter_mgauss": _scatter_mgauss(track.compasses[instance]),
    }


def _scatter_mgauss(compass: MagSeries) -> float | None:
    """Return the white scatter of fresh readings per axis, by the quietest quarter of third differences."""
    reported = np.asarray(compass.reported.values)
    reported = reported[np.isfinite(reported).all(axis=1)]
    fresh = reported[np.concatenate([[True], np.any(np.diff(reported, axis=0) != 0.0, axis=1)])]
    pieces = (len(fresh) - 3) // _PIECE
    if pieces < _FEWEST_PIECES:
        return None
    square = np.diff(fresh, 3, axis=0)[: pieces * _PIECE].reshape(pieces, -1) ** 2
    # White noise of one sigma makes third differences of sqrt(20).
    return float(np.sqrt(np.percentile(square.mean(axis=1), 25.0) / 20.0))


def _gap(name: Literal["field", "heading"], unit: str, found: Diagnosis) -> Row:
    closing = found.field if name == "field" else found.heading
    return {
        f"{name}_gap_{unit}": plain(closing.nominal),
        f"{name}_gap_after_{unit}": plain(closing.after),
        f"{name}_gap_floor_{unit}": plain(closing.floor),
        f"{name}_gap_shrink": plain(closing.shrink),
    }


def _numbers(before: str, after: str, values: Any, names: tuple[str, ...] = _AXES) -> Row:
    return {f"{before}{name}{after}": plain(value) for name, value in zip(names, values, strict=True)}
