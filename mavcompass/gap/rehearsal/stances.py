"""How a vehicle stands after a turn, observed as the calibration observes its positions."""

from __future__ import annotations

import math

import numpy as np

from mavcompass.calibration.observation import Dwell, dwell_between, rolls
from mavcompass.calibration.observation.turning import TurnRecord
from mavcompass.errors import BadRecording, PoorCalibration
from mavcompass.frames import FloatArray
from mavcompass.track import Track

# The live procedure stands for so long; for the longer where the heading by it is not sure enough.
_SHORT_S, _LONG_S, _ENOUGH_RAD = 0.92, 1.7, math.radians(0.15)
# A recording with fewer readings a second than a compass gives needs longer for as many.
_READINGS_HZ = 10.0
_MOST, _FEWEST = 24, 5
_CALM_RADPS = math.radians(2.0)
# A calibration stands right after a turn: chassis and estimator have settled less than they ever will.
_TURNING_RADPS, _AFTERWARDS_S = math.radians(10.0), 3.0
_ROLLING_RADPS = math.radians(30.0)
_MOTORS_ON = 0.1


def stances_of(
    track: Track, instance: int, record: TurnRecord, horizontal_mgauss: float, vertical_mgauss: float
) -> tuple[Dwell, ...]:
    """Find up to 24 stretches in which the vehicle stood or hovered, such as follow a turn before all others.

    Raises BadRecording where there is none.
    """
    times = track.compasses[instance].time_s
    rate_hz = (times.size - 1) / max(float(times[-1] - times[0]), 1e-3)
    slow = max(_READINGS_HZ / rate_hz, 1.0)
    found = []
    for middle in _calm(track, record, _LONG_S * slow, times):
        stance = _dwell(track, instance, record, middle, _SHORT_S * slow)
        if stance is None or stance.heading_sigma_rad(horizontal_mgauss, vertical_mgauss) > _ENOUGH_RAD:
            stance = _dwell(track, instance, record, middle, _LONG_S * slow)
        if stance is not None:
            found.append(stance)
    if not found:
        raise BadRecording(
            "There is no stretch in which compass and gyro were recorded together.",
            "Record the vehicle standing or hovering for some seconds.",
        )
    return tuple(found)


def _dwell(track: Track, instance: int, record: TurnRecord, middle: float, length_s: float) -> Dwell | None:
    try:
        return dwell_between(track, instance, middle - 0.5 * length_s, middle + 0.5 * length_s, record)
    except PoorCalibration:
        return None


def _calm(track: Track, record: TurnRecord, length_s: float, times: FloatArray) -> list[float]:
    """Return the middles of calm stretches that do not overlap: after turns, the calmest, then others.

    What flies is looked at while it flies: on the ground it stands as it never will in the air.
    """
    middles = np.arange(times[0] + 0.5 * length_s, times[-1] - 0.5 * length_s, 0.25 * length_s)
    rates = np.hypot(record.rate_radps, record.tilt_rate_radps)
    moved = np.concatenate([[0.0], np.cumsum(0.5 * (rates[1:] + rates[:-1]) * np.diff(record.time_s))])
    around = [middles - 0.5 * length_s, middles + 0.5 * length_s]
    unrest = np.diff(np.interp(around, record.time_s, moved), axis=0)[0] / length_s
    rolled = np.concatenate([[0], np.cumsum(rolls(track, record.time_s))])
    # A calibration waits until the wheels have stopped.
    unrest[np.diff(rolled[np.searchsorted(record.time_s, around)], axis=0)[0] > 0] += _ROLLING_RADPS
    if track.vehicle == "copter" and track.throttle is not None and len(track.throttle):
        flying = np.nan_to_num(track.throttle.at(middles)) > _MOTORS_ON
        if flying.any():
            middles, unrest = middles[flying], unrest[flying]
    turning = np.append(-np.inf, record.time_s[np.abs(record.rate_radps) > _TURNING_RADPS])
    starts = middles - 0.5 * length_s
    since_s = starts - turning[np.searchsorted(turning, starts) - 1]
    settling = (since_s < _AFTERWARDS_S) & (unrest <= _CALM_RADPS)
    chosen: list[float] = []
    for i in np.lexsort((unrest, ~settling)):
        if len(chosen) == _MOST or (len(chosen) >= _FEWEST and not settling[i]):
            break
        if all(abs(middles[i] - other) >= length_s for other in chosen):
            chosen.append(float(middles[i]))
    return chosen
