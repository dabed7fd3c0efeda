"""Candidates: every effect of the catalogue linearised where it would begin, in one pass; the likeliest sets.

What a set costs is (1) of `selection/identification`: its parameters and effects have prices that were
learnt, and what readings say counts by how far blocks of the recording contradict each other. One more effect
is taken where that makes a set cheaper. The likeliest sets of each size come from normal equations, without a
fit.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from mavcompass.frames import FloatArray
from mavcompass.gap.fit.algebra import RIDGE, BlockNormal, solve
from mavcompass.gap.fit.hypothesis import Fit, Term, active_dimension, placements
from mavcompass.gap.fit.model import Problem
from mavcompass.gap.replay.noise import group_values
from mavcompass.gap.replay.nuisance import REFERENCE_YAW, WORLD_FIELD, yaw_starts
from mavcompass.gap.tables import Kind, tables, usual
from mavcompass.simulation.effects.effect import GROUPS, Misfit, Signals
from mavcompass.simulation.physics.signals import Reading


@dataclass(frozen=True, slots=True, eq=False)
class Candidate:
    """Hold one effect at one start: its columns behind the nuisances, (k,), the last a whole shift if
    `shifted`."""

    term: Term
    theta: FloatArray
    columns: NDArray[np.int64]
    shifted: bool

    @property
    def dimension(self) -> int:
        """Count its parameters as those of a fitted effect are counted."""
        return active_dimension(self.term, self.theta)

    @property
    def usual(self) -> FloatArray:
        """Return how far its columns' values may lie from where it begins, in passing, (k,)."""
        sizes = usual.search.sizes * np.maximum(self.term.effect.scale[self.term.free], 1e-12)
        return np.append(sizes, 1.0) if self.shifted else sizes

    def values(self, solved: FloatArray) -> FloatArray:
        """Return the parameters that a solution of its columns means, inside their bounds."""
        theta = self.theta.copy()
        step = solved[:-1] if self.shifted else solved
        theta[self.term.free] += step
        return np.clip(theta, self.term.lower, self.term.upper)


def misfit_of(problem: Problem, signals: Signals) -> Misfit:
    """Return what simulated signals leave, for effects that look for their own first guesses."""
    measured, made = problem.replay.measured, signals.reading
    residual = Reading(*(group_values(measured, g) - group_values(made, g) for g in GROUPS))
    rows = np.zeros(problem.rows.size, dtype=np.bool_)
    rows[problem.index] = True
    return Misfit(signals, residual, rows, problem.sigma_mgauss, len(yaw_starts(problem.prior)) > 1)


class Candidates:
    """Linearise the effects beside a fit, and hold the normal equations of all of them."""

    def __init__(
        self,
        problem: Problem,
        terms: Iterable[Term],
        base: Fit,
        block: NDArray[np.int64],
        held: Sequence[Term] = (),
    ) -> None:
        """Linearise `terms` beside `base`; what is in `held` stays in the base whatever is chosen."""
        self.problem, self.base = problem, base
        self.list: list[Candidate] = []
        self._columns = 0
        n = len(problem.prior.effects)
        states = problem.composition.states(base)
        residual = problem.residual(states[-1].reading)
        kept = {term.effect.id for term in held}
        chosen = [place for place, term in enumerate(base.terms) if term.effect.id not in kept]
        wanted = [*range(n), *(n + place for place in chosen)]
        counts = [problem.prior.mean.size, *(int(base.terms[place].free.sum()) for place in chosen)]
        columns = problem.columns(base, states, wanted)
        known, *each = np.split(columns, np.cumsum(counts)[:-1], axis=1)
        parts = [known]
        for place, own in zip(chosen, each, strict=True):
            shift = problem.shift(states[-1].reading, problem.predict(base.without(place)))
            residual = residual + shift
            parts += self._add(base.terms[place], base.thetas[place], own, shift)
        others = [t for t in terms if t.effect.id not in kept and t.effect.kind != "discrete"]
        for term in others:
            parts += self._begin(term, states)
        offset = problem.prior.mean - base.nuisances
        columns, known_count = np.hstack(parts), known.shape[1]
        # The equations copy the columns once more: these need not stay meanwhile.
        del parts, known, each
        usual = np.concatenate([c.usual for c in self.list]) if self.list else np.zeros(0)
        labels = np.tile(np.repeat(block[problem.index], 3), len(problem.groups))
        order = np.argsort(labels, kind="stable") if len(problem.groups) > 1 else slice(None)
        self.normal = BlockNormal(
            columns[order], residual[order], labels[order], known_count, problem.prior.precision,
            offset, usual, problem.prior.holds(REFERENCE_YAW, WORLD_FIELD.id),
        )  # fmt: skip
        self.constant = float(residual @ residual + offset @ problem.prior.precision @ offset)

    def _begin(self, term: Term, before: list[Signals]) -> list[FloatArray]:
        """Linearise an effect at each of its first guesses, beside the base without it; return its columns.

        `before` are the states of the base.
        """
        fit, problem, parts = self.base, self.problem, list[FloatArray]()
        known: FloatArray | None = None
        for place, member in enumerate(self.base.terms):
            if member.effect.id == term.effect.id:
                fit, known = self.base.without(place), self.base.thetas[place]
                before = problem.composition.states(fit)
        misfit: Misfit | None = None
        guesses = [term.effect.neutral()]
        if term.effect.starts is not None:
            misfit = misfit_of(problem, before[-1])
            guesses = term.effect.starts(misfit)
        iron = problem.replay.iron.offset_mgauss
        stage_at = term.effect.stage_at
        for guess in [placed for g in guesses for placed in placements(term.effect, g, iron)]:
            if misfit is None and known is not None and stage_at(guess) is stage_at(known):
                continue
            begun = fit.beside(term, guess)
            states = problem.composition.states(begun, before)
            own = problem.columns(begun, states, [len(problem.prior.effects) + len(fit.terms)])
            shift: FloatArray | None = None
            if misfit is not None:
                shift = problem.shift(states[-1].reading, misfit.signals.reading)
            if np.isfinite(own).all() and (shift is None or np.isfinite(shift).all()):
                parts += self._add(term, guess, own, shift)
        return parts

    def _add(
        self, term: Term, theta: FloatArray, own: FloatArray, shift: FloatArray | None
    ) -> list[FloatArray]:
        """Add a candidate; return its columns, none where it changes nothing."""
        shifted = False
        if shift is not None and shift.any():
            left, solved = shift, np.zeros(own.shape[1])
            if own.shape[1]:
                solved = solve(own.T @ own, own.T @ left, RIDGE)
                left = left - own @ solved
            shifted = float(left @ left) > usual.search.own_share * float(shift @ shift)
            if not shifted and own.shape[1]:
                # The derivatives hold the shift: they count from nothing.
                theta = theta.copy()
                theta[term.free] -= solved
        columns = np.column_stack([own, shift]) if shifted and shift is not None else own
        if not columns.shape[1]:
            return []
        end = self._columns + columns.shape[1]
        self.list.append(Candidate(term, theta, np.arange(self._columns, end), shifted))
        self._columns = end
        return [columns]

    def expected(self, sets: Sequence[Sequence[Candidate]]) -> FloatArray:
        """Return the sums of squares, priors included, to expect after fitting sets."""
        none = np.zeros(0, dtype=np.int64)
        own = [np.concatenate([none, *(c.columns for c in chosen)]) for chosen in sets]
        return self.constant - self.normal.null_gain - self.normal.gains(own)

    def start(self, chosen: Sequence[Candidate], held: Fit) -> Fit:
        """Return the set with the values that its linear solution means, not fitted yet."""
        own = np.concatenate([c.columns for c in chosen]) if chosen else np.zeros(0, dtype=np.int64)
        solution = self.normal.solve(own)
        each = np.split(solution.values, np.cumsum([c.columns.size for c in chosen[:-1]]))
        thetas = [*held.thetas, *(c.values(own) for c, own in zip(chosen, each, strict=False))]
        prior = self.problem.prior
        nuisances = np.clip(self.base.nuisances + solution.nuisances, prior.lower, prior.upper)
        return Fit((*held.terms, *(c.term for c in chosen)), tuple(thetas), nuisances)


class Criteria:
    """Weigh fits of one problem.

    `kind` tells how the recording is known: where that is not in detail, gains are held against how far
    blocks contradict each other. `overdispersion` is by how much errors that last for seconds make sums
    of squares larger than they should be.
    """

    def __init__(self, problem: Problem, kind: Kind = "exact") -> None:
        self.kind: Kind = kind
        self.exact = kind in ("exact", "reference")
        self.overdispersion = 1.0
        self._problem = problem
        # By what a fit has more than another one, and by the fit.
        self._contradictions: dict[tuple[frozenset[str], frozenset[str], float], float] = {}

    def score(self, fit: Fit, overdispersion: float | None = None) -> float:
        """Return what a fit costs, under another overdispersion perhaps.

        Errors that last for seconds are the readings': what is known of vehicle and place keeps its weight.
        """
        off2 = self._problem.mahalanobis2(fit)
        spread = self.overdispersion if overdispersion is None else overdispersion
        return (fit.sse - off2) / spread + off2 + self.cost(fit.dimension, len(fit.terms))

    def cost(self, dimension: int, effects: int) -> float:
        """Return the price of so many parameters and effects."""
        return tables().penalty[self.kind].of(dimension, effects, self._problem.count)

    def overdispersion_of(self, smaller: Fit, larger: Fit) -> float:
        """Return by how much blocks contradict each other about what a larger set has more, 1 where they do
        not."""
        more = larger.ids - smaller.ids
        if not more:
            return 1.0
        key = (more, larger.ids, larger.sse)
        if key not in self._contradictions:
            candidates = Candidates(self._problem, (), larger, self.blocks())
            of = [c.columns for c in candidates.list if c.term.effect.id in more]
            own = np.concatenate([c.columns for c in candidates.list])
            self._contradictions[key] = (
                candidates.normal.overdispersion_of(own, np.concatenate(of)) if of else 1.0
            )
        return self._contradictions[key]

    def blocks(self) -> NDArray[np.int64]:
        """Label the rows of a replay (N,) by what may err together, thirty blocks at most."""
        time = self._problem.replay.time_s
        length = max(usual.search.block_s, float(time[-1] - time[0]) / usual.search.most_blocks)
        return np.floor((time - time[0]) / length).astype(np.int64)


def likeliest_sets(
    candidates: Candidates, criteria: Criteria, most: int
) -> dict[int, list[tuple[Candidate, ...]]]:
    """Return the likeliest sets of each size up to `most`, the best first."""
    every = candidates.list
    if not every:
        return {}
    effect, dimension = [c.term.effect.id for c in every], [c.dimension for c in every]
    scores: dict[tuple[int, ...], float] = {}

    def weigh(sets: Iterable[tuple[int, ...]]) -> None:
        new = [members for members in sets if members not in scores]
        left = candidates.expected([[every[i] for i in members] for members in new])
        for members, sse in zip(new, left.tolist(), strict=True):
            parameters = sum(dimension[i] for i in members)
            scores[members] = sse / criteria.overdispersion + criteria.cost(parameters, len(members))

    def grown(parent: tuple[int, ...]) -> set[tuple[int, ...]]:
        held = {effect[m] for m in parent}
        return {tuple(sorted((*parent, i))) for i in range(len(every)) if effect[i] not in held}

    out: dict[int, list[tuple[Candidate, ...]]] = {}
    beam: list[tuple[int, ...]] = [()]
    lowest = math.inf
    for size in range(1, most + 1):
        sets = {members for parent in beam for members in grown(parent)}
        if not sets:
            break
        weigh(sets)
        if size > 1:
            best = min(sets, key=scores.__getitem__)
            sets |= {other for gone in best for other in grown(tuple(m for m in best if m != gone))}
            weigh(sets)
        ranked = sorted(sets, key=scores.__getitem__)
        beam = ranked[: usual.search.beam if size > 1 else 2 * usual.search.beam]
        smaller, lowest = lowest, scores[ranked[0]]
        seen: dict[frozenset[str], tuple[int, ...]] = {}
        for members in ranked[: 8 * usual.search.fitted]:
            seen.setdefault(frozenset(effect[i] for i in members), members)
        near = [m for m in seen.values() if scores[m] < lowest + usual.search.near]
        out[size] = [tuple(every[i] for i in members) for members in near[: usual.search.fitted]]
        if lowest > smaller + criteria.cost(2, 0):
            break
    return out
