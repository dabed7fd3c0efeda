"""Put the named effects in words that a person can use: values, intervals, probabilities, rivals."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import replace

import numpy as np

from mavcompass.gap.answer.intervals import intervals
from mavcompass.gap.fit import Fit, make_term
from mavcompass.gap.left import Scatter, apart
from mavcompass.gap.result import Cause
from mavcompass.gap.selection import Identified
from mavcompass.gap.traces import Traces
from mavcompass.simulation.effects import detected_by, get


def named_causes(
    identified: Identified, fit: Fit, weights: Mapping[frozenset[str], float]
) -> tuple[Cause, ...]:
    """Describe the effects of a fit: values, intervals, probability, rivals; the largest first.

    `weights` are those of the sets of effects that could explain the gap.
    """
    problem = identified.problem
    replay, held_out = problem.replay, identified.split.test & problem.usable
    rows = np.flatnonzero(held_out) if held_out.any() else problem.index
    measured = replay.measured.mag_mgauss
    after = apart(replay, measured, problem.predict(fit).mag_mgauss, rows)
    out = []
    told = intervals(problem, fit)
    for i, (term, theta) in enumerate(zip(fit.terms, fit.thetas, strict=True)):
        left = apart(replay, measured, problem.predict(fit.without(i)).mag_mgauss, rows)
        field, heading = (math.sqrt(max(a**2 - b**2, 0.0)) for a, b in zip(left, after, strict=True))
        others = sorted({effect for ids in weights if term.effect.id not in ids for effect in ids - fit.ids})
        free = make_term(term.effect, problem.replay.signals).free
        shown = {
            p.name: float(value)
            for p, value, f in zip(term.effect.parameters, theta, free, strict=True)
            if f or p.integer or p.scale == 0.0
        }
        out.append(
            Cause(
                effect=term.effect.id,
                parameters=shown,
                ci95={name: told[i][name] for name in shown},
                probability=sum(weight for ids, weight in weights.items() if term.effect.id in ids),
                ambiguous_with=tuple(others),
                separation=identified.posterior.without(term.effect.id),
                removes_mgauss=field,
                removes_deg=heading,
            )
        )
    return tuple(sorted(out, key=lambda c: -c.removes_mgauss))


def trace_causes(scatter: Scatter | None, traces: Traces, level_mgauss: float) -> tuple[Cause, ...]:
    """Describe effects that single readings told, in a level field."""
    found = [_read_off(r.effect, r.parameters, r.sigma, math.sqrt(r.variance_mgauss2)) for r in traces.rapid]
    if traces.step_mgauss > 0.0:
        step = traces.step_mgauss
        found.insert(
            0, _of_size(detected_by("steps").id, step, traces.step_doubt_mgauss, step / math.sqrt(12.0))
        )
    if traces.stale_share > 0.0:
        found.insert(0, _of_size(detected_by("repeats").id, traces.stale_share, traces.stale_doubt, 0.0))
    if scatter is not None:
        removes = scatter.size if scatter.white else 0.0
        found.insert(0, _of_size(scatter.effect, scatter.size, scatter.doubt, removes))
    return tuple(
        replace(cause, removes_deg=math.degrees(cause.removes_mgauss / level_mgauss)) for cause in found
    )


def _of_size(effect: str, size: float, doubt: float, removes_mgauss: float) -> Cause:
    name = get(effect).names[0]
    return _read_off(effect, {name: size}, {name: doubt}, removes_mgauss)


def _read_off(
    effect: str, values: Mapping[str, float], sigma: Mapping[str, float], removes_mgauss: float
) -> Cause:
    doubts = {name: 1.96 * sigma.get(name, 0.0) for name in values}
    ends = {name: (value - doubts[name], value + doubts[name]) for name, value in values.items()}
    return Cause(effect, values, ends, 1.0, (), removes_mgauss=removes_mgauss)
