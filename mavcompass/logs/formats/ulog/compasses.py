"""The compasses of a ULog: which topic holds them, uncorrected or corrected, in whose axes.

Since 1.11 `sensor_mag` is what the sensor measured, in its own axes and uncorrected, and
`vehicle_magnetometer` the corrected field in body axes. Before, `sensor_mag` (with a field x_raw) was
corrected by the driver, and `sensor_combined` carried the chosen compass, corrected, in body axes.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from mavcompass.compass_parameters import px4_name, px4_rotation
from mavcompass.correction import IDENTITY
from mavcompass.frames import FloatArray
from mavcompass.logs.common import Change, finite_series, px4_steps, unknown_correction
from mavcompass.logs.formats.ulog.topics import has, indexed, time_s, vector
from mavcompass.track import InForce, MagSeries
from mavcompass.units import MGAUSS_PER_GAUSS

MAG_TOPICS = ("sensor_mag", "vehicle_magnetometer", "sensor_combined")
_FIELD = indexed("magnetometer_ga")
_SLOTS = 4
_NO_NEW_SAMPLE = 0x7FFFFFFF
_MICRO = 1.0e-6


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
        try:
            rotation = px4_rotation(parameters, instance)
        except KeyError:
            notes.append(
                f"{px4_name('ROT', instance)} is no known rotation: compass {instance} was left out."
            )
            continue
        reported = finite_series(time_s(data), field @ rotation.T)
        if reported is not None:
            found[instance] = MagSeries(
                instance, reported, (InForce(-np.inf, IDENTITY),), True, device_id=device_id
            )
    if found:
        return found, notes
    for data in topics.get("vehicle_magnetometer", ()):
        if has(data, *_FIELD):
            _add_corrected(found, data, time_s(data), _device_id(data), history, parameters)
    if not found:
        for data in topics.get("sensor_combined", ())[:1]:
            if has(data, *_FIELD):
                prime = parameters.get("CAL_MAG_PRIME")
                _add_corrected(
                    found,
                    data,
                    _combined_time_s(data),
                    None if prime is None else int(prime),
                    history,
                    parameters,
                )
    notes += [unknown_correction(i) for i, compass in found.items() if not compass.correction_known]
    return found, notes


def _add_corrected(
    found: dict[int, MagSeries],
    data: Any,
    times: FloatArray,
    device_id: int | None,
    history: Sequence[Change],
    parameters: Mapping[str, float],
) -> None:
    instance = _instance(device_id, parameters, found)
    reported = finite_series(
        times, vector(data, *_FIELD) * np.where(np.isfinite(times), MGAUSS_PER_GAUSS, np.nan)[:, None]
    )
    if reported is None:
        return
    steps, known = px4_steps(history, instance)
    found[instance] = MagSeries(instance, reported, steps, known, device_id=device_id)


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
