"""What the calibration in force already cures of the causes that were found in the raw sensor."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from mavcompass.gap.floor import rms
from mavcompass.gap.hypothesis import Fit
from mavcompass.gap.model import Problem
from mavcompass.gap.result import Cause

_WHOLLY, _NOT = 0.9, 0.1


def with_cures(causes: tuple[Cause, ...], problem: Problem, fit: Fit) -> tuple[Cause, ...]:
    """Say of each fitted cause which share of it the calibration in force takes away.

    With e_i what effect i adds to the raw field and c what the calibration takes away, c = sum of k_i e_i by
    least squares. k_i = 1 cures the effect; 0 leaves it, and 2 leaves as much with the other sign.
    """
    corrected = problem.replay.corrected_mgauss
    if corrected is None or not fit.terms:
        return causes
    rows = problem.index
    whole = problem.predict(fit).mag_mgauss[rows]
    traces = []
    for i in range(len(fit.terms)):
        traces.append((whole - problem.predict(fit.without(i)).mag_mgauss[rows]).ravel())
    taken = (problem.replay.measured.mag_mgauss - corrected)[rows].ravel()
    shares, *_ = np.linalg.lstsq(np.stack(traces, axis=1), taken, rcond=1e-9)
    cured = {
        term.effect.id: float(np.clip(1.0 - abs(1.0 - share), 0.0, 1.0))
        for term, share, trace in zip(fit.terms, shares, traces, strict=True)
        if trace.any()
    }
    return tuple(replace(c, cured=cured.get(c.effect)) for c in causes)


def corrected_rms(problem: Problem, fit: Fit, rows: NDArray[np.bool_]) -> float | None:
    """Return the rms of corrected readings less the simulation without effects; None where not corrected."""
    corrected = problem.replay.corrected_mgauss
    if corrected is None:
        return None
    return rms((corrected - problem.predict(fit, effects=False).mag_mgauss)[rows])


def words(cause: Cause) -> str | None:
    """Put the cure of a cause into a sentence; None where no calibration is in force."""
    if cause.cured is None:
        return None
    if wholly_cured((cause,)):
        return "The calibration in force cures it: the vehicle needs nothing, a simulator of it does."
    if cause.cured <= _NOT:
        return "The calibration in force does not cure it."
    return f"The calibration in force cures {100.0 * cause.cured:.0f} % of it."


def wholly_cured(causes: tuple[Cause, ...]) -> bool:
    """Tell whether the calibration in force cures all that was found."""
    return bool(causes) and all(c.cured is not None and c.cured >= _WHOLLY for c in causes)
