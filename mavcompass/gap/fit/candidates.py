"""Candidates: every effect of the catalogue linearised where it would begin, in one pass through the
simulation."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from mavcompass.frames import FloatArray
from mavcompass.gap.fit.algebra import BlockNormal
from mavcompass.gap.fit.hypothesis import Fit, Term, active_dimension, placements
from mavcompass.gap.fit.model import Problem
from mavcompass.gap.replay.noise import group_values
from mavcompass.gap.replay.nuisance import REFERENCE_YAW, WORLD_FIELD, yaw_starts
from mavcompass.simulation.effects.effect import Effect, Misfit, Signals
from mavcompass.simulation.physics.signals import Reading

# A shift that the derivatives make themselves to this share is no column of its own.
_OWN_SHARE = 1e-2
# Natural sizes of a parameter that a first guess may move by where the recording hardly tells it.
_MOST_SIZES = 4.0


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
        sizes = _MOST_SIZES * np.maximum(self.term.effect.scale[self.term.free], 1e-12)
        return np.append(sizes, 1.0) if self.shifted else sizes

    def values(self, solved: FloatArray) -> FloatArray:
        """Return the parameters that a solution of its columns means, inside their bounds."""
        theta = self.theta.copy()
        step = solved[:-1] if self.shifted else solved
        theta[self.term.free] += step
        return np.clip(theta, self.term.lower, self.term.upper)


def misfit_of(problem: Problem, signals: Signals) -> Misfit:
    """Return what simulated signals leave, for effects that look for their own first guesses."""
    residual = Reading(
        *(
            group_values(problem.replay.measured, g) - group_values(signals.reading, g)
            for g in ("mag", "acc", "gyro")
        )
    )
    rows = np.zeros(problem.rows.size, dtype=np.bool_)
    rows[problem.index] = True
    return Misfit(signals, residual, rows, problem.sigma_mgauss, len(yaw_starts(problem.nuisances)) > 1)


def _elsewhere(effect: Effect, guess: FloatArray, known: FloatArray) -> bool:
    return effect.stage_at(guess) is not effect.stage_at(known)


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
        n = len(problem.nuisances)
        states = problem.composition.states(base.terms, base.thetas, base.nuisance_thetas)
        residual = problem.residual(states[-1].reading)
        kept = {term.effect.id for term in held}
        chosen = [place for place, term in enumerate(base.terms) if term.effect.id not in kept]
        wanted = [*range(n), *(n + place for place in chosen)]
        counts = [problem.prior.mean.size, *(int(base.terms[place].free.sum()) for place in chosen)]
        columns = problem.columns(base.terms, base.thetas, base.nuisance_thetas, states, wanted)
        known, *each = np.split(columns, np.cumsum(counts)[:-1], axis=1)
        parts = [known]
        for place, own in zip(chosen, each, strict=True):
            shift = problem.shift(states[-1].reading, problem.predict(base.without(place)))
            residual = residual + shift
            parts += self._add(base.terms[place], base.thetas[place], own, shift)
        others = [t for t in terms if t.effect.id not in kept and t.effect.kind != "discrete"]
        for term in others:
            parts += self._begin(term, states)
        offset = problem.prior.mean - np.concatenate(base.nuisance_thetas) if n else np.zeros(0)
        columns, known_count = np.hstack(parts), known.shape[1]
        # The equations copy the columns once more: these need not stay meanwhile.
        del parts, known, each
        usual = np.concatenate([c.usual for c in self.list]) if self.list else np.zeros(0)
        labels = np.tile(np.repeat(block[problem.index], 3), len(problem.groups))
        order = np.argsort(labels, kind="stable") if len(problem.groups) > 1 else slice(None)
        self.normal = BlockNormal(
            columns[order], residual[order], labels[order], known_count, problem.prior.precision,
            offset, usual, self._loose(),
        )  # fmt: skip
        self.constant = float(residual @ residual + offset @ problem.prior.precision @ offset)

    def _loose(self) -> NDArray[np.bool_]:
        """Tell which parameters of nuisances only this recording knows, (K,)."""
        own = (REFERENCE_YAW, WORLD_FIELD.id)
        parts = [np.full(n.mean.size, n.effect.id in own) for n in self.problem.nuisances]
        return np.concatenate(parts) if parts else np.zeros(0, dtype=np.bool_)

    def _begin(self, term: Term, before: list[Signals]) -> list[FloatArray]:
        """Linearise an effect at each of its first guesses, beside the base without it; return its columns.

        `before` are the states of the base.
        """
        fit, problem, parts = self.base, self.problem, list[FloatArray]()
        known: FloatArray | None = None
        for place, member in enumerate(self.base.terms):
            if member.effect.id == term.effect.id:
                fit, known = self.base.without(place), self.base.thetas[place]
                before = problem.composition.states(fit.terms, fit.thetas, fit.nuisance_thetas)
        misfit: Misfit | None = None
        guesses = [term.effect.neutral()]
        if term.effect.starts is not None:
            misfit = misfit_of(problem, before[-1])
            guesses = term.effect.starts(misfit)
        iron = problem.replay.iron.offset_mgauss
        for guess in [placed for g in guesses for placed in placements(term.effect, g, iron)]:
            if misfit is None and known is not None and not _elsewhere(term.effect, guess, known):
                continue
            terms, thetas = (*fit.terms, term), (*fit.thetas, guess)
            states = problem.composition.states(terms, thetas, fit.nuisance_thetas, before)
            place = len(problem.nuisances) + len(fit.terms)
            own = problem.columns(terms, thetas, fit.nuisance_thetas, states, [place])
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
                normal = own.T @ own
                size = np.sqrt(np.maximum(np.diag(normal), 1e-300))
                scaled = normal / np.outer(size, size) + 1e-9 * np.eye(size.size)
                solved = np.linalg.solve(scaled, own.T @ left / size) / size
                left = left - own @ solved
            shifted = float(left @ left) > _OWN_SHARE * float(shift @ shift)
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
        thetas, at = list(held.thetas), 0
        for candidate in chosen:
            thetas.append(candidate.values(solution.values[at : at + candidate.columns.size]))
            at += candidate.columns.size
        nuisances, at = [], 0
        for nuisance, theta in zip(self.problem.nuisances, self.base.nuisance_thetas, strict=True):
            moved = theta + solution.nuisances[at : at + theta.size]
            nuisances.append(np.clip(moved, nuisance.effect.lower, nuisance.effect.upper))
            at += theta.size
        return Fit((*held.terms, *(c.term for c in chosen)), tuple(thetas), tuple(nuisances), np.inf)

    def contradiction(self, chosen: Sequence[Candidate], of: Sequence[Candidate]) -> float:
        """Return by how much blocks contradict each other about some members of a set, 1 where they do
        not."""
        own = np.concatenate([c.columns for c in chosen])
        return self.normal.contradiction(own, np.concatenate([c.columns for c in of]))
