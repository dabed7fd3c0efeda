"""A hypothesis: effects with values; the weak priors that every effect has; what chance gains."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from mavcompass.chance import chi_square_of
from mavcompass.frames import FloatArray
from mavcompass.gap.tables import usual
from mavcompass.simulation.effects.effect import MOMENTS, ON_IRON, Effect, Parameter, Signals

CHANCE = 2.0e-5
Mask = NDArray[np.bool_]


@lru_cache(maxsize=1024)
def least_gain(dimension: int, trials: int = 1) -> float:
    """Return the fall of the sum of squares that chance reaches with probability CHANCE.

    `trials` is how many places (moments, frequencies, thresholds) were tried for it.
    """
    return chi_square_of(CHANCE / max(trials, 1), max(dimension, 1))


@dataclass(frozen=True, slots=True, eq=False)
class Term:
    """Be one effect of a hypothesis.

    `free` (k,) tells which parameters a fit may move; `lower` and `upper` (k,) how far: the physical
    range, or less where the recording itself sets a limit.
    """

    effect: Effect
    free: Mask
    lower: FloatArray
    upper: FloatArray

    @property
    def dimension(self) -> int:
        """Count the parameters that are fitted."""
        return int(self.free.sum())


@dataclass(frozen=True, slots=True, eq=False)
class Fit:
    """Hold a hypothesis, fitted or to begin with.

    Attributes:
        terms: its effects, without the nuisances.
        thetas: their parameters; nuisances: those of all nuisances, (K,).
        sse: whitened sum of squares on the fitted rows plus what the priors of the nuisances cost; infinite
            where it was not fitted.
        covariance: of the free parameters, nuisances first, then the terms in order.
    """

    terms: tuple[Term, ...] = ()
    thetas: tuple[FloatArray, ...] = ()
    nuisances: FloatArray = field(default_factory=lambda: np.zeros(0))
    sse: float = np.inf
    covariance: FloatArray = field(default_factory=lambda: np.zeros((0, 0)))

    @property
    def ids(self) -> frozenset[str]:
        """Return the effects' ids."""
        return frozenset(term.effect.id for term in self.terms)

    @property
    def is_turned(self) -> bool:
        """Tell whether it has the compass in another orientation."""
        return any(term.effect.kind == "discrete" for term in self.terms)

    @property
    def dimension(self) -> int:
        """Count the fitted parameters of the effects; an optional one at its end is not one."""
        return sum(active_dimension(t, x) for t, x in zip(self.terms, self.thetas, strict=True))

    def without(self, place: int) -> Fit:
        """Return the hypothesis without one of its effects, not fitted anew."""
        return Fit(
            (*self.terms[:place], *self.terms[place + 1 :]),
            (*self.thetas[:place], *self.thetas[place + 1 :]),
            self.nuisances,
        )

    def changed(self, place: int, term: Term, theta: FloatArray) -> Fit:
        """Return the hypothesis with another term, and other values, for one effect, not fitted anew."""
        terms = (*self.terms[:place], term, *self.terms[place + 1 :])
        return Fit(terms, (*self.thetas[:place], theta, *self.thetas[place + 1 :]), self.nuisances)

    def beside(self, term: Term, theta: FloatArray) -> Fit:
        """Return the hypothesis with one more effect, not fitted anew."""
        return Fit((*self.terms, term), (*self.thetas, theta), self.nuisances)

    def value(self, name: str) -> float | None:
        """Return a parameter that means the same in every effect; None where no effect has it."""
        for term, theta in zip(self.terms, self.thetas, strict=True):
            if (value := term.effect.value(theta, name)) is not None:
                return value
        return None


def active_dimension(term: Term, theta: FloatArray) -> int:
    """Count the parameters that a fitted term uses: integers and moments of change count too."""
    unused = sum(
        1
        for parameter, value in zip(term.effect.parameters, theta, strict=True)
        if parameter.optional and not parameter.low < value < parameter.high
    )
    fixed = sum(1 for p in term.effect.parameters if p.integer or p.scale == 0.0)
    return term.dimension + fixed - unused


def make_term(effect: Effect, signals: Signals) -> Term:
    """Say which parameters of an effect a fit may move on these signals, and how far."""
    free = np.array([not p.integer and p.scale > 0.0 for p in effect.parameters], dtype=np.bool_)
    if effect.free is not None:
        free &= effect.free(signals)
    lower, upper = effect.lower, effect.upper
    if effect.limits is not None:
        low, high = effect.limits(signals)
        lower, upper = np.maximum(lower, low), np.minimum(upper, high)
    return Term(effect, free, lower, upper)


def placements(effect: Effect, theta: FloatArray, iron_mgauss: FloatArray) -> list[FloatArray]:
    """Let an error of the sensor act on the vehicle's iron (3,) too, or on the field alone, where that
    differs."""
    if ON_IRON not in effect.names:
        return [theta]
    place = effect.names.index(ON_IRON)
    differs = float(np.abs(iron_mgauss).max()) > usual.present.iron_mgauss
    both = (0.0, 1.0) if differs else (float(effect.default[place]),)
    return [np.concatenate([theta[:place], [on], theta[place + 1 :]]) for on in both]


def weak_precision(terms: Sequence[Term]) -> FloatArray:
    """Return the prior precision of each free parameter: none for those that are no amplitudes."""
    return np.array(
        [
            1.0 / (usual.search.prior_sizes * p.scale) ** 2 if _is_amplitude(p) else 0.0
            for term in terms
            for p, free in zip(term.effect.parameters, term.free, strict=True)
            if free
        ]
    )


def _is_amplitude(parameter: Parameter) -> bool:
    """Tell amplitudes, for which zero means nothing happens, from places, moments and frequencies."""
    within = parameter.low <= 0.0 < parameter.high
    return within and parameter.unit != "m" and parameter.name not in {*MOMENTS, "reference_degc"}
