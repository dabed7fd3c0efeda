"""First guesses: what each effect could explain beside a fit, by linear algebra alone."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from mavcompass.frames import FloatArray
from mavcompass.gap.hypothesis import Fit, Term
from mavcompass.gap.model import Problem
from mavcompass.gap.noise import group_values
from mavcompass.gap.nuisance import yaw_starts
from mavcompass.simulation.effects.effect import Misfit
from mavcompass.simulation.signals import Reading

_SHORT = 2


@dataclass(frozen=True, slots=True, eq=False)
class Start:
    """Hold a first guess of an effect's parameters, and the sum of squares to expect after fitting it.

    `nuisances` are theirs to start from, where they differ from the parent's.
    """

    term: Term
    theta: FloatArray
    expected: float
    nuisances: tuple[FloatArray, ...] | None = None


class Guesser:
    """Guess the parameters of every term on one problem."""

    def __init__(self, problem: Problem, terms: Sequence[Term]) -> None:
        self.problem = problem
        self.terms = terms
        self._log_n = math.log(max(problem.count, 2))

    def misfit(self, fit: Fit) -> Misfit:
        """Return what a fit leaves, for effects that look for their own first guesses."""
        problem = self.problem
        signals = problem.signals(fit)
        residual = Reading(
            *(
                group_values(problem.replay.measured, g) - group_values(signals.reading, g)
                for g in ("mag", "acc", "gyro")
            )
        )
        rows = np.zeros(problem.rows.size, dtype=np.bool_)
        rows[problem.index] = True
        yaw_unknown = len(yaw_starts(problem.nuisances)) > 1
        return Misfit(signals, residual, rows, problem.noise["mag"].rms, yaw_unknown)

    def starts(self, parent: Fit) -> list[Start]:
        """Guess every effect's parameters beside a fit; sort by the sum of squares to expect."""
        problem = self.problem
        n = len(problem.nuisances)
        states = problem.states(parent.terms, parent.thetas, parent.nuisance_thetas)
        known = problem.columns(
            parent.terms, parent.thetas, parent.nuisance_thetas, states, range(n + len(parent.terms))
        )
        # Priors count like readings: rows below the columns, and below the residual.
        basis = _orthonormal(np.vstack([known, problem.prior_root(parent.terms)]))
        residual = self._with_priors(problem.residual(states[-1].reading), parent)
        misfit = self.misfit(parent)
        found = []
        for term in self.terms:
            if term.effect.id in parent.ids:
                continue
            guesses = self._guesses(parent, term, misfit)
            judged = (self._judged(parent, term, guess, residual, basis) for guess in guesses)
            options = [option for option in judged if option is not None]
            if options:
                found.append(min(options, key=lambda option: option.expected))
        penalty = {id(s): s.term.dimension * self._log_n for s in found}
        return sorted(found, key=lambda s: s.expected + penalty[id(s)])

    def _with_priors(self, residual: FloatArray, parent: Fit) -> FloatArray:
        offset = self.problem.prior_offset(parent.terms, parent.thetas, parent.nuisance_thetas)
        return np.concatenate([residual, self.problem.prior_root(parent.terms) @ offset])

    def _guesses(self, parent: Fit, term: Term, misfit: Misfit) -> list[FloatArray]:
        if term.effect.starts is None:
            return [term.effect.neutral()]
        if term.effect.kind == "discrete":
            means = tuple(n.mean for n in self.problem.nuisances)
            misfit = self.misfit(Fit(parent.terms, parent.thetas, means, np.inf))
        return term.effect.starts(misfit)

    def _judged(
        self, parent: Fit, term: Term, guess: FloatArray, residual: FloatArray, basis: FloatArray
    ) -> Start | None:
        """Linearise an effect at a guess; solve for its parameters beside the parent's."""
        problem = self.problem
        terms, thetas = (*parent.terms, term), (*parent.thetas, guess)
        states = problem.states(terms, thetas, parent.nuisance_thetas)
        if term.effect.kind == "discrete":
            # Far from the parent, whose nuisances were bent to make up for it: fit those again.
            fits = [problem.fit(terms, thetas, start, _SHORT) for start in yaw_starts(problem.nuisances)]
            best = min(fits, key=lambda fit: fit.sse)
            return Start(term, guess, best.sse, best.nuisance_thetas)
        neutral = term.effect.starts is None
        r = residual if neutral else self._with_priors(problem.residual(states[-1].reading), parent)
        place = len(problem.nuisances) + len(parent.terms)
        J = problem.columns(terms, thetas, parent.nuisance_thetas, states, [place])
        if not np.isfinite(r).all() or not np.isfinite(J).all():
            return None
        # The new effect's own prior is too weak to matter for a first guess.
        J = np.vstack([J, np.zeros((r.size - len(J), J.shape[1]))])
        left = r - basis @ (basis.T @ r)
        # The parent is fitted, so what its columns still take away is not this effect's merit alone.
        expected = parent.sse - float(residual @ residual) + float(left @ left)
        theta = guess
        if J.shape[1]:
            J = J - basis @ (basis.T @ J)
            normal = J.T @ J
            size = np.sqrt(np.maximum(np.diag(normal), 1e-300))
            scaled = normal / np.outer(size, size)
            scaled[np.diag_indices_from(scaled)] += 1e-7
            right = (J.T @ left) / size
            step = np.linalg.solve(scaled, right)
            expected -= float(2.0 * right @ step - step @ (normal / np.outer(size, size)) @ step)
            theta = guess.copy()
            theta[term.free] += step / size
            theta = np.clip(theta, term.lower, term.upper)
        return Start(term, theta, expected)


def _orthonormal(columns: FloatArray) -> FloatArray:
    if not columns.shape[1]:
        return columns
    size = np.sqrt(np.maximum((columns**2).sum(axis=0), 1e-300))
    u, s, _ = np.linalg.svd(columns / size, full_matrices=False)
    return np.asarray(u[:, s > 1e-6 * max(float(s[0]), 1e-300)])
