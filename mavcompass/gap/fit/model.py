"""Fit hypotheses (nuisances and effects with values) to a replay by Gauss and Newton.

The residual is whitened by the noise floor, so that its sum of squares is minus twice the logarithm of
the likelihood, up to a constant.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from mavcompass.chance import chance_of_more
from mavcompass.frames import FloatArray
from mavcompass.gap.fit.algebra import bridge, cluster_covariance, invert, solve_within
from mavcompass.gap.fit.composition import Changes, Composition
from mavcompass.gap.fit.hypothesis import CHANCE, Fit, Mask, weak_precision
from mavcompass.gap.replay.noise import Noise, group_values
from mavcompass.gap.replay.nominal import Replay
from mavcompass.gap.replay.nuisance import Prior, block_diagonal
from mavcompass.gap.tables import usual
from mavcompass.simulation.effects.effect import Group, Signals
from mavcompass.simulation.physics.signals import Reading


class Problem:
    """Fit hypotheses to the rows of a replay under a noise floor."""

    def __init__(self, replay: Replay, noise: Noise, rows: Mask, prior: Prior) -> None:
        """Fit `rows` (N,)."""
        self.replay = replay
        self.rows = rows
        self.prior = prior
        self.groups = replay.groups
        self.composition = Composition(replay, prior)
        usable = replay.valid.copy()
        most = max((noise[g].coefficients.shape[0] for g in self.groups), default=0)
        for lag in range(1, most + 1):
            usable[lag:] &= replay.valid[:-lag]
            usable[:lag] = False
        step = np.diff(replay.time_s, prepend=replay.time_s[0])
        gap = step > 3.0 * float(np.median(step[1:]))
        for lag in range(most):
            usable[lag:] &= ~gap[: gap.size - lag]
        # What errs together has ended in so long a silence: the next reading tells its level anew.
        valid = np.flatnonzero(replay.valid)
        after = np.searchsorted(valid, np.flatnonzero(step > usual.noise.lasting_s))
        begins = np.unique(valid[after[after < valid.size]])
        usable[begins] = True
        self.noise = {g: replace(one, begins=begins) for g, one in noise.items()}
        self.usable = usable
        self.index = np.flatnonzero(rows & usable)
        self._measured = {g: np.nan_to_num(group_values(replay.measured, g)) for g in self.groups}
        # The first nuisance, the world field, is linear: its derivatives are always as good as new.
        sizes = [e.scale if i else np.full(len(e.parameters), np.inf) for i, e in enumerate(prior.effects)]
        self._sizes = np.concatenate([np.zeros(0), *sizes])
        self._bridge = bridge(replay.valid) if any(noise[g].moving.any() for g in self.groups) else None
        self._null: Fit | None = None
        self._ended: set[Fit] = set()

    @property
    def sigma_mgauss(self) -> FloatArray:
        """Return the noise of the compass in its own axes, (3,)."""
        noise = self.noise["mag"]
        return noise.rms if noise.channels is None else np.full(3, float(np.sqrt(np.mean(noise.rms**2))))

    @property
    def count(self) -> int:
        """Count the fitted rows."""
        return int(self.index.size)

    def with_rows(self, rows: Mask) -> Problem:
        """Return the same problem on other rows."""
        return Problem(self.replay, self.noise, rows, self.prior)

    def predict(self, fit: Fit, effects: bool = True) -> Reading:
        """Return what the simulation says under a hypothesis, or under its nuisances alone."""
        return self.signals(fit if effects else Fit(nuisances=fit.nuisances)).reading

    def signals(self, fit: Fit) -> Signals:
        """Return the simulated signals under a hypothesis."""
        return self.composition.states(fit)[-1]

    def innovations(self, reading: Reading) -> dict[Group, FloatArray]:
        """Return measured minus predicted, whitened, (N, 3) per sensor."""
        return {g: self._white(g, self._measured[g] - group_values(reading, g)) for g in self.groups}

    def residual(self, reading: Reading) -> FloatArray:
        """Return the whitened residual of the fitted rows as one vector."""
        return self._rows(self.innovations(reading))

    def shift(self, after: Reading, before: Reading) -> FloatArray:
        """Return how predictions differ, whitened; rows as in `residual`."""
        return self._rows(
            {g: self._white(g, group_values(after, g) - group_values(before, g)) for g in self.groups}
        )

    def _white(self, group: Group, values: FloatArray) -> FloatArray:
        return self.noise[group].whiten(self._bridged(values))

    def _rows(self, white: dict[Group, FloatArray]) -> FloatArray:
        return np.concatenate([white[g][self.index].ravel() for g in self.groups])

    def _bridged(self, values: FloatArray) -> FloatArray:
        """Hold values across rows without a reading, so that what is correlated stays so."""
        return values if self._bridge is None else values[self._bridge]

    def columns(self, fit: Fit, states: list[Signals], wanted: Sequence[int]) -> FloatArray:
        """Return the derivatives of the whitened prediction by the free parameters of some members.

        `wanted` holds places: nuisances first, then terms. One column per free parameter.
        """
        return self.whitened(self.composition.changes(fit, states, wanted))

    def jacobian(self, fit: Fit) -> FloatArray:
        """Return the derivatives of the whitened prediction by all that a fit may move."""
        every = range(len(self.prior.effects) + len(fit.terms))
        return self.columns(fit, self.composition.states(fit), every)

    def whitened(self, changes: Changes) -> FloatArray:
        """Return changes of the prediction as whitened columns, one for each; rows as in `residual`."""
        if not changes:
            return np.zeros((self.index.size * 3 * len(self.groups), 0))
        white = (self.noise[g].whiten_many(self._bridged(changes[g])) for g in self.groups)
        return np.concatenate([values[self.index].reshape(-1, values.shape[2]) for values in white])

    def squares(self, fit: Fit) -> float:
        """Return the whitened sum of squares that a fit leaves, the priors' apart; zero without rows."""
        return float(np.sum(self.residual(self.predict(fit)) ** 2)) if self.count else 0.0

    def lasting_covariance(self, fit: Fit) -> FloatArray:
        """Return the covariance of a fit's nuisances and free parameters where errors last for seconds.

        An attitude wanders: readings that follow each other err together, which no noise of single readings
        tells (`cluster_covariance`).
        """
        columns, r = self.jacobian(fit), self.residual(self.predict(fit))
        block = np.floor(self.replay.time_s[self.index] / usual.noise.lasting_s).astype(np.int64)
        label = np.tile(np.repeat(block, 3), len(self.groups))
        return cluster_covariance(columns, r, label, self._known(weak_precision(fit.terms)))

    def information(self, fit: Fit, about: NDArray[np.int64]) -> tuple[FloatArray, FloatArray]:
        """Return what the readings alone tell of some nuisances and free parameters (K) of a fit.

        As the precision (K, K) of a normal distribution, all others integrated out with what is known of
        them, and that times its mean, (K,).
        """
        free = [theta[term.free] for term, theta in zip(fit.terms, fit.thetas, strict=True)]
        values = np.concatenate([fit.nuisances, *free])
        off = values - np.append(self.prior.mean, np.zeros(values.size - self.prior.mean.size))
        columns, r = self.jacobian(fit), self.residual(self.predict(fit))
        others = np.setdiff1d(np.arange(values.size), about)
        known = self._known(weak_precision(fit.terms))[np.ix_(others, others)]
        own, beside = columns[:, about], columns[:, others]
        across = own.T @ beside
        through = np.linalg.solve(beside.T @ beside + known, across.T).T
        told = own.T @ own - through @ across.T
        toward = own.T @ r - through @ (beside.T @ r - known @ off[others])
        return told, told @ values[about] + toward

    def values(self, fit: Fit) -> dict[str, FloatArray]:
        """Return what a fit makes of each nuisance, by its id."""
        return {nuisance: fit.nuisances[at] for nuisance, at in self.prior.places.items()}

    def mahalanobis2(self, fit: Fit) -> float:
        """Return how far a fit is from what is known of vehicle and place together, as Mahalanobis' distance
        squared.

        The yaw's constant may be known; how it wanders is no knowledge of them.
        """
        known = self.prior.known
        off = (fit.nuisances - self.prior.mean)[known]
        return float(off @ self.prior.precision[np.ix_(known, known)] @ off)

    def chance_of_mahalanobis2(self, fit: Fit) -> float:
        """Return the probability that what is known of vehicle and place is off by so much, by chance."""
        known = int(self.prior.known.sum())
        return chance_of_more(self.mahalanobis2(fit), known) if known else 1.0

    def nuisances_within_prior(self, fit: Fit) -> bool:
        """Tell whether a fit is no farther from what is known of vehicle and place than by chance."""
        return self.chance_of_mahalanobis2(fit) > CHANCE

    def null(self, near: Fit | None = None) -> Fit:
        """Fit the nuisances alone, from their means or from where another problem has them, as far as it
        does."""
        if self._null is None:
            have = self.prior.mean[:0] if near is None else near.nuisances
            self._null = self.fit(Fit(nuisances=np.append(have, self.prior.mean[have.size :])))
        return self._null

    def refit(self, fit: Fit) -> Fit:
        """Fit the same hypothesis to the rows of this problem, from the values that it has; what came to its
        end here stays."""
        return fit if fit in self._ended else self.fit(fit)

    def fit(self, start: Fit, iterations: int = usual.newton.iterations) -> Fit:
        """Fit from a start by Levenberg and Marquardt; parameters stay inside their physical ranges."""
        terms, prior, n = start.terms, self.prior.mean, len(self.prior.effects)
        z = np.concatenate([start.nuisances, *start.thetas])
        ends = np.cumsum([x.size for x in (start.nuisances, *start.thetas)])
        lower, upper = (
            np.concatenate([getattr(of, end) for of in (self.prior, *terms)]) for end in ("lower", "upper")
        )
        every = np.ones(prior.size, dtype=np.bool_)
        free = np.flatnonzero(np.concatenate([every, *(t.free for t in terms)]))
        known = self._known(weak_precision(terms))
        mean = np.append(prior, np.zeros(len(known) - prior.size))

        def at(z: FloatArray) -> Fit:
            nuisances, *thetas = np.split(z, ends[:-1])
            return Fit(terms, tuple(thetas), nuisances)

        def cost_of(r: FloatArray, z: FloatArray) -> float:
            return float(r @ r + (z[free] - mean) @ known @ (z[free] - mean))

        states = self.composition.states(at(z))
        r = self.residual(states[-1].reading)
        cost = cost_of(r, z)
        damping = 1e-6
        normal = np.zeros((0, 0))
        first, made_at, own, ended = None, z, None, False
        for _ in range(iterations):
            # By how many natural sizes nuisances have moved at most since their derivatives were made.
            away = np.max(np.abs(z - made_at)[: self._sizes.size] / self._sizes, initial=0.0)
            if first is None or away > usual.newton.near:
                first, made_at = self.columns(at(z), states, range(n)), z
                squared = first.T @ first
            if own is None:
                own = self.columns(at(z), states, range(n, n + len(terms)))
            across = first.T @ own
            normal = np.block([[squared, across], [across.T, own.T @ own]]) + known
            gradient = np.concatenate([first.T @ r, own.T @ r]) - known @ (z[free] - mean)
            if not normal.size:
                break
            # Where much is left, the noise is larger than stated, and so is what chance gains.
            gained, least = 0.0, usual.newton.converged * max(1.0, cost / max(r.size, 1))
            for _ in range(usual.newton.trials):
                step = solve_within(normal, gradient, damping, (lower - z)[free], (upper - z)[free])
                expected = float(step @ (2.0 * gradient - normal @ step))
                if expected < least:
                    break
                trial = z.copy()
                trial[free] += step
                trial = np.clip(trial, lower, upper)
                trial_states = self.composition.states(at(trial))
                trial_r = self.residual(trial_states[-1].reading)
                trial_cost = cost_of(trial_r, trial)
                if trial_cost < cost:
                    gained = cost - trial_cost
                    z, states, r, cost = trial, trial_states, trial_r, trial_cost
                    damping *= 0.03 if gained > usual.newton.as_expected * expected else 1.0
                    break
                damping = 30.0 * max(damping, usual.newton.damping)
            if gained >= least:
                if expected > usual.newton.small or gained < usual.newton.as_expected * expected:
                    own = None
                continue
            ended = True
            break
        covariance = invert(normal) if normal.size else normal
        fit = replace(at(z), sse=cost, covariance=covariance)
        if ended:
            self._ended.add(fit)
        return fit

    def _known(self, weak: FloatArray) -> FloatArray:
        """Return the precision of nuisances and free parameters before any reading."""
        return block_diagonal([self.prior.precision, np.diag(weak)])
