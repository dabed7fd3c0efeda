"""Direct evidence: what a drastic cause must show by itself, however well it fits what is left."""

from __future__ import annotations

import math

import numpy as np

from mavcompass.gap.fit import Fit, Mask, Problem
from mavcompass.gap.selection.transient import between, switched_field

STEP = "hard_iron_step"
# Readings so near to a switching, on either side, tell what it changes: less than half is nothing.
_NEAR_S, _HALF, _SURE = 3.0, 0.5, 2.0
# A step that is there as a load is, in so many of the readings with it and without, is the load's.
_TOGETHER = 0.95
# A load and its field come within so much of each other.
_EDGE_S, _EDGE_ROWS = 1.0, 1.5


def unswitched(problem: Problem, fit: Fit) -> bool:
    """Tell whether the field stays as it is where something that a fit calls switched is switched.

    What is on for nearly all of the time, or off, is a constant that fits a field or an iron. Readings close
    before and after each switching have the same attitude, place and iron; what changes is what is switched.
    """
    place = next((i for i, term in enumerate(fit.terms) if term.effect.switched), None)
    if place is None:
        return False
    own = fit.thetas[place][:3]
    size = float(np.linalg.norm(own))
    if size == 0.0:
        return False
    on = np.abs(switched_field(problem, fit.terms[place], fit.thetas[place])).max(axis=1) > 0.0
    error = problem.replay.measured.mag_mgauss - problem.predict(fit.without(place)).mag_mgauss
    along = error @ own / size**2
    time, clear = problem.replay.time_s, problem.usable & ~between(problem, fit)
    row = np.arange(time.size)
    total = weights = 0.0
    for last in np.flatnonzero(np.diff(on.astype(np.int8))):
        near = clear & (np.abs(time - 0.5 * (time[last] + time[last + 1])) < _NEAR_S)
        before = along[near & (row <= last) & (on == on[last])]
        after = along[near & (row > last) & (on != on[last])]
        if before.size and after.size:
            weight = 1.0 / (1.0 / before.size + 1.0 / after.size)
            change = float(after.mean() - before.mean())
            total += weight * (-change if on[last] else change)
            weights += weight
    if weights == 0.0:
        return False
    doubt = float(problem.sigma_mgauss.mean()) / size / math.sqrt(weights)
    return total / weights + _SURE * doubt < _HALF


def goes_with_a_load(problem: Problem, fit: Fit) -> bool:
    """Tell whether an iron that comes or goes is there just while a load is: it is the load's field."""
    if STEP not in fit.ids:
        return False
    term = next(term for term in fit.terms if term.effect.id == STEP)
    at = dict(zip(term.effect.names, fit.theta(STEP), strict=True))
    stimulus = problem.replay.signals.stimulus
    width = max(_EDGE_S, _EDGE_ROWS * float(np.median(np.diff(stimulus.time_s))))
    clear = np.abs(stimulus.time_s[:, None] - [at["on_s"], at["off_s"]]).min(axis=1) > width
    rows = problem.usable & clear
    time = stimulus.time_s[rows]
    there: Mask = (time >= at["on_s"]) & (time < at["off_s"])
    if there.all() or not there.any():
        return False
    loads = [stimulus.throttle, stimulus.current_a, *np.abs(stimulus.motors.T)]
    for load in (load[rows] for load in loads if np.isfinite(load[rows]).all()):
        inside, outside = float(load[there].mean()), float(load[~there].mean())
        if inside != outside:
            running = (load > 0.5 * (inside + outside)) == (inside > outside)
            if min(running[there].mean(), 1.0 - running[~there].mean()) > _TOGETHER:
                return True
    return False
