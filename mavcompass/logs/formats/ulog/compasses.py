"""The compasses of a ULog: which topic holds them, uncorrected or corrected, in whose axes.

Since 1.11 `sensor_mag` is what the sensor measured, in its own axes and uncorrected, and
`vehicle_magnetometer` the corrected field in body axes. Before, `sensor_mag` (with a field x_raw) was
corrected by the driver, and `sensor_combined` carried the chosen compass, corrected, in body axes.

The logger's default is one `sensor_mag` a second, too slow for a vehicle that turns, and fourteen
`vehicle_magnetometer`. There the corrections are undone: see `in_force`.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from mavcompass.compass_parameters import px4_name, px4_sensor_to_body
from mavcompass.correction import IDENTITY
from mavcompass.credible import turned_field
from mavcompass.frames import FloatArray
from mavcompass.logs.common import (
    Change,
    finite_series,
    px4_steps,
    said_nothing,
    spoken,
    unknown_correction,
)
from mavcompass.logs.formats.ulog.in_force import estimated_bias_mgauss, taken_over
from mavcompass.logs.formats.ulog.topics import has, indexed, time_s, vector
from mavcompass.track import InForce, MagSeries
from mavcompass.units import MGAUSS_PER_GAUSS

MAG_TOPICS = ("sensor_mag", "vehicle_magnetometer", "sensor_combined", "magnetometer_bias_estimate")
BoolArray = NDArray[np.bool_]

_FIELD = indexed("magnetometer_ga")
_SLOTS = 4
_NO_NEW_SAMPLE = 0x7FFFFFFF
_MICRO = 1.0e-6
# So many times as many readings make the corrected field the better one to begin with; fewer do where raw
# ones come more slowly than a vehicle turns.
_DENSER, _DENSER_THAN_SLOW, _SLOW_S = 3.0, 1.5, 0.5


def compasses(
    topics: Mapping[str, Sequence[Any]], history: Sequence[Change], parameters: Mapping[str, float]
) -> tuple[dict[int, MagSeries], list[str]]:
    """Read every compass of the log, by instance; and notes on what was supposed."""
    notes: list[str] = []
    found: dict[int, MagSeries] = {}
    raw = [d for d in topics.get("sensor_mag", ()) if has(d, "x", "y", "z") and not has(d, "x_raw")]
    for data in raw:
        device_id = _device_id(data)
        instance = _instance(device_id, parameters, found)
        field = vector(data, "x", "y", "z") * MGAUSS_PER_GAUSS
        rotation = px4_sensor_to_body(parameters, instance)
        reported, silent = spoken(finite_series(time_s(data), turned_field(field, rotation)))
        if reported is not None:
            notes += said_nothing(instance, silent, reported)
            steps, known = px4_steps(history, instance)
            found[instance] = MagSeries(
                instance, reported, (InForce(-np.inf, IDENTITY),), True, device_id=device_id,
                not_applied=steps[-1].correction if known else None,
            )  # fmt: skip
    for data in topics.get("vehicle_magnetometer", ()):
        if has(data, *_FIELD):
            for device_id in _device_ids(data):
                _add_denser(found, topics, data, device_id, history, parameters)
    if found:
        notes += [unknown_correction(i) for i, compass in found.items() if not compass.correction_known]
        return found, notes
    for data in topics.get("sensor_combined", ())[:1]:
        if has(data, *_FIELD):
            prime = parameters.get("CAL_MAG_PRIME")
            device = None if prime is None else int(prime)
            instance = _instance(device, parameters, found)
            times = _combined_time_s(data)
            reported = finite_series(
                times,
                vector(data, *_FIELD) * np.where(np.isfinite(times), MGAUSS_PER_GAUSS, np.nan)[:, None],
            )
            if reported is not None:
                steps, known = px4_steps(history, instance)
                found[instance] = MagSeries(instance, reported, steps, known, device_id=device)
    notes += [unknown_correction(i) for i, compass in found.items() if not compass.correction_known]
    return found, notes


def _add_denser(
    found: dict[int, MagSeries],
    topics: Mapping[str, Sequence[Any]],
    data: Any,
    device_id: int | None,
    history: Sequence[Change],
    parameters: Mapping[str, float],
) -> None:
    """Add a compass by its corrected field, in place of its raw readings where these are much sparser."""
    rows = _rows_of(data, device_id)
    instance = next((i for i, compass in found.items() if compass.device_id == device_id), None)
    if instance is None:
        instance = _instance(device_id, parameters, found)
    elif np.count_nonzero(rows) < _denser(found[instance].time_s) * len(found[instance].reported):
        return
    times = time_s(data)[rows]
    taken = history
    field_mgauss = vector(data, *_FIELD)[rows] * MGAUSS_PER_GAUSS
    if has(data, "calibration_count"):
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


def _device_ids(data: Any) -> list[int | None]:
    """List the sensors whose readings a topic carries: PX4 may change from one to another."""
    ids = data.data.get("device_id")
    return [None] if ids is None or not len(ids) else list(dict.fromkeys(int(i) for i in ids))


def _rows_of(data: Any, device_id: int | None) -> BoolArray:
    count = len(data.data["timestamp"])
    if device_id is None:
        return np.ones(count, dtype=np.bool_)
    return np.asarray(np.asarray(data.data["device_id"]) == device_id, dtype=np.bool_)


def _device_id(data: Any) -> int | None:
    ids = data.data.get("device_id")
    return None if ids is None or not len(ids) else int(ids[0])


def _instance(device_id: int | None, parameters: Mapping[str, float], taken: Mapping[int, object]) -> int:
    """Return the calibration slot (from 1) that holds this sensor, or the first free number."""
    if device_id:
        for instance in range(1, _SLOTS + 1):
            if int(parameters.get(px4_name("ID", instance), 0)) == device_id and instance not in taken:
                return instance
    return next(instance for instance in range(1, 99) if instance not in taken)


def _combined_time_s(data: Any) -> FloatArray:
    """Return when the magnetometer in `sensor_combined` was sampled; nan where it was not new."""
    stamps = np.asarray(data.data["timestamp"], dtype=np.float64)
    relative = data.data.get("magnetometer_timestamp_relative")
    if relative is None:
        return stamps * _MICRO
    return np.where(relative == _NO_NEW_SAMPLE, np.nan, stamps + relative) * _MICRO
