"""Put the named effects in words that a person can use, of one recording and of several of one vehicle.

Every flight has its own nuisances (yaw, place, noise), so that the joint least squares of what they share is
the mean of what each flight tells alone, weighed by its covariance. A cause that several flights tell alike
is the vehicle's; one that comes once, or every time with another value, is the flight's: a magnet nearby,
another place.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from mavcompass.frames import FloatArray
from mavcompass.gap.fit.hypothesis import Fit, make_term
from mavcompass.gap.fit.model import Problem
from mavcompass.gap.residual.floor import apart
from mavcompass.gap.result import Cause, Diagnosis
from mavcompass.gap.selection.identification import Identified
from mavcompass.gap.selection.split import between_rows
from mavcompass.gap.tables import usual
from mavcompass.printable import plain
from mavcompass.simulation.effects import get
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
    at = fit.nuisances.size
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


@dataclass(frozen=True, slots=True)
class SharedCause:
    """Hold a cause of the vehicle: joint parameters and intervals, in how many flights it was named."""

    cause: Cause
    named_in: int


@dataclass(frozen=True, slots=True)
class VehicleDiagnosis:
    """Hold the diagnoses of several flights of one vehicle, and what they share.

    `flights` are in the order given; `own` lists for each the causes that are the flight's alone.
    """

    flights: tuple[Diagnosis, ...]
    shared: tuple[SharedCause, ...]
    own: tuple[tuple[Cause, ...], ...]

    def to_json(self) -> dict[str, object]:
        """Return one document: the vehicle's causes, and each flight's whole diagnosis."""
        return {
            "schema": "mavcompass.gap-vehicle/1",
            "vehicle": [
                {
                    **{name: plain(getattr(s.cause, name)) for name in ("effect", "parameters", "ci95")},
                    "named_in": s.named_in,
                    "of": len(self.flights),
                }
                for s in self.shared
            ],
            "flights": [
                {**flight.to_json(), "of_this_flight": [c.effect for c in own]}
                for flight, own in zip(self.flights, self.own, strict=True)
            ],
        }

    def lines(self) -> list[str]:
        """Say it for a terminal."""
        out = []
        for s in self.shared:
            values = ", ".join(f"{name} {value:.4g}" for name, value in s.cause.parameters.items())
            out.append(
                f"of the vehicle (in {s.named_in} of {len(self.flights)} flights): {s.cause.effect}: {values}"
            )
        for flight, own in zip(self.flights, self.own, strict=True):
            if own:
                out.append(f"of one flight ({flight.path}): {', '.join(c.effect for c in own)}")
        return out or ["nothing that the flights share, nothing of one alone"]


def together(flights: Sequence[Diagnosis]) -> VehicleDiagnosis:
    """Tell the causes that flights of one vehicle share from those of one flight."""
    shared: list[SharedCause] = []
    for effect in sorted({c.effect for d in flights for c in d.causes}):
        # What happens around a vehicle or at one moment is not its own, however often it comes.
        if not get(effect).of_vehicle:
            continue
        told = [c for d in flights for c in d.causes if c.effect == effect]
        could = [d for d in flights if effect not in dict(d.not_testable)]
        if len(told) > 1 and 2 * len(told) > len(could) and _agree(told):
            shared.append(SharedCause(_joint(told), len(told)))
    names = {s.cause.effect for s in shared}
    own = tuple(tuple(c for c in d.causes if c.effect not in names) for d in flights)
    return VehicleDiagnosis(tuple(flights), tuple(shared), own)


def _sigma_of(cause: Cause, name: str) -> float:
    low, high = cause.ci95.get(name, (math.nan, math.nan))
    sigma = (high - low) / 3.92
    scale = next(p.scale for p in get(cause.effect).parameters if p.name == name)
    return sigma if math.isfinite(sigma) and sigma > 0.0 else max(scale, 1e-9)


def _agree(causes: Sequence[Cause]) -> bool:
    """Tell whether the parameters of a cause are the same in all flights, each within its doubt."""
    names = [n for n in causes[0].parameters if n not in MOMENTS]
    size = math.sqrt(sum(max(abs(c.parameters.get(n, 0.0)) for c in causes) ** 2 for n in names))
    for name in names:
        joint, _ = _mean(causes, name)
        for cause in causes:
            off = abs(cause.parameters.get(name, 0.0) - joint)
            if off > max(usual.equivalent.sigmas * _sigma_of(cause, name), usual.equivalent.of_size * size):
                return False
    return True


def _mean(causes: Sequence[Cause], name: str) -> tuple[float, float]:
    weights = [_sigma_of(c, name) ** -2 for c in causes]
    total = sum(weights)
    return sum(
        w * c.parameters.get(name, 0.0) for w, c in zip(weights, causes, strict=True)
    ) / total, total**-0.5


def _joint(causes: Sequence[Cause]) -> Cause:
    parameters, ends = {}, {}
    for name in causes[0].parameters:
        value, sigma = _mean(causes, name)
        parameters[name], ends[name] = value, (value - 1.96 * sigma, value + 1.96 * sigma)
    probability = 1.0 - math.prod(1.0 - c.probability for c in causes)
    return Cause(causes[0].effect, parameters, ends, probability, ())
