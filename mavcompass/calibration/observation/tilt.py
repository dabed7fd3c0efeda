"""The tilt of a still position, from all that tells it, each by what it is worth."""

from __future__ import annotations

import math

import numpy as np

from mavcompass.calibration.observation.rolling import HALF_S, WHEELED
from mavcompass.calibration.observation.sway import sway
from mavcompass.calibration.observation.wire import unquantise
from mavcompass.frames import FloatArray
from mavcompass.heading.gravity import down_in_body
from mavcompass.track import Track
from mavcompass.units import STANDARD_GRAVITY_MPS2

# What the ground, the suspension and the accelerometer's vibration add to a tilt averaged over a dwell.
TILT_FLOOR_RAD = math.radians(0.02)
# What the accelerometer's calibration leaves: one thousandth of gravity, the same at every position.
TILT_BIAS_SIGMA_RAD = 0.001
# What an autopilot's roll and pitch are off by while it flies by a compass that may be bent (ArduPilot 4.5.7,
# hovering: 0.13 degrees with a sound one, 0.29 with a badly bent one), and while it stands.
ESTIMATOR_SIGMA_RAD, _STANDING_ESTIMATOR_SIGMA_RAD = math.radians(0.3), math.radians(0.15)
# A mean specific force further from g than this is not gravity alone.
_GRAVITY_SLACK = 0.06
# What stands, floats or is held upright by its buoyancy, and a box of sensors of which nothing is known:
# there the accelerometer shows gravity.
UPHELD = frozenset({"rover", "ackermann-rover", "boat", "sub", "unknown"})


def tilt_during(
    track: Track, time_s: FloatArray, lag_sigma_s: float = 0.0
) -> tuple[float, float, float, FloatArray]:
    """Return roll, pitch, their sigma and the mean specific force over the stretch of some readings.

    `lag_sigma_s` is what is not known of the readings' times: it matters while the tilt changes.

    Three witnesses, weighed by their variance. The accelerometer's mean is gravity wherever the velocity is
    the same at both ends, but motors shake it and what hovers sways. Newton's law (`sway`) holds for
    anything with a gyro. The autopilot's roll and pitch are smooth, carry an error of their own that no
    averaging removes, and are bent by a bent compass in flight: they count for less by as much as they
    contradict the others beyond chance. Level where nothing was recorded.
    """
    start, end = float(time_s[0]), float(time_s[-1])
    force, shaking = _mean_force(track, start, end)
    moved = None if track.vehicle in UPHELD else sway(track, start, end)
    witnesses: list[tuple[FloatArray, float]] = []
    if abs(float(np.linalg.norm(force)) / STANDARD_GRAVITY_MPS2 - 1.0) < _GRAVITY_SLACK:
        swing = 0.0 if moved is None else moved.swing_rad
        witnesses.append((-force / np.linalg.norm(force), math.hypot(shaking, swing)))
    if moved is not None:
        witnesses.append((moved.down, moved.sigma_rad))
    _add_estimator(track, start, end, witnesses, may_be_bent=moved is not None)
    if not witnesses:
        witnesses.append((down_in_body(track, time_s).mean(axis=0), TILT_FLOOR_RAD))
    down, sigma = _weighed(witnesses)
    x, y, z = down
    sigma = math.hypot(sigma, *_swinging(down_in_body(track, time_s), end - start, lag_sigma_s))
    return math.atan2(y, z), math.atan2(-x, math.hypot(y, z)), sigma, force


def _weighed(witnesses: list[tuple[FloatArray, float]]) -> tuple[FloatArray, float]:
    """Average directions by their variance; the sigma grows where they contradict each other."""
    weights = np.array([1.0 / (sigma**2 + TILT_FLOOR_RAD**2) for _, sigma in witnesses])
    directions = np.array([direction for direction, _ in witnesses])
    mean = np.average(directions, axis=0, weights=weights)
    apart = ((directions - mean) ** 2).sum(axis=1) / 2.0
    excess = float(weights @ apart) / max(len(witnesses) - 1, 1)
    return mean, math.sqrt(max(excess, 1.0) / float(weights.sum()))


def _swinging(down: FloatArray, length_s: float, lag_sigma_s: float) -> tuple[float, float]:
    """Return what a swing of the tilt leaves unknown of its mean: by being no small angle, and by the lag."""
    bend = 0.5 * float(((down - down.mean(axis=0)) ** 2).sum(axis=1).mean())
    moved = float(np.linalg.norm(down[-1] - down[0]))
    return bend, moved * lag_sigma_s / max(length_s, 1e-3)


def _add_estimator(
    track: Track, start: float, end: float, witnesses: list[tuple[FloatArray, float]], may_be_bent: bool
) -> None:
    """Add the autopilot's roll and pitch to the witnesses."""
    attitude = track.attitude_rad
    if attitude is None:
        return
    during = attitude.between(start, end + 1e-9).values[:, :2]
    during = during[np.isfinite(during).all(axis=1)]
    if len(during) < 3:
        return
    roll, pitch = during.T
    down = np.stack([-np.sin(pitch), np.cos(pitch) * np.sin(roll), np.cos(pitch) * np.cos(roll)], axis=1)
    swing = float(np.linalg.norm(down - down.mean(axis=0), axis=1).std())
    own_sigma = ESTIMATOR_SIGMA_RAD if may_be_bent else _STANDING_ESTIMATOR_SIGMA_RAD
    sigma = math.hypot(own_sigma, swing / math.sqrt(len(during)))
    if may_be_bent:
        others, others_sigma = _weighed(witnesses)
        apart = float(((down.mean(axis=0) - others) ** 2).sum()) / 2.0
        sigma = math.sqrt(sigma**2 + max(apart - sigma**2 - others_sigma**2, 0.0))
    witnesses.append((down.mean(axis=0), sigma))


def _mean_force(track: Track, start: float, end: float) -> tuple[FloatArray, float]:
    """Return the mean specific force (3,) over a stretch and the direction sigma of it; nan for none."""
    acc = track.acc_mps2
    if acc is not None and len(acc):
        values = np.asarray(acc.between(start, end + 1e-9).values)
        values = values[np.isfinite(values).all(axis=1)]
        if len(values) >= 3:
            spread = values.std(axis=0)
            mean, hidden = unquantise(values.mean(axis=0), spread, track.acc_truncation_mps2, True)
            interval = (end - start) / max(len(values) - 1, 1)
            # Shaking lasts about 50 ms.
            memory = max(1.0, 0.05 / max(interval, 1e-4))
            shaking = float(spread.max()) * math.sqrt(memory / len(values))
            if track.vehicle in WHEELED:
                shaking = max(shaking, _uneven(values, start, end))
            return mean, math.hypot(shaking, float(hidden[:2].max())) / STANDARD_GRAVITY_MPS2
    return np.full(3, np.nan), math.nan


def _uneven(values: FloatArray, start: float, end: float) -> float:
    """Return the sigma of a mean force by how its quarters of a second differ: wheels roll for longer."""
    blocks = np.array_split(values, min(max(round((end - start) / HALF_S), 1), len(values)))
    means = np.array([block.mean(axis=0) for block in blocks])
    if len(means) < 2:
        return 0.0
    return float(means.std(axis=0, ddof=1)[:2].max()) / math.sqrt(len(means))
