"""Where a fit begins: the first heading is tried all round, and the rest is linear then."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from mavcompass.calibration.model import GAIN, HEADINGS, HORIZONTAL, OFFSET, VERTICAL
from mavcompass.calibration.rigid import PriorRows, Readings
from mavcompass.correction import FieldCorrection
from mavcompass.earth_field import EarthField
from mavcompass.frames import FloatArray

_STARTS, _CLOSELY = 12, 11
# Of the horizontal field: by so much a reading may be off where nothing is fitted yet.
_ROUGHLY = 0.1


class FirstState(NamedTuple):
    """Hold where a fit begins: its state, the prior's rows, and the squares that it leaves, mG^2, robust."""

    state: FloatArray
    rules: PriorRows
    left_mgauss2: float

    def cost(self, field_mgauss: float) -> float:
        """Return half the squared residuals, prior included, if readings may be off by a tenth of a field."""
        held = self.rules.of(self.state)
        return 0.5 * (self.left_mgauss2 / (_ROUGHLY * field_mgauss) ** 2 + float(held @ held))


def swing_mgauss(field_mgauss: FloatArray) -> float:
    """Return half of how far a field (K, N) moves on the axis where it moves most."""
    return 0.5 * float(np.ptp(np.percentile(field_mgauss, [5.0, 95.0], axis=0), axis=0).max())


def rough_field(
    mean_mgauss: FloatArray, earth: EarthField | None, in_force: FieldCorrection
) -> tuple[float, float]:
    """Return the horizontal and the vertical field: the model's, else as mean readings (K, 3) show it."""
    if earth is not None:
        return earth.horizontal_mgauss, float(earth.ned_mgauss[2])
    field = in_force.apply(mean_mgauss)
    return max(swing_mgauss(field[:, :2]), 1.0), float(np.median(field[:, 2]))


def first_state(
    readings: Readings, rules: PriorRows, field_mgauss: tuple[float, float], first_rad: float | None = None
) -> FirstState:
    """Find a first state of readings (K); `first_rad` is the first heading, where that is known.

    Half a turn away and all gains negative the field is the same, and only the prior tells: near the best and
    opposite to it the heading is tried closely, so that what it is off by weighs less than that.
    """
    x = np.zeros(rules.rows.shape[1])
    x[GAIN], (x[HORIZONTAL], x[VERTICAL]) = (1.0, 1.0, 1.0, 0.0, 0.0, 0.0), field_mgauss

    def tried(starts_rad: FloatArray) -> FirstState:
        headings = starts_rad[:, np.newaxis] + readings.turned_rad - readings.turned_rad[0]
        return _likeliest(readings, x, headings, rules)

    if first_rad is not None:
        return tried(np.array([first_rad]))
    step = 2.0 * math.pi / _STARTS
    first = tried(step * np.arange(_STARTS, dtype=np.float64)).state[HEADINGS]
    near = first + np.linspace(-0.5, 0.5, _CLOSELY) * step
    return tried(np.concatenate([near, near + math.pi]))


def _likeliest(readings: Readings, x: FloatArray, headings_rad: FloatArray, rules: PriorRows) -> FirstState:
    """Solve for the linear part at several headings, (S, K), robustly; return the state of least cost."""
    noise = _ROUGHLY * x[HORIZONTAL]
    residual, by = readings.linear(x, headings_rad)
    trials, linear = len(headings_rad), np.r_[OFFSET, GAIN, readings.motor]
    by, residual = by.reshape(trials, -1, linear.size) / noise, residual.reshape(trials, -1) / noise
    held, off = rules.rows[:, linear], rules.of(x)
    found, weights = np.zeros((trials, linear.size)), np.ones(residual.shape)
    for _ in range(3):
        weighed = np.swapaxes(by * weights[:, :, np.newaxis], 1, 2)
        pull = (weighed @ residual[:, :, np.newaxis])[:, :, 0] - (off + found @ held.T) @ held
        step = np.linalg.solve(weighed @ by + held.T @ held, pull[:, :, np.newaxis])
        found += step[:, :, 0]
        residual = residual - (by @ step)[:, :, 0]
        size = np.linalg.norm(residual.reshape(trials, -1, 3), axis=2)
        usual = np.maximum(2.0 * np.median(size, axis=1, keepdims=True), 1e-6 / noise)
        trust = 1.0 / np.maximum(1.0, size / usual)
        weights = np.repeat(trust, 3, axis=1)
    left = (trust * size**2).sum(axis=1)
    best = int(np.argmin(left + ((off + found @ held.T) ** 2).sum(axis=1)))
    x = x.copy()
    x[linear] += found[best]
    x[HEADINGS : HEADINGS + len(readings)] = headings_rad[best]
    return FirstState(x, rules, noise**2 * float(left[best]))
