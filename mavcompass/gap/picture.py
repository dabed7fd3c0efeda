"""What the report draws: the residuals before and after with their coordinates, and the spectra."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from mavcompass.frames import FloatArray
from mavcompass.gap.hypothesis import Fit
from mavcompass.gap.locate import coordinates
from mavcompass.gap.model import Problem


@dataclass(frozen=True, slots=True, eq=False)
class Picture:
    """Hold arrays for plots.

    Attributes:
        time_s: (N,); valid, test: rows with data, rows held out.
        before_mgauss, after_mgauss: residual of the field without and with the effects, (N, 3).
        coordinates: values (N,) and unit by name; tilt and heading in degrees among them.
        floor_mgauss: the noise of each axis, (3,).
        innovations: what is left, in sigmas, (N, 3).
    """

    time_s: FloatArray
    valid: NDArray[np.bool_]
    test: NDArray[np.bool_]
    before_mgauss: FloatArray
    after_mgauss: FloatArray
    coordinates: dict[str, tuple[FloatArray, str]]
    floor_mgauss: FloatArray
    innovations: FloatArray


def picture(problem: Problem, fit: Fit, test: NDArray[np.bool_]) -> Picture:
    """Collect what the report draws."""
    replay = problem.replay
    before = replay.measured.mag_mgauss - problem.predict(fit, effects=False).mag_mgauss
    predicted = problem.predict(fit)
    return Picture(
        time_s=replay.time_s,
        valid=replay.valid,
        test=test,
        before_mgauss=before,
        after_mgauss=replay.measured.mag_mgauss - predicted.mag_mgauss,
        coordinates=coordinates(problem),
        floor_mgauss=problem.noise["mag"].rms,
        innovations=problem.innovations(predicted)["mag"],
    )
