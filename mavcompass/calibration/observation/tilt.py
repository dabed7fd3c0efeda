"""The tilt of a still position."""

from __future__ import annotations

import math

import numpy as np

from mavcompass.attitude import levels
from mavcompass.calibration.observation.wire import unquantise
from mavcompass.frames import FloatArray
from mavcompass.track import Track

# What the ground, the suspension and the accelerometer's vibration add to a tilt averaged over a dwell.
TILT_FLOOR_RAD = math.radians(0.02)
# What the accelerometer's calibration leaves: one thousandth of gravity, the same at every position.
TILT_BIAS_SIGMA_RAD = 0.001


def tilt_during(
    track: Track, time_s: FloatArray, lag_sigma_s: float = 0.0
) -> tuple[float, float, float, FloatArray]:
    """Return roll, pitch, their sigma and the mean specific force over the stretch of some readings.

    `lag_sigma_s` is what is not known of the readings' times: it matters while the tilt changes.
    """
    start, end = float(time_s[0]), float(time_s[-1])
    level = levels(track)
    downs = level.at(time_s)
    down = downs.mean(axis=0)
    x, y, z = down
    sigma = float(np.sqrt((level.sigma_rad.at(time_s) ** 2).mean()))
    # The mean of a swing is that of other moments where the times are off.
    moved = float(np.linalg.norm(downs[-1] - downs[0])) * lag_sigma_s / max(end - start, 1e-3)
    sigma = math.hypot(sigma, TILT_FLOOR_RAD, moved)
    return math.atan2(y, z), math.atan2(-x, math.hypot(y, z)), sigma, _mean_force(track, start, end)


def _mean_force(track: Track, start: float, end: float) -> FloatArray:
    """Return the mean specific force (3,) over a stretch; nan for none."""
    acc = track.acc_mps2
    values = np.empty((0, 3)) if acc is None else np.asarray(acc.between(start, end + 1e-9).values)
    values = values[np.isfinite(values).all(axis=1)]
    if len(values) < 3:
        return np.full(3, np.nan)
    return unquantise(values.mean(axis=0), values.std(axis=0), track.acc_truncation_mps2, True)[0]
