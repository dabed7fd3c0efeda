"""Fit hypotheses (nuisances and effects with values) to a replay by Gauss and Newton.

The residual is whitened by the noise floor, so that its sum of squares is minus twice the logarithm of
the likelihood, up to a constant.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from mavcompass.chance import chance_of_more
from mavcompass.frames import FloatArray
from mavcompass.gap.fit.algebra import bridge, cluster_covariance, invert, moved, room, solve_within
from mavcompass.gap.fit.composition import Changes, Composition
from mavcompass.gap.fit.hypothesis import CHANCE, Fit, Mask, Term, weak_cost, weak_precision
from mavcompass.gap.replay.noise import Noise, group_values
from mavcompass.gap.replay.nominal import Replay
from mavcompass.gap.replay.nuisance import Prior
from mavcompass.simulation.effects.effect import Group, Signals
from mavcompass.simulation.physics.signals import Reading

_ITERATIONS = 12
_CONVERGED = 0.02
# Steps tried at a place, each shorter by a damping that tells; and the share of the expected gain that lets
# the next be longer.
_TRIALS, _LEAST_DAMPING, _AS_EXPECTED = 4, 1e-3, 0.5
# After a step by so few squared sigmas derivatives are as good as new.
_SMALL = 4.0
# The first nuisance, the world field, is linear; of the others a derivative is as good as new so near, in
# natural sizes.
_NEAR = 2.0
# What errs together, in seconds.
_LASTING_S = 10.0


class Problem:
    """Fit hypotheses to the rows of a replay under a noise floor."""

    def __init__(self, replay: Replay, noise: Noise, rows: Mask, prior: Prior) -> None:
        """Fit `rows` (N,)."""
        self.replay = replay
        self.noise = noise
        self.rows = rows
        self.prior = prior
        self.nuisances = prior.nuisances
        self.groups = replay.groups
        self.composition = Composition(replay, prior.nuisances)
        usable = replay.valid.copy()
        most = max((noise[g].coefficients.shape[0] for g in self.groups), default=0)
        for lag in range(1, most + 1):
            usable[lag:] &= replay.valid[:-lag]
            usable[:lag] = False
        step = np.diff(replay.time_s, prepend=replay.time_s[0])
        gap = step > 3.0 * float(np.median(step[1:]))
        for lag in range(most):
            usable[lag:] &= ~gap[: gap.size - lag]
        self.usable = usable
        self.index = np.flatnonzero(rows & usable)
        self._measured = {g: np.nan_to_num(group_values(replay.measured, g)) for g in self.groups}
        self._precision, self._scales = prior.precision, [n.effect.scale for n in prior.nuisances]
        self._bridge = bridge(replay.valid) if any(noise[g].moving.any() for g in self.groups) else None
        self._null: Fit | None = None
        self._ended: set[Fit] = set()
        self._prior = prior.mean

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
        known = fit if effects else Fit((), (), fit.nuisance_thetas, np.inf)
        return self.signals(known).reading

    def signals(self, fit: Fit) -> Signals:
        """Return the simulated signals under a hypothesis."""
        return self.composition.states(fit.terms, fit.thetas, fit.nuisance_thetas)[-1]

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

    def columns(
        self, terms: Sequence[Term], thetas: Sequence[FloatArray], nuisance_thetas: Sequence[FloatArray],
        states: list[Signals], wanted: Sequence[int],
    ) -> FloatArray:  # fmt: skip
        """Return the derivatives of the whitened prediction by the free parameters of some members.

        `wanted` holds places: nuisances first, then terms. One column per free parameter.
        """
        return self.whitened(self.composition.changes(terms, thetas, nuisance_thetas, states, wanted))

    def jacobian(self, fit: Fit) -> FloatArray:
        """Return the derivatives of the whitened prediction by all that a fit may move."""
        states = self.composition.states(fit.terms, fit.thetas, fit.nuisance_thetas)
        n = len(self.nuisances)
        members = range(n + len(fit.terms))
        return self.columns(fit.terms, fit.thetas, fit.nuisance_thetas, states, members)

    def nuisance_changes(self, fit: Fit) -> Changes:
        """Return the derivatives of the prediction by the nuisances' parameters, under a fit."""
        states = self.composition.states(fit.terms, fit.thetas, fit.nuisance_thetas)
        places = range(len(self.nuisances))
        return self.composition.changes(fit.terms, fit.thetas, fit.nuisance_thetas, states, places)

    def whitened(self, changes: Changes) -> FloatArray:
        """Return changes of the prediction as whitened columns, one for each; rows as in `residual`."""
        if not changes:
            return np.zeros((self.index.size * 3 * len(self.groups), 0))
        white = (self.noise[g].whiten_many(self._bridged(changes[g])) for g in self.groups)
        return np.concatenate([values[self.index].reshape(-1, values.shape[2]) for values in white])

    def lasting_covariance(self, fit: Fit) -> FloatArray:
        """Return the covariance of a fit's nuisances and free parameters where errors last for seconds.

        An attitude wanders: readings that follow each other err together, which no noise of single readings
        tells (`cluster_covariance`).
        """
        columns, r = self.jacobian(fit), self.residual(self.predict(fit))
        block = np.floor(self.replay.time_s[self.index] / _LASTING_S).astype(np.int64)
        label = np.tile(np.repeat(block, 3), len(self.groups))
        return cluster_covariance(columns, r, label, self._known(weak_precision(fit.terms)))

    def values(self, fit: Fit) -> dict[str, FloatArray]:
        """Return what a fit makes of each nuisance, by its id."""
        pairs = zip(self.nuisances, fit.nuisance_thetas, strict=True)
        return {nuisance.effect.id: theta for nuisance, theta in pairs}

    def strain(self, fit: Fit) -> float:
        """Return how far a fit strains what is known of vehicle and place together, in squared sigmas.

        The yaw's constant may be known; how it wanders is no knowledge of them.
        """
        parts = [np.arange(n.mean.size) < n.known for n in self.nuisances]
        rows = np.concatenate([*parts, np.zeros(0, dtype=np.bool_)])
        off = (np.concatenate([*fit.nuisance_thetas, np.zeros(0)]) - self._prior)[rows]
        return float(off @ self._precision[np.ix_(rows, rows)] @ off)

    def chance_of_strain(self, fit: Fit) -> float:
        """Return the probability that what is known of vehicle and place is off by so much, by chance."""
        known = sum(n.known for n in self.nuisances)
        return chance_of_more(self.strain(fit), known) if known else 1.0

    def straight(self, fit: Fit) -> bool:
        """Tell whether a fit bends what is known of vehicle and place no further than by chance."""
        return self.chance_of_strain(fit) > CHANCE

    def null(self, near: Fit | None = None) -> Fit:
        """Fit the nuisances alone, from their means or from where another problem has them, as far as it
        does."""
        if self._null is None:
            have = () if near is None else near.nuisance_thetas
            self._null = self.fit((), (), (*have, *(n.mean for n in self.nuisances[len(have) :])))
        return self._null

    def refit(self, fit: Fit) -> Fit:
        """Fit the same hypothesis to the rows of this problem, from the values that it has; what came to its
        end here stays."""
        return fit if fit in self._ended else self.fit(fit.terms, fit.thetas, fit.nuisance_thetas)

    def fit(
        self,
        terms: Sequence[Term],
        thetas: Sequence[FloatArray],
        nuisance_thetas: Sequence[FloatArray],
        iterations: int = _ITERATIONS,
    ) -> Fit:
        """Fit from a start by Levenberg and Marquardt; parameters stay inside their physical ranges."""
        terms = tuple(terms)
        x = [np.array(t, dtype=np.float64) for t in (*nuisance_thetas, *thetas)]
        n = len(self.nuisances)
        free = [self.composition.free(terms, i) for i in range(len(x))]
        weak = weak_precision(terms)
        bounds = [(n.effect.lower, n.effect.upper) for n in self.nuisances]
        bounds += [(t.lower, t.upper) for t in terms]
        states = self.composition.states(terms, x[n:], x[:n])
        r = self.residual(states[-1].reading)
        cost = self._cost(r, x, free, weak)
        damping = 1e-6
        normal = np.zeros((0, 0))
        first, made_at, own, ended = None, x[:n], None, False
        for _ in range(iterations):
            if first is None or self._away(x[:n], made_at) > _NEAR:
                first, made_at = self.columns(terms, x[n:], x[:n], states, range(n)), x[:n]
                squared = first.T @ first
            if own is None:
                own = self.columns(terms, x[n:], x[:n], states, range(n, n + len(terms)))
            normal, gradient = self._equations(first, squared, own, r, x, free, weak)
            if not normal.size:
                break
            # Where much is left, the noise is larger than stated, and so is what chance gains.
            gained, least = 0.0, _CONVERGED * max(1.0, cost / max(r.size, 1))
            for _ in range(_TRIALS):
                step = solve_within(normal, gradient, damping, *room(x, free, bounds))
                expected = float(step @ (2.0 * gradient - normal @ step))
                if expected < least:
                    break
                trial = moved(x, step, free, bounds)
                trial_states = self.composition.states(terms, trial[n:], trial[:n])
                trial_r = self.residual(trial_states[-1].reading)
                trial_cost = self._cost(trial_r, trial, free, weak)
                if trial_cost < cost:
                    gained = cost - trial_cost
                    x, states, r, cost = trial, trial_states, trial_r, trial_cost
                    damping *= 0.03 if gained > _AS_EXPECTED * expected else 1.0
                    break
                damping = 30.0 * max(damping, _LEAST_DAMPING)
            if gained >= least:
                if expected > _SMALL or gained < _AS_EXPECTED * expected:
                    own = None
                continue
            ended = True
            break
        covariance = invert(normal) if normal.size else normal
        fit = Fit(terms, tuple(x[n:]), tuple(x[:n]), cost, covariance)
        if ended:
            self._ended.add(fit)
        return fit

    def _equations(
        self,
        first: FloatArray,
        squared: FloatArray,
        own: FloatArray,
        r: FloatArray,
        x: list[FloatArray],
        free: list[NDArray[np.int64]],
        weak: FloatArray,
    ) -> tuple[FloatArray, FloatArray]:
        """Return the normal matrix and the gradient, priors included, of derivatives whose first part is
        `squared` already."""
        n, n_dim = len(self.nuisances), self._prior.size
        across = first.T @ own
        normal = np.block([[squared, across], [across.T, own.T @ own]]) + self._known(weak)
        gradient = np.concatenate([first.T @ r, own.T @ r])
        if n_dim:
            gradient[:n_dim] += self._precision @ (self._prior - np.concatenate(x[:n]))
        if weak.size:
            amplitudes = np.concatenate([v[f] for v, f in zip(x[n:], free[n:], strict=True)])
            gradient[n_dim:] -= weak * amplitudes
        return normal, gradient

    def _known(self, weak: FloatArray) -> FloatArray:
        """Return the precision of nuisances and free parameters before any reading."""
        n_dim = self._prior.size
        known = np.diag(np.concatenate([np.zeros(n_dim), weak]))
        known[:n_dim, :n_dim] = self._precision if n_dim else 0.0
        return known

    def _cost(
        self, r: FloatArray, x: list[FloatArray], free: list[NDArray[np.int64]], weak: FloatArray
    ) -> float:
        n = len(self.nuisances)
        return float(r @ r) + self._prior_cost(x[:n]) + weak_cost(x[n:], free[n:], weak)

    def _away(self, thetas: Sequence[FloatArray], made_at: Sequence[FloatArray]) -> float:
        """Return by how many natural sizes nuisances moved at most since their derivatives were made."""
        return max(
            (
                float(np.max(np.abs(now - then) / scale, initial=0.0))
                for scale, now, then in zip(self._scales[1:], thetas[1:], made_at[1:], strict=True)
            ),
            default=0.0,
        )

    def _prior_cost(self, thetas: Sequence[FloatArray]) -> float:
        if not thetas:
            return 0.0
        off = np.concatenate(list(thetas)) - self._prior
        return float(off @ self._precision @ off)
