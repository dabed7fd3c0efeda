"""How late the gyro is beside the autopilot's attitude."""

from __future__ import annotations

import numpy as np

from mavcompass.frames import FloatArray

_AGE_STEP_S, _LONGEST_AGE_S, _LEAST_TURNING_RADPS = 0.01, 0.2, 0.05
# An age that there is leaves half of what none leaves, or less; one that even turns do not show, nearly all.
_LEFT = 0.8


def age_of(clock: FloatArray, rate: FloatArray, when: FloatArray, yaw: FloatArray) -> float | None:
    """Return how late a rate (N,) is beside the rate of another yaw (M,), seconds; None where turns hide it.

    What bends that yaw with the heading changes how fast it turns, by sines of it, and not when: of all ages
    that one is right which leaves least beside such a bend.
    """
    step = max(float(np.median(np.diff(clock))), _AGE_STEP_S)
    grid = np.arange(max(clock[0], when[0]), min(clock[-1], when[-1]), step)
    if grid.size < 100:
        return None
    heading = np.interp(grid, when, yaw)
    other = np.gradient(heading, step)
    if float(other.std()) < _LEAST_TURNING_RADPS:
        return None
    lags = np.arange(-_LONGEST_AGE_S, _LONGEST_AGE_S + 1e-9, _AGE_STEP_S)
    edge = round(_LONGEST_AGE_S / step) + 1
    inner = slice(edge, -edge)
    bends = np.stack(
        [np.ones_like(heading), *(f(k * heading) for k in (1, 2) for f in (np.cos, np.sin))], axis=1
    )
    left = []
    for lag in lags:
        design = (np.interp(grid + lag, clock, rate)[:, None] * bends)[inner]
        normal = design.T @ design + 1e-9 * np.eye(bends.shape[1])
        score = design.T @ other[inner]
        left.append(float(other[inner] @ other[inner] - score @ np.linalg.solve(normal, score)))
    best, none = int(np.argmin(left)), int(np.argmin(np.abs(lags)))
    shown = 0 < best < lags.size - 1 and left[best] < _LEFT * left[none]
    return float(lags[best]) if shown else None
