"""Does what has wheels still roll? While it brakes its accelerometer does not show gravity alone.

Steered wheels that go straight may still roll: no gyro sees that, while a braking of 1 m/s^2 leans the
accelerometer's down by six degrees, alike at every stop. It is seen where it begins and ends: there the
specific force changes by more than the body's turning explains.
"""

from __future__ import annotations

import math
from collections import deque

import numpy as np
from numpy.typing import NDArray

from mavcompass.attitude import moving_average
from mavcompass.calibration.observation.wire import white_noise
from mavcompass.frames import FloatArray
from mavcompass.track import Track

WHEELED = frozenset({"rover", "ackermann-rover"})
# The mean forces of so long before and after a moment are compared.
HALF_S = 0.25
# A change of this much leans the accelerometer by half a degree; what chance gives is no change.
_LEAST_STEP_MPS2, _CHANCE = 0.08, 5.0


def least_step_mps2(noise_mps2: float, readings: float) -> float:
    """Return from where on a change of the mean force is one, for means of so many noisy readings each."""
    return math.hypot(_LEAST_STEP_MPS2, _CHANCE * noise_mps2 * math.sqrt(2.0 / max(readings, 1.0)))


def force_step(before_mps2: FloatArray, after_mps2: FloatArray, turned_rad: FloatArray) -> FloatArray:
    """Return how much the specific force changed beyond what the body's turn, (..., 3) each, makes of it."""
    still = 0.5 * (np.asarray(before_mps2) + np.asarray(after_mps2))
    step = np.asarray(after_mps2) - np.asarray(before_mps2) + np.cross(turned_rad, still)
    return np.asarray(np.linalg.norm(step, axis=-1))


class RollingWitness:
    """Tell live, reading by reading, whether a vehicle on wheels brakes or gathers way."""

    def __init__(self) -> None:
        self._felt: deque[tuple[float, ...]] = deque()  # time, force, angle turned

    def hear(self, time_s: float, gyro_radps: tuple[float, ...], acc_mps2: tuple[float, ...]) -> None:
        """Take the next reading, body axes."""
        angle = [0.0, 0.0, 0.0]
        if self._felt:
            before = self._felt[-1]
            lasted_s = time_s - before[0]
            angle = [a + lasted_s * rate for a, rate in zip(before[4:], gyro_radps, strict=True)]
        self._felt.append((time_s, *acc_mps2, *angle))
        while self._felt[0][0] < time_s - 2.0 * HALF_S:
            self._felt.popleft()

    def rolls(self, noise_mps2: float) -> bool:
        """Tell whether the force of the last quarter of a second is another than that of the one before."""
        felt = np.array(self._felt)
        late = felt[:, 0] > felt[-1, 0] - HALF_S
        if late.all() or not np.isfinite(felt).all():
            return False
        before, after = felt[~late].mean(axis=0), felt[late].mean(axis=0)
        step = force_step(before[1:4], after[1:4], after[4:] - before[4:])
        fewest = min(late.sum(), (~late).sum())
        return bool(step > least_step_mps2(noise_mps2, float(fewest)))


def rolls(track: Track, time_s: FloatArray) -> NDArray[np.bool_]:
    """Mark the moments (N,) at which a vehicle on wheels brakes or gathers way; none of any other vehicle."""
    acc, gyro = track.acc_mps2, track.gyro_radps
    none = np.zeros(time_s.size, dtype=np.bool_)
    if track.vehicle not in WHEELED or acc is None or gyro is None or time_s.size < 3:
        return none
    usable = np.isfinite(acc.values).all(axis=1)
    if usable.sum() < 8:
        return none
    felt_at, felt = acc.time_s[usable], np.asarray(acc.values)[usable]
    rate = np.nan_to_num(np.asarray(gyro.at(felt_at)))
    turned = _integral(felt_at, rate)
    force, angle = (moving_average(felt_at, values, HALF_S) for values in (felt, turned))

    def at(values: FloatArray, later_s: float) -> FloatArray:
        return np.stack([np.interp(time_s + later_s, felt_at, column) for column in values.T], axis=1)

    earlier, later = -0.5 * HALF_S, 0.5 * HALF_S
    step = force_step(at(force, earlier), at(force, later), at(angle, later) - at(angle, earlier))
    noise = float(np.linalg.norm(white_noise(felt_at, felt))) / math.sqrt(3.0)
    readings = HALF_S / max(float(np.median(np.diff(felt_at))), 1e-3)
    return np.asarray(step > least_step_mps2(noise, readings))


def _integral(time: FloatArray, values: FloatArray) -> FloatArray:
    """Integrate over time from the first sample on by the trapezoid's rule, along axis 0."""
    steps = np.diff(time).reshape(-1, *[1] * (values.ndim - 1))
    parts = 0.5 * (values[1:] + values[:-1]) * steps
    return np.concatenate([np.zeros((1, *values.shape[1:])), np.cumsum(parts, axis=0)])
