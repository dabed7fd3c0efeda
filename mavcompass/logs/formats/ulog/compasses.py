"""The compasses of a ULog: which topic holds them, uncorrected or corrected, in whose axes.

Since 1.11 `sensor_mag` is what the sensor measured, in its own axes and uncorrected, and
`vehicle_magnetometer` the corrected field in body axes. Before, `sensor_mag` (with a field x_raw) was
corrected by the driver, and `sensor_combined` carried the chosen compass, corrected, in body axes.

The logger's default is one `sensor_mag` a second, too slow for a vehicle that turns, and fourteen
`vehicle_magnetometer`. There the corrections are undone. Which of them are inside the readings is not told by
the parameters alone. PX4 takes a changed calibration over only while it is disarmed, and not where it hardly
changed; each time `calibration_count` goes up. Besides, an estimator that runs on the ground subtracts a bias
of its own, which stays in flight.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from mavcompass.compass_parameters import PX4_ANGLES, px4_name, px4_sensor_to_body
from mavcompass.correction import IDENTITY
from mavcompass.credible import turned_field
from mavcompass.frames import FloatArray
from mavcompass.logs.common.parameter_steps import Change, px4_steps, unknown_correction
from mavcompass.logs.common.samples import finite_series, spoken
from mavcompass.logs.formats.ulog.messages import Topic, indexed
from mavcompass.track import InForce, MagSeries
from mavcompass.units import MGAUSS_PER_GAUSS

MAG_TOPICS = ("sensor_mag", "vehicle_magnetometer", "sensor_combined", "magnetometer_bias_estimate")
BoolArray = NDArray[np.bool_]

_FIELD = indexed("magnetometer_ga")
_SLOTS = 4
_NO_NEW_SAMPLE = 0x7FFFFFFF
_MICRO = 1.0e-6
# The logger writes a changed parameter down a little before or after its calibration takes effect. What was
# written in flight takes none: on disarming, PX4 stores the calibration that it flew with over it.
_LOGGED_WITHIN_S, _LOADED_WITHIN_S = 1.0, 5.0
# So many times as many readings make the corrected field the better one to begin with; fewer do where raw
# ones come more slowly than a vehicle turns.
_DENSER, _DENSER_THAN_SLOW, _SLOW_S = 3.0, 1.5, 0.5


def compasses(
    topics: Mapping[str, Sequence[Topic]], history: Sequence[Change], parameters: Mapping[str, float]
) -> tuple[dict[int, MagSeries], list[str]]:
    """Read every compass of the log, by instance; and notes on what was supposed."""
    notes: list[str] = []
    found: dict[int, MagSeries] = {}
    raw = [d for d in topics.get("sensor_mag", ()) if d.has("x", "y", "z") and not d.has("x_raw")]
    for data in raw:
        device_id = _device_ids(data)[0]
        instance = _instance(device_id, parameters, found)
        field = data.vector("x", "y", "z") * MGAUSS_PER_GAUSS
        rotation = px4_sensor_to_body(parameters, instance)
        reported, silences = spoken(finite_series(data.time_s, turned_field(field, rotation)), instance)
        if reported is not None:
            notes += silences
            steps, known = px4_steps(history, instance)
            found[instance] = MagSeries(
                instance, reported, (InForce(-np.inf, IDENTITY),), True, device_id=device_id,
                not_applied=steps[-1].correction if known else None,
            )  # fmt: skip
    for data in topics.get("vehicle_magnetometer", ()):
        if data.has(*_FIELD):
            for device_id in _device_ids(data, _prime(parameters)):
                _add_denser(found, topics, data, device_id, history, parameters)
    if found:
        notes += [unknown_correction(i) for i, compass in found.items() if not compass.correction_known]
        return found, notes
    for data in topics.get("sensor_combined", ())[:1]:
        if data.has(*_FIELD):
            device = _prime(parameters)
            instance = _instance(device, parameters, found)
            times = _combined_time_s(data)
            reported = finite_series(
                times,
                data.vector(*_FIELD) * np.where(np.isfinite(times), MGAUSS_PER_GAUSS, np.nan)[:, None],
            )
            if reported is not None:
                steps, known = px4_steps(history, instance)
                found[instance] = MagSeries(instance, reported, steps, known, device_id=device)
    notes += [unknown_correction(i) for i, compass in found.items() if not compass.correction_known]
    return found, notes


def _add_denser(
    found: dict[int, MagSeries],
    topics: Mapping[str, Sequence[Topic]],
    data: Topic,
    device_id: int | None,
    history: Sequence[Change],
    parameters: Mapping[str, float],
) -> None:
    """Add a compass by its corrected field, in place of its raw readings where these are much sparser."""
    rows = _rows_of(data, device_id)
    instance = next((i for i, compass in found.items() if compass.device_id == device_id), None)
    if instance is None and device_id is None and found:
        return  # one of those that are there already; nobody knows which
    if instance is None:
        instance = _instance(device_id, parameters, found)
    elif np.count_nonzero(rows) < _denser(found[instance].time_s) * len(found[instance].reported):
        return
    times = data.time_s[rows]
    taken = history
    field_mgauss = data.vector(*_FIELD)[rows] * MGAUSS_PER_GAUSS
    if data.has("calibration_count"):
        counts = np.asarray(data.data["calibration_count"])[rows]
        taken = taken_over(history, px4_name("", instance), times, counts)
        field_mgauss = field_mgauss + estimated_bias_mgauss(topics, device_id, times, counts)
    reported = finite_series(times, field_mgauss)
    if reported is not None:
        steps, known = px4_steps(taken, instance)
        found[instance] = MagSeries(instance, reported, steps, known, device_id=device_id)


def _denser(raw_s: FloatArray) -> float:
    """Return how many times as many corrected readings are better than raw ones at some times (N,)."""
    slow = raw_s.size > 1 and float(np.median(np.diff(raw_s))) > _SLOW_S
    return _DENSER_THAN_SLOW if slow else _DENSER


def _device_ids(data: Topic, untold: int | None = None) -> list[int | None]:
    """List the sensors whose readings a topic carries: PX4 may change from one to another."""
    ids = data.data.get("device_id")
    return [untold] if ids is None or not len(ids) else list(dict.fromkeys(int(i) for i in ids))


def _prime(parameters: Mapping[str, float]) -> int | None:
    """Return the sensor that steers, of which corrected readings are where they do not say whose they are."""
    prime = parameters.get("CAL_MAG_PRIME")
    return None if prime is None else int(prime)


def _rows_of(data: Topic, device_id: int | None) -> BoolArray:
    count = len(data.data["timestamp"])
    if device_id is None or "device_id" not in data.data:
        return np.ones(count, dtype=np.bool_)
    return np.asarray(np.asarray(data.data["device_id"]) == device_id, dtype=np.bool_)


def _instance(device_id: int | None, parameters: Mapping[str, float], taken: Mapping[int, object]) -> int:
    """Return the calibration slot (from 1) that holds this sensor, or the first free number."""
    if device_id:
        for instance in range(1, _SLOTS + 1):
            if int(parameters.get(px4_name("ID", instance), 0)) == device_id and instance not in taken:
                return instance
    return next(instance for instance in range(1, 99) if instance not in taken)


def _combined_time_s(data: Topic) -> FloatArray:
    """Return when the magnetometer in `sensor_combined` was sampled; nan where it was not new."""
    stamps = np.asarray(data.data["timestamp"], dtype=np.float64)
    relative = data.data.get("magnetometer_timestamp_relative")
    if relative is None:
        return stamps * _MICRO
    return np.where(relative == _NO_NEW_SAMPLE, np.nan, stamps + relative) * _MICRO


def taken_over(
    history: Sequence[Change], prefix: str, times_s: FloatArray, counts: np.ndarray[Any, Any]
) -> tuple[Change, ...]:
    """Move changes of one compass's calibration to when they were taken over; leave out those never taken.

    `prefix` is what the names of its parameters begin with; `counts` are the calibration's at `times_s`,
    (N,).
    What held before the recording, and the mounting, which has no count, stay as they are.
    """
    raised_s = times_s[1:][np.diff(counts.astype(np.int64)) != 0]
    uncounted = {f"{prefix}{quantity}" for quantity in ("ID", "PRIO", "ROT", *PX4_ANGLES)}
    out = []
    for change in history:
        counted = change.name.startswith(prefix) and change.name not in uncounted
        if not counted or not np.isfinite(change.from_s):
            out.append(change)
            continue
        after_s = raised_s - change.from_s
        later_s = raised_s[(after_s >= -_LOGGED_WITHIN_S) & (after_s <= _LOADED_WITHIN_S)]
        if later_s.size:
            out.append(replace(change, from_s=float(later_s[0])))
    return tuple(sorted(out, key=lambda change: change.from_s))


def estimated_bias_mgauss(
    topics: Mapping[str, Sequence[Topic]],
    device_id: int | None,
    times_s: FloatArray,
    counts: np.ndarray[Any, Any],
) -> FloatArray:
    """Return the bias that was subtracted besides the calibration, body axes, (N, 3); 0 where none was."""
    bias = np.zeros((times_s.size, 3))
    raised_s = times_s[1:][np.diff(counts.astype(np.int64)) != 0]
    for data in topics.get("magnetometer_bias_estimate", ()):
        index = _index_of(topics, device_id)
        names = [f"bias_{axis}[{index}]" for axis in "xyz"]
        if not data.has(f"valid[{index}]", *names):
            continue
        valid = np.asarray(data.data[f"valid[{index}]"]) != 0
        said_s = data.time_s[valid]
        said = np.stack([np.asarray(data.data[name], dtype=np.float64)[valid] for name in names], axis=1)
        last = np.searchsorted(said_s, times_s, side="right") - 1
        # A calibration that is taken over ends the bias that was learnt before it.
        began = np.searchsorted(raised_s, times_s, side="right") - 1
        since_s = np.where(began >= 0, raised_s[began] if raised_s.size else -np.inf, -np.inf)
        known = (last >= 0) & (said_s[last] > since_s if said_s.size else False)
        bias[known] = said[last[known]] * MGAUSS_PER_GAUSS
    return bias


def _index_of(topics: Mapping[str, Sequence[Topic]], device_id: int | None) -> int:
    """Return the place of a sensor among all: `sensor_mag` numbers them."""
    for data in topics.get("sensor_mag", ()):
        ids = data.data.get("device_id")
        if ids is not None and len(ids) and int(ids[0]) == device_id:
            return int(data.multi_id)
    return 0
