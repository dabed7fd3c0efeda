"""Put the named effects in words that a person can use: values, 95 % intervals, probabilities, rivals."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import replace

import numpy as np

from mavcompass.frames import FloatArray
from mavcompass.gap.fit.hypothesis import Fit, make_term
from mavcompass.gap.fit.model import Problem
from mavcompass.gap.left.floor import apart
from mavcompass.gap.result import Cause
from mavcompass.gap.selection.posterior import Identified
from mavcompass.gap.selection.transient import between_rows
from mavcompass.simulation.effects.effect import MOMENTS, NEVER_S, Parameter

_SIGMAS = 1.96
# Twice the logarithm of the likelihood that a value costs at the end of its interval.
_COST = _SIGMAS**2
# A value without a derivative is followed in steps that grow, and its end closed in on by halving.
_FIRST_STEP, _GROWTH, _HALVINGS = 1e-3, 4.0, 12

_Interval = tuple[float, float]


def intervals(problem: Problem, fit: Fit) -> list[dict[str, _Interval]]:
    """Return the 95 % interval of each parameter of each effect of a fit.

    Of what was fitted it is that of errors that may last for seconds (`Problem.lasting_covariance`); of what
    the fit does without, that of a fit with it; of what has no derivative, as a threshold, the values that
    fit as well (Venzon and Moolgavkar, Applied Statistics 37, 1988, with the other values held).
    """
    if not fit.terms:
        return []
    whole = replace(fit, terms=tuple(make_term(t.effect, problem.replay.signals) for t in fit.terms))
    sigmas = _sigmas(problem, whole)
    for term, needed, sigma in zip(fit.terms, _sigmas(problem, fit), sigmas, strict=True):
        sigma[term.free] = needed[term.free]
    out = []
    for place, (term, theta) in enumerate(zip(fit.terms, fit.thetas, strict=True)):
        told = {}
        for i, parameter in enumerate(term.effect.parameters):
            value, off = float(theta[i]), float(sigmas[place][i])
            if parameter.scale == 0.0 and not parameter.integer:
                told[parameter.name] = _as_well(_cost(problem, fit, place, i), parameter, value)
            else:
                told[parameter.name] = _interval(problem, parameter, value, off)
        out.append(told)
    return out


def _sigmas(problem: Problem, fit: Fit) -> list[FloatArray]:
    """Return the standard deviation of each parameter of each effect, (k,); 0 of what is not free."""
    sigma = np.sqrt(np.maximum(np.diag(problem.lasting_covariance(fit)), 0.0))
    at = sum(n.mean.size for n in problem.nuisances)
    out = []
    for term, theta in zip(fit.terms, fit.thetas, strict=True):
        own = np.zeros(theta.size)
        own[term.free] = sigma[at : at + term.dimension]
        at += term.dimension
        out.append(own)
    return out


def _interval(problem: Problem, parameter: Parameter, value: float, sigma: float) -> _Interval:
    low, high = value - _SIGMAS * sigma, value + _SIGMAS * sigma
    if parameter.name in MOMENTS and abs(value) < NEVER_S:
        before, after = between_rows(problem, value)
        return min(low, before), max(high, after)
    return max(low, parameter.low), min(high, parameter.high)


def _cost(problem: Problem, fit: Fit, place: int, parameter: int) -> Callable[[float], float]:
    """Return what another value of a parameter adds to the whitened sum of squares."""
    term, theta, signals = fit.terms[place], fit.thetas[place].copy(), problem.signals(fit)
    r = problem.residual(signals.reading)
    own = term.effect.forward(signals, theta, {}, None).reading

    def cost(value: float) -> float:
        theta[parameter] = value
        other = term.effect.forward(signals, theta, {}, None).reading
        if not (other.mag_mgauss - own.mag_mgauss)[problem.index].any():
            return 0.0
        column = problem.shift(other, own)
        return float(column @ column - 2.0 * column @ r)

    return cost


def _as_well(cost: Callable[[float], float], parameter: Parameter, value: float) -> _Interval:
    ends = []
    for end in (parameter.low, parameter.high):
        sign = 1.0 if end > value else -1.0
        inside, step = value, _FIRST_STEP * max(abs(value), _FIRST_STEP)
        outside = value + sign * step
        while abs(outside - value) < abs(end - value) and cost(outside) < _COST:
            inside, step = outside, _GROWTH * step
            outside = value + sign * step
        if abs(outside - value) >= abs(end - value):
            if cost(end) < _COST:
                ends.append(end)
                continue
            outside = end
        for _ in range(_HALVINGS):
            middle = 0.5 * (inside + outside)
            inside, outside = (middle, outside) if cost(middle) < _COST else (inside, middle)
        ends.append(inside)
    return ends[0], ends[1]


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
