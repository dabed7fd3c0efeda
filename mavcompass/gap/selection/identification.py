"""Choose the effects by the criterion, fit the choice again on all rows, and judge what is left.

What a set S of effects costs is minus twice the logarithm of its evidence and its prior, up to a constant:

    c(S) = (SSE_S - m_S) / T + m_S + a d_S ln n + b k_S                                              (1)

SSE is the whitened sum of squares of n rows and m the part of it by which what is known of vehicle and
place is strained (its Mahalanobis distance from the prior); T >= 1 is the overdispersion, by which blocks
of the recording contradict each other about what the fullest set has more than none; d parameters cost
Schwarz's a ln n each (Annals of Statistics 6, 1978), k effects their prior odds, b. Both are learnt
(`params/gap`).

Numbers that are rounded, saturated or scattered more than the floor's have another noise than the floor's.
What is left is judged under that noise; otherwise each of these would look like an unknown cause.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from statistics import NormalDist

import numpy as np

from mavcompass.frames import FloatArray
from mavcompass.gap.detectors.detect import Detected
from mavcompass.gap.fit.hypothesis import Fit, Mask
from mavcompass.gap.fit.model import Problem
from mavcompass.gap.fit.search import Search, nuisances_at_prior, pruned
from mavcompass.gap.replay.noise import Noise
from mavcompass.gap.replay.nominal import Replay
from mavcompass.gap.residual.floor import (
    Floor,
    Scatter,
    find_scatter,
    kind_of,
    measured_noise,
    noise_with,
    widened,
)
from mavcompass.gap.selection.split import (
    Split,
    moments,
    probe,
    said_of,
    switched,
    switches,
    transients,
    with_moments,
    with_windows,
)
from mavcompass.gap.tables import usual
from mavcompass.simulation.effects.effect import LIMIT, Effect
from mavcompass.simulation.physics.signals import Reading


@dataclass(frozen=True, slots=True, eq=False)
class Explanation:
    """Hold a set of effects as fitted, what it costs (1), and whether it is the best one in other words.

    `apart` is the whitened squared distance between what it predicts and what the best one does.
    """

    fit: Fit
    cost: float
    apart: float
    mahalanobis2: float


@dataclass(frozen=True, slots=True, eq=False)
class Posterior:
    """Hold the explored sets, the cheapest first, the empty one among them; `overdispersion` is T of (1)."""

    explanations: tuple[Explanation, ...]
    overdispersion: float

    @property
    def best(self) -> Explanation:
        """Return the cheapest set."""
        return self.explanations[0]

    @property
    def nothing(self) -> Explanation:
        """Return the empty set."""
        return next(e for e in self.explanations if not e.fit.terms)

    @property
    def gain(self) -> float:
        """Return by how much the best set is cheaper than none."""
        return self.nothing.cost - self.best.cost

    @property
    def lead(self) -> float:
        """Return by how much the best set is cheaper than any that is not the same in more words."""
        others = [e.cost for e in self.explanations[1:] if not self.restates(e)]
        return min(others, default=math.inf) - self.best.cost

    @property
    def rivals(self) -> list[Explanation]:
        """List the other sets, but those that are the same in more words."""
        return [e for e in self.explanations[1:] if e.fit.terms and not self.restates(e)]

    def without(self, effect_id: str) -> float:
        """Return by how many sigmas the best set without an effect falls short of the best one, or 0."""
        others = [e.cost for e in self.explanations if effect_id not in e.fit.ids]
        return math.sqrt(max(min(others, default=math.inf) - self.best.cost, 0.0))

    def restates(self, other: Explanation) -> bool:
        """Tell whether a set is observationally equivalent to the best one, with more parameters."""
        best, none = self.best, self.nothing
        most = max(
            usual.equivalent.squares * self.overdispersion,
            usual.equivalent.share * (none.fit.sse - best.fit.sse),
        )
        return other.apart < most and other.fit.dimension > best.fit.dimension

    def weights(self, likely: float) -> tuple[tuple[frozenset[str], float], ...]:
        """Share a probability among the rivals of the best set, by (1)."""
        rivals = self.rivals
        if not rivals:
            return ()
        raw = np.exp(-0.5 * np.array([e.cost - rivals[0].cost for e in rivals]))
        shares = likely * raw / raw.sum()
        return tuple((e.fit.ids, float(share)) for e, share in zip(rivals, shares, strict=True))


def posterior_of(search: Search) -> Posterior:
    """Weigh the explored sets of a search, the likeliest of them fitted to the end."""
    problem, explored = search.problem, dict(search.explored)
    fullest = min(explored.values(), key=lambda fit: fit.sse)
    spread = max(1.0, search.criteria.overdispersion_of(Fit(), fullest)) if fullest.terms else 1.0

    def cost(fit: Fit) -> float:
        return search.criteria.score(fit, spread)

    ranked = sorted(explored.values(), key=cost)
    for fit in ranked[: usual.search.refitted]:
        if fit.terms and cost(fit) < cost(ranked[0]) + usual.search.hopeless:
            explored[fit.ids] = problem.refit(fit)
    ranked = sorted(explored.values(), key=cost)
    here = problem.predict(ranked[0])
    explanations = []
    for place, fit in enumerate(ranked):
        near = place < usual.search.refitted or not fit.terms
        apart = float(np.sum(problem.shift(problem.predict(fit), here) ** 2)) if near else math.inf
        explanations.append(Explanation(fit, cost(fit), apart, problem.mahalanobis2(fit)))
    return Posterior(tuple(explanations), spread)


@dataclass(frozen=True, slots=True, eq=False)
class Identified:
    """Hold the best set as fitted to the training rows of a split, nothing beside straight nuisances, and how
    it was found.

    `first` is the problem that the sets were explored and weighed on (a change inside a held-out block
    moves rows afterwards).
    """

    problem: Problem
    split: Split
    null: Fit
    fit: Fit
    search: Search
    first: Problem
    posterior: Posterior


_SEED = 20260102


@dataclass(frozen=True, slots=True, eq=False)
class Residual:
    """Hold the chosen effects refitted on all rows, and extra scatter if there is some.

    `comparable` is False where the readings' own noise cannot be compared with the floor's.
    """

    problem: Problem
    fit: Fit
    scatter: Scatter | None
    comparable: bool


def with_white(noise: Noise, variance_mgauss2: float) -> Noise:
    """Add white scatter to the compass's noise: the rounding's, step^2 / 12, or what single readings show."""
    mag = noise["mag"]
    sigma, rms = (np.sqrt(values**2 + variance_mgauss2) for values in (mag.sigma, mag.rms))
    return {**noise, "mag": replace(mag, sigma=sigma, rms=rms)}


def residual_of(identified: Identified, floor: Floor, names: frozenset[str], detected: Detected) -> Residual:
    """Refit the chosen effects on all rows; look for extra scatter, and put it into the noise."""
    step_mgauss = detected.step_mgauss
    replay, chosen = identified.problem.replay, identified.fit
    noise = with_white(floor.noise, step_mgauss**2 / 12.0) if step_mgauss > 0.0 else floor.noise
    problem = Problem(replay, noise, replay.valid, floor.prior)
    fit = problem.refit(chosen)
    # Moments and thresholds lie between readings: all rows place them better than the training rows.
    if any(term.effect.moves for term in fit.terms):
        fit = identified.search.on(problem).polished(fit)
    if step_mgauss > 0.0:
        return _unrounded(problem, fit, floor, step_mgauss)
    scatter = find_scatter(problem, fit, names, floor, detected.excess_mgauss2)
    if scatter is None:
        # A saturated reading has no scatter.
        return Residual(problem, fit, None, fit.value(LIMIT) is None)
    noisy = Problem(problem.replay, noise_with(problem, fit, scatter), problem.rows, floor.prior)
    return Residual(noisy, noisy.refit(fit), scatter, False)


def _unrounded(problem: Problem, fit: Fit, floor: Floor, step_mgauss: float) -> Residual:
    """Draw what coarse numbers may have been before they were rounded, given the model and the floor.

    If the model is true, the drawn errors are exactly the floor's (randomised quantile residuals, Dunn and
    Smyth 1996), however coarse the steps are; errors of rounding themselves go with the field.
    """
    replay = problem.replay
    measured = replay.measured
    sigma = floor.noise["mag"].rms
    if not floor.measured:
        # The scatter that was read off the rounded numbers holds that of the rounding.
        sigma = np.sqrt(np.maximum(sigma**2 - step_mgauss**2 / 12.0, usual.steps.least_mgauss**2))
    drawn = _before_rounding(measured.mag_mgauss, problem.predict(fit).mag_mgauss, sigma, step_mgauss)
    fine = replace(replay, measured=Reading(drawn, measured.acc_mps2, measured.gyro_radps))
    fresh = Problem(fine, problem.noise, problem.rows, problem.prior)
    noise = {**floor.noise, "mag": measured_noise(fresh, fit)["mag"]}
    judged = Problem(fine, noise, problem.rows, problem.prior)
    return Residual(judged, judged.refit(fit), None, False)


def _before_rounding(
    rounded: FloatArray, predicted: FloatArray, sigma: FloatArray, step_mgauss: float
) -> FloatArray:
    """Draw normal values about a prediction, each inside the step that its rounded value stands for."""
    normal = NormalDist()
    ndtr, ndtri = (np.vectorize(f, otypes=[float]) for f in (normal.cdf, normal.inv_cdf))
    low, high = rounded - 0.5 * step_mgauss, rounded + 0.5 * step_mgauss
    p_low, p_high = ndtr((low - predicted) / sigma), ndtr((high - predicted) / sigma)
    share = np.random.default_rng(_SEED).random(rounded.shape)
    p = np.clip(p_low + share * (p_high - p_low), 1e-12, 1.0 - 1e-12)
    return np.asarray(np.clip(predicted + sigma * ndtri(p), low, high))


def identify(
    replay: Replay, floor: Floor, split: Split, effects: Sequence[Effect], noise_known: bool
) -> tuple[Identified, Floor]:
    """Search and weigh; where the noise is not known estimate it from what is left, and repeat.

    Where a change that was found takes time, the readings meanwhile are set aside and the search repeated;
    of something that is switched as long as it is told better each time.
    If nothing that changes is found then, they were the whole disturbance, and must stay; and they stay where
    the rest is explained no better without them.
    """
    result, own = _searched(replay, floor, split, effects, 1 if noise_known else usual.search.passes)
    none: Mask = np.zeros(replay.time_s.size, dtype=np.bool_)
    changing, switching, known = none, none, none
    for _ in range(usual.change.most):
        when = moments(result.fit)
        changing = changing | transients(result.problem, result.fit, when)
        switching = switching | switched(result.problem, result.fit)
        aside = changing | switching
        again = bool(known.any())
        if aside.sum() - known.sum() <= (usual.change.few * aside.size if again else 0):
            break
        known = aside
        notes = (*replay.notes, *said_of(replay, changing, switching))
        fewer = replace(replay, valid=replay.valid & ~aside, notes=notes)
        calm = replace(split, train=split.train & ~aside, test=split.test & ~aside)
        start = floor
        if not floor.measured:
            kept = Problem(fewer, result.problem.noise, calm.train, result.problem.prior)
            start = widened(floor, kept, kept.refit(result.fit))
        calmer, settled = _searched(fewer, start, calm, effects, 1, result.fit)
        # Under a noise that is known both can be compared.
        still = not (moments(calmer.fit) or switches(calmer.fit))
        most = _each(result) * (usual.change.no_worse if again else 1.0)
        if still or (floor.measured and _each(calmer) > most):
            break
        result, own = replace(calmer, fit=with_moments(calmer.problem, calmer.fit, when)), settled
        if not switches(result.fit):
            break
    return result, own


def _each(found: Identified) -> float:
    """Return the whitened sum of squares that a chosen fit leaves, of each of its rows."""
    return found.fit.sse / max(found.problem.count, 1)


def _searched(
    replay: Replay,
    floor: Floor,
    split: Split,
    effects: Sequence[Effect],
    passes: int,
    likely: Fit | None = None,
) -> tuple[Identified, Floor]:
    """Search and weigh, under a noise learnt in passes; what was `likely` with other rows is tried first."""
    kind = kind_of(replay, floor)
    whole = Problem(replay, floor.noise, split.train | split.test, floor.prior)
    nothing = whole.null()
    for turn in range(passes):
        problem = Problem(replay, floor.noise, split.train, floor.prior)
        problem.null(nothing)
        search = Search(problem, effects, kind)
        tried = [problem.fit(replace(likely, nuisances=nothing.nuisances))] if likely else ()
        search.run(likely=tried)
        posterior = posterior_of(search)
        # Where the noise is only to be learnt, moments need be no nearer.
        wider = widened(floor, problem, posterior.best.fit) if turn + 1 < passes else floor
        if wider is floor:
            break
        floor = wider
    null = nuisances_at_prior(problem, problem.null())
    result = Identified(problem, split, null, posterior.best.fit, search, problem, posterior)
    result = _moments_in_training(result)
    result.search.forget()
    return replace(result, fit=pruned(result.problem, result.fit)), floor


def _moments_in_training(candidate: Identified) -> Identified:
    """Where something changes inside a held-out block, close in on it with narrow training windows."""
    replay = candidate.problem.replay
    for _ in range(usual.change.closings):
        probes = [probe(candidate.split, replay.time_s, m) for m in moments(candidate.fit)]
        loose = [p for p in probes if p is not None]
        if not loose:
            break
        split = with_windows(candidate.split, replay.time_s, replay.valid, loose)
        if split.train.sum() == candidate.split.train.sum():
            break
        problem = candidate.problem.with_rows(split.train)
        search = candidate.search.on(problem)
        fit = search.polished(problem.refit(candidate.fit), moments=True)
        search.explored = {fit.ids: fit}
        candidate = replace(candidate, problem=problem, split=split, fit=fit, search=search)
    return candidate
