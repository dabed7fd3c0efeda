"""What is known of vehicle, place and attitude, where a gap has bent it far in a fit without effects."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from mavcompass.frames import FloatArray
from mavcompass.gap.fit.chance import least_gain
from mavcompass.gap.fit.hypothesis import Fit
from mavcompass.gap.fit.model import Problem
from mavcompass.gap.replay import REFERENCE_YAW, TELEMETRY_AGE, Nuisance


def unbent(problem: Problem, fit: Fit, curves: bool = False) -> Fit:
    """Return nuisances to their prior where a gap has bent them far: what is wrong must show to be
    found. How the attitude wanders explains nothing away, but beside bent `curves` no derivative is
    good."""
    if fit.terms or not problem.nuisances:
        return fit
    straight = problem.straight(fit)

    def kept_of(n: Nuisance, x: FloatArray) -> FloatArray:
        if n.effect.id == REFERENCE_YAW:
            return _facing_as_known(n, x, curves)
        # How old readings are is another matter than the iron and the place that a gap may bend.
        aged = n.effect.id == TELEMETRY_AGE and _by_chance(n, x)
        return x if straight or aged else n.mean.copy()

    kept = tuple(kept_of(n, x) for n, x in zip(problem.nuisances, fit.nuisance_thetas, strict=True))
    same = all(np.array_equal(x, y) for x, y in zip(kept, fit.nuisance_thetas, strict=True))
    return fit if same else replace(fit, nuisance_thetas=kept)


def _facing_as_known(yaw: Nuisance, theta: FloatArray, curves: bool) -> FloatArray:
    """Return the yaw's constant to what is known of it where it was bent far, and the attitude's `curves`
    where they wandered farther than by chance."""
    off, out = theta - yaw.mean, theta.copy()
    if off[0] ** 2 * yaw.precision[0, 0] >= least_gain(1):
        out[0] = yaw.mean[0]
    if curves and off[1:] @ yaw.precision[1:, 1:] @ off[1:] >= least_gain(theta.size - 1):
        out[1:] = yaw.mean[1:]
    return out


def _by_chance(nuisance: Nuisance, theta: FloatArray) -> bool:
    """Tell whether a nuisance by itself lies no farther from what is known of it than by chance."""
    off = theta - nuisance.mean
    return float(off @ nuisance.precision @ off) < least_gain(theta.size)
