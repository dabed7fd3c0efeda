"""Take back parameters of a chosen set that the data do not need."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from mavcompass.gap.fit.hypothesis import Fit
from mavcompass.gap.fit.model import Problem

_STEPS = 3
# Twice the gain that a useless parameter has on average.
_PRUNING = 2.0


def pruned(problem: Problem, fit: Fit) -> Fit:
    """Hold parameters at zero that the data do not need beside the others, one after another.

    Of several that could go, that one goes which leaves the smallest parameters in natural sizes.
    """
    if len(fit.terms) < 2:
        return fit
    while True:
        options = []
        for i, term in enumerate(fit.terms):
            if not term.effect.affine or term.dimension < 2:
                continue
            for j in np.flatnonzero(term.free):
                free = term.free.copy()
                free[j] = False
                theta = fit.thetas[i].copy()
                theta[j] = 0.0
                terms = (*fit.terms[:i], replace(term, free=free), *fit.terms[i + 1 :])
                thetas = (*fit.thetas[:i], theta, *fit.thetas[i + 1 :])
                trial = problem.fit(terms, thetas, fit.nuisance_thetas, _STEPS)
                if trial.sse < fit.sse + _PRUNING:
                    options.append(trial)
        if not options:
            return fit
        fit = min(options, key=_natural_size)


def _natural_size(fit: Fit) -> float:
    return sum(
        float(np.sum((x / np.maximum(t.effect.scale, 1e-12))[t.free] ** 2))
        for t, x in zip(fit.terms, fit.thetas, strict=True)
        if t.effect.affine
    )
