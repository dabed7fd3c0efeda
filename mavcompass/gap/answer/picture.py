"""What the report draws: the residuals before and after with their coordinates, and the spectra."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from mavcompass.gap.answer.locate import coordinates
from mavcompass.gap.fit import Fit, Problem
from mavcompass.gap.result import Picture


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
