"""A line in the readings of a vehicle that drives: of its time, or of something that turns with its way?"""

from __future__ import annotations

import math

import numpy as np

from mavcompass.frames import FloatArray
from mavcompass.gap.attitude import integral
from mavcompass.gap.replay import Replay
from mavcompass.simulation.physics.signals import Stimulus

# A line keeps step with a way that is within so much of a turn of an even one, as far as that is known: a
# receiver's velocity errs by so much for a second, and its sum, less a straight line, by root of time / 15.
_IN_STEP, _DRIVING_MPS, _UNKNOWN_SHARE = 0.25, 0.3, 0.1
_RECEIVER_MPS, _RECEIVER_S = 0.1, 1.0
# Stretches over which a receiver's way is good to a turn; what turns on a vehicle has a circumference of so
# many metres, and as many readings as a line needs.
_STRETCH_S, _CIRCUMFERENCES_M, _FEWEST = 8.0, (0.2, 3.0), 20
# Circumferences beside that of the mean speed, as shares of it, and how well the way must explain a line.
_BESIDE, _AS_WELL = np.linspace(0.85, 1.15, 31), 0.95


def keeps_step(replay: Replay, frequency_hz: float) -> bool:
    """Tell whether a line goes with the way of a vehicle as well as with the time: it drives evenly."""
    stimulus = replay.signals.stimulus
    speed = _speed_mps(stimulus)
    if speed is None:
        return False
    time = stimulus.time_s
    way = integral(time, speed[:, None])[:, 0]
    off = way - np.polyval(np.polyfit(time, way, 1), time)
    known_m = _RECEIVER_MPS * math.sqrt(_RECEIVER_S * float(np.ptp(time)) / 15.0)
    rms_m = float(np.sqrt(np.mean(off**2)))
    return rms_m < math.hypot(_IN_STEP * float(speed.mean()) / frequency_hz, known_m)


def follows_way(replay: Replay, line_mgauss: FloatArray, frequency_hz: float) -> bool:
    """Tell whether a line that was taken out of the readings (M, 3) goes with the vehicle's way no worse.

    However the vehicle drives: its power by the time and by the way, over some seconds each, where no error
    of a receiver's way counts. A sampled line may be one of a higher frequency.
    """
    stimulus, readings = replay.signals.stimulus, replay.readings
    speed = _speed_mps(stimulus)
    if speed is None:
        return False
    time, field = readings.time_s, readings.error_mgauss + line_mgauss
    way = integral(time, np.interp(time, stimulus.time_s, speed)[:, None])[:, 0]
    sampling_hz, mean_mps = 1.0 / readings.period_s, float(speed.mean())
    may_be_hz = (frequency_hz, sampling_hz - frequency_hz, sampling_hz + frequency_hz)
    turns_per_m = np.outer(may_be_hz, _BESIDE).ravel() / mean_mps
    low, high = _CIRCUMFERENCES_M
    turns_per_m = turns_per_m[(turns_per_m * low < 1.0) & (turns_per_m * high > 1.0)]
    by_time = _power(time, field, frequency_hz * time[:, None])
    by_way = _power(time, field, way[:, None] * turns_per_m)
    return bool(by_way.max(initial=0.0) > _AS_WELL * by_time[0])


def _power(time_s: FloatArray, field_mgauss: FloatArray, turns: FloatArray) -> FloatArray:
    """Return the power of a field (M, 3) by phases (M, k) in turns, summed over stretches, (k,)."""
    stretch = np.floor((time_s - time_s[0]) / _STRETCH_S)
    total = np.zeros(turns.shape[1])
    for one in np.unique(stretch):
        rows = stretch == one
        if rows.sum() < _FEWEST:
            continue
        since = time_s[rows] - time_s[rows].mean()
        around = field_mgauss[rows] - field_mgauss[rows].mean(axis=0)
        around -= np.outer(since, since @ around / (since @ since))
        window = np.hanning(rows.sum() + 2)[1:-1, None]
        waves = np.exp(-2j * np.pi * turns[rows])
        total += np.sum(np.abs(waves.T @ (window * around)) ** 2, axis=1)
    return total


def _speed_mps(stimulus: Stimulus) -> FloatArray | None:
    """Return the level speed (N,) of a vehicle that drives; None where it does not, or nobody tells."""
    time, velocity = stimulus.time_s, stimulus.velocity_ned_mps
    if not np.isfinite(velocity).any():
        velocity = np.gradient(stimulus.position_ned_m, time, axis=0)
    speed = np.linalg.norm(velocity[:, :2], axis=1)
    known = np.isfinite(speed)
    if known.mean() < 1.0 - _UNKNOWN_SHARE or float(speed[known].mean()) < _DRIVING_MPS:
        return None
    return np.asarray(np.interp(time, time[known], speed[known]))
