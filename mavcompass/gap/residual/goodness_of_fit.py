"""What is left: tests whether the innovations of a model still hold structure, and where.

Each test asks about one coordinate (heading, time, current ...). Smooth structure is sought by score
tests: regressors of the coordinate, orthogonalised to everything the model could still fit, give a
chi-squared number. Scatter, lines, bursts and correlation have tests of their own. Holm's procedure
turns all of them into one decision; the smallest p names the coordinate, never a cause.
"""

from __future__ import annotations

import math
from collections.abc import Collection, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import combinations_with_replacement

import numpy as np

from mavcompass.chance import chance_above, chance_of_more
from mavcompass.frames import FloatArray
from mavcompass.gap.fit.hypothesis import Fit, make_term
from mavcompass.gap.fit.model import Problem
from mavcompass.gap.replay.noise import SensorNoise, group_values
from mavcompass.gap.replay.nominal import Replay, untestable_effects
from mavcompass.gap.replay.nuisance import Prior, block_diagonal
from mavcompass.gap.residual.floor import first_noise, measured_noise
from mavcompass.gap.tables import usual
from mavcompass.simulation.effects.effect import Effect, Group, Signals

# Columns have unit length: what is left of a direction below this share is the model's own.
_RANK = 1e-4
_SENSOR_WORDS: dict[Group, str] = {"acc": "accelerometer", "gyro": "gyro"}


@dataclass(frozen=True, slots=True)
class Test:
    """Hold one test: what it looked at, and its p-value before Holm's correction.

    `excess` is its statistic over the degrees of freedom, where it has any: about one when all is well.
    """

    name: str
    coordinate: str
    p: float
    excess: float = 1.0


@dataclass(frozen=True, slots=True)
class GoodnessOfFit:
    """Hold all tests, sorted by p."""

    tests: tuple[Test, ...]

    @property
    def p(self) -> float:
        """Return the probability that chance alone makes the smallest p this small (Bonferroni)."""
        return min(1.0, self.tests[0].p * len(self.tests)) if self.tests else 1.0

    @property
    def where(self) -> str:
        """Return where what is left shows most."""
        return self.tests[0].coordinate if self.tests else "time"


def judge(problem: Problem, fit: Fit, compare_scatter: bool) -> GoodnessOfFit:
    """Test what a fit leaves, on all usable rows (the fit must have been made on all of them too).

    `compare_scatter` also compares the scatter with the floor's, which must then be representative.
    """
    tests = [*_structure(problem, fit), *_scatter(problem, fit, compare_scatter)]
    tests.sort(key=lambda test: test.p)
    return GoodnessOfFit(tuple(tests))


def _structure(problem: Problem, fit: Fit) -> Iterator[Test]:
    z = problem.innovations(problem.predict(fit))
    J, signals = problem.jacobian(fit), problem.signals(fit)
    n = problem.index.size
    size = np.sqrt(np.maximum((J**2).sum(axis=0), 1e-300))
    J = J / size
    spectrum, vectors = np.linalg.eigh(J.T @ J) if J.shape[1] else (np.zeros(0), np.zeros((0, 0)))
    root = vectors[:, spectrum > 1e-9] / np.sqrt(spectrum[spectrum > 1e-9])
    # Priors keep a fit off its optimum: take out what the model could still fit.
    left = np.concatenate([z[group][problem.index].ravel() for group in problem.groups])
    left = left - J @ (root @ (root.T @ (J.T @ left)))
    rest = left.reshape(len(problem.groups), n, 3)
    for at, group in enumerate(problem.groups):
        if group in problem.replay.doubtful:
            continue
        part = J[at * 3 * n : (at + 1) * 3 * n].reshape(n, 3, -1) if J.shape[1] else np.zeros((n, 3, 0))
        whitener = problem.noise[group]
        for name, coordinate, regressors in _blocks(group, signals):
            white = whitener.decorrelated(regressors[:, None])[problem.index]
            T = [np.ascontiguousarray(white[:, c]) for c in range(3)]
            yield _score_test(name, coordinate, T, rest[at], part, root)


def _score_test(
    name: str, coordinate: str, T: list[FloatArray], z: FloatArray, part: FloatArray, root: FloatArray
) -> Test:
    """Return the p-value of the score of regressors (n, q), one for each channel, beside the model's
    columns."""
    T = [t / np.sqrt(np.maximum((t**2).sum(axis=0), 1e-300)) for t in T]
    score = np.concatenate([t.T @ z[:, c] for c, t in enumerate(T)])
    V = block_diagonal([t.T @ t for t in T])
    if part.shape[2]:
        cross = np.concatenate([t.T @ part[:, c] for c, t in enumerate(T)]) @ root
        V = V - cross @ cross.T
    values, vectors = np.linalg.eigh(V)
    keep = values > _RANK
    if not keep.any():
        return Test(name, coordinate, 1.0)
    rotated = vectors[:, keep].T @ score
    statistic = float(np.sum(rotated**2 / values[keep]))
    freedom = int(keep.sum())
    return Test(name, coordinate, chance_of_more(statistic, freedom), statistic / freedom)


def _blocks(group: Group, signals: Signals) -> Iterator[tuple[str, str, FloatArray]]:
    """List the regressors of each coordinate, (N, q): name, coordinate, columns."""
    s = signals.stimulus
    n = s.time_s.size
    one = np.ones((n, 1))
    heading = np.arctan2(s.rotation[:, 1, 0], s.rotation[:, 0, 0])
    orders = np.arange(1, 5)
    waves = heading[:, None] * orders
    yield f"{group}: heading harmonics", "heading", np.hstack([one, np.cos(waves), np.sin(waves)])
    reading = group_values(signals.reading, group)
    # Direction seen by the sensor: field, or gravity, or rate.
    size = np.sqrt(np.mean(np.sum(reading**2, axis=1))) or 1.0
    u = reading / size
    yield f"{group}: direction, cubic", "tilt" if group == "acc" else "axis", _cubic(u)
    u_time = (s.time_s - s.time_s[0]) / max(float(s.time_s[-1] - s.time_s[0]), 1e-9)
    modes = np.cos(np.pi * u_time[:, None] * np.arange(1, 21))
    yield f"{group}: slow time", "time", modes
    slow = np.stack([u_time - 0.5, (u_time - 0.5) ** 2], axis=1)
    yield f"{group}: stability", "time", _products(slow, u)
    for name, load in s.loads.items():
        if np.isfinite(load).all() and float(load.std()) > 1e-6:
            yield f"{group}: {name}", name, _loads(load, u)
    if s.motors.size and float(s.motors.std(axis=0).max()) > 1e-6:
        worked = np.abs(s.motors)
        motors = worked - worked.mean(axis=0)
        yield f"{group}: motors", "throttle", np.hstack([motors, motors**2])
    rate = s.rate_radps
    if float(rate.std()) > 1e-6:
        change = np.gradient(reading, s.time_s, axis=0)
        second = np.gradient(change, s.time_s, axis=0)
        squares = np.stack([rate[:, i] * rate[:, j] for i in range(3) for j in range(i, 3)], axis=1)
        acceleration = np.gradient(rate, s.time_s, axis=0)
        parts = (
            [rate, squares, change, second, acceleration]
            if group != "gyro"
            else [rate, squares, acceleration]
        )
        yield f"{group}: rate", "rate", np.hstack(parts)
    position = s.position_ned_m
    if np.isfinite(position).all() and float(position.std(axis=0).max()) > 0.02:
        spread = np.maximum(position.std(axis=0), 1e-3)
        p = (position - position.mean(axis=0)) / spread
        field = _cubic(p)
        world = np.hstack([_products(p, s.rotation[:, i, :]) for i in range(3)])
        yield f"{group}: position", "position", field
        if group == "mag":
            yield f"{group}: position in the world", "position", world


def _cubic(u: FloatArray) -> FloatArray:
    """Return all products of up to three columns of (N, 3), a one among them."""
    products = [c for degree in range(4) for c in combinations_with_replacement(range(3), degree)]
    return np.stack([u[:, list(columns)].prod(axis=1) for columns in products], axis=1)


def _products(a: FloatArray, b: FloatArray) -> FloatArray:
    return np.asarray((a[:, :, None] * b[:, None, :]).reshape(len(a), -1))


def _loads(load: FloatArray, u: FloatArray) -> FloatArray:
    x = (load - load.mean()) / max(float(load.std()), 1e-9)
    lagged = np.stack([np.concatenate([np.full(k, x[0]), x[:-k]]) for k in (2, 5, 10, 20)], axis=1)
    step = np.gradient(x)
    own = np.stack([x, x**2, x**3, step, np.abs(step)], axis=1)
    return np.hstack([own, lagged, x[:, None] * u])


def _scatter(problem: Problem, fit: Fit, compare: bool) -> Iterator[Test]:
    """Test lines, correlation, bursts and the amount of scatter."""
    innovations = problem.innovations(problem.predict(fit))
    signals = problem.signals(fit)
    for group in problem.groups:
        if group in problem.replay.doubtful:
            continue
        z = innovations[group][problem.index]
        z = z - z.mean(axis=0)
        scale = z.std(axis=0)
        z = z / np.maximum(scale, 1e-9)
        yield Test(f"{group}: spectral line", "frequency", _line(z))
        lags = 20
        rho = np.stack([(z[lag:] * z[:-lag]).mean(axis=0) for lag in range(1, lags + 1)])
        # Their estimate has used up a correlation coefficient or so per lag of the floor's model.
        portmanteau = float((rho**2).sum()) * len(z)
        yield Test(f"{group}: correlation", "frequency", chance_of_more(portmanteau, 3 * lags))
        yield from _variance_tests(group, z, signals, problem)
        if compare and math.isfinite(problem.noise[group].samples):
            # Against the floor's, two-sided; the logarithm of the ratio is normal.
            log_ratio = 2.0 * float(np.log(np.maximum(scale, 1e-9)).sum())
            sigma = math.sqrt(3.0 * (2.0 / len(z) + 2.0 / problem.noise[group].samples))
            yield Test(f"{group}: amount of scatter", "time", 2.0 * chance_above(abs(log_ratio) / sigma))


def _line(z: FloatArray) -> float:
    """Return the p-value of the highest line of the periodogram, over axes together and alone."""
    power = np.abs(np.fft.rfft(z, axis=0)[1:-1]) ** 2 * 2.0 / len(z)
    together = float(power.sum(axis=1).max())
    alone = float(power.max())
    count = len(power)
    p = min(chance_of_more(together, 6) * count, chance_of_more(alone, 2) * 3 * count)
    return min(1.0, 2.0 * p)


def _variance_tests(group: Group, z: FloatArray, signals: Signals, problem: Problem) -> Iterator[Test]:
    power = (z**2).mean(axis=1) - 1.0
    # The variance of z^2 over that of a Gaussian's, from the bulk of the sample.
    factor = max(float(np.mean(z**4) - 1.0) / 2.0, 1.0)
    deviation = math.sqrt(2.0 * factor / 3.0)
    # Bursts: windows of half a second to eight seconds, each half overlapping the next.
    lowest, tried = 1.0, 0
    sums = np.concatenate([[0.0], np.cumsum(power)])
    means = np.vstack([np.zeros(3), np.cumsum(z, axis=0)])
    for width in (10, 20, 40, 80, 160):
        if width * 4 > len(z):
            break
        starts = np.arange(0, len(z) - width + 1, width // 2)
        excess = (sums[starts + width] - sums[starts]) / (deviation * math.sqrt(width))
        # A sum of squares is skewed: Wilson and Hilferty's cube root makes it normal.
        nu = 3.0 * width / factor
        ratio = np.maximum(1.0 + excess * deviation / math.sqrt(width), 1e-9)
        normal = (ratio ** (1.0 / 3.0) - (1.0 - 2.0 / (9.0 * nu))) / math.sqrt(2.0 / (9.0 * nu))
        shift = ((means[starts + width] - means[starts]) ** 2).sum(axis=1) / width
        lowest = min(lowest, chance_above(float(normal.max())), chance_of_more(float(shift.max()), 3))
        tried += 2 * starts.size
    yield Test(f"{group}: bursts", "time", min(1.0, lowest * tried))
    coordinates = _scatter_coordinates(group, signals, problem)
    for name, x in coordinates:
        x = (x - x.mean()) / max(float(x.std()), 1e-12)
        statistic = float(power @ x) / (deviation * math.sqrt(float(x @ x)))
        yield Test(f"{group}: scatter with {name}", name, chance_of_more(statistic**2, 1))


def _scatter_coordinates(group: Group, signals: Signals, problem: Problem) -> list[tuple[str, FloatArray]]:
    s = signals.stimulus
    rows = problem.index
    change = np.gradient(group_values(signals.reading, group), s.time_s, axis=0)
    found = [("rate", (change**2).sum(axis=1)[rows]), ("time", s.time_s[rows])]
    for name, load in (("current", s.current_a), ("temperature", s.temperature_degc)):
        if np.isfinite(load).all() and float(load.std()) > 1e-6:
            found.append((name, load[rows]))
    return [(name, x) for name, x in found if float(x.std()) > 0.0]


def doubting(
    replayed: Replay, baseline: Replay | None, effects: Collection[Effect]
) -> tuple[Replay, Replay | None]:
    """Let sensors that the simulation cannot explain, here or in the baseline, count for less in both."""
    never = untestable_effects(replayed, effects)
    doubtful = _doubtful(replayed, [e for e in effects if e.id not in never])
    # What a motion makes an accelerometer feel is no cause that would come again.
    steady = [e for e in effects if e.groups != ("acc",) or not e.needs - {"reference"}]
    if baseline is not None:
        never = untestable_effects(baseline, effects)
        there = _doubtful(baseline, [e for e in steady if e.id not in never])
        useless = _useless(doubtful) | _useless(there)
        baseline = _with_doubt(baseline, doubtful | there, useless, steady)
        return _with_doubt(replayed, doubtful | there, useless, steady), baseline
    return _with_doubt(replayed, doubtful, _useless(doubtful), steady), None


def _doubtful(witness: Replay, effects: Sequence[Effect]) -> dict[Group, SensorNoise]:
    """Return the noise of sensors that show structure beside all effects of theirs that a recording can test.

    A real accelerometer or gyro feels unknown motion, vibration, imperfect timing against the reference. What
    it says about a cause then counts by the noise that would make all this look like chance: the noise of
    its residual, raised until the worst of the structure in it is no more than that.
    """
    out: dict[Group, SensorNoise] = {}
    for group in witness.groups[1:]:
        alone = replace(witness, groups=(group,))
        terms = tuple(make_term(e, alone.signals) for e in effects if group in e.groups)
        problem = Problem(alone, first_noise(alone), alone.valid, Prior())
        fit = problem.fit(Fit(terms, tuple(t.effect.neutral() for t in terms)))
        noise = measured_noise(problem, fit)
        tests = judge(Problem(alone, noise, alone.valid, problem.prior), fit, compare_scatter=False).tests
        if tests[0].p <= usual.baseline.explained_p:
            worse, own = math.sqrt(max(1.0, *(t.excess for t in tests))), noise[group]
            out[group] = replace(own, sigma=own.sigma * worse, rms=own.rms * worse)
    return out


def _useless(doubtful: Mapping[Group, SensorNoise]) -> set[Group]:
    return {g for g, noise in doubtful.items() if float(noise.rms.mean()) > usual.baseline.useless[g]}


def _with_doubt(
    replayed: Replay, doubtful: Mapping[Group, SensorNoise], useless: set[Group], steady: Sequence[Effect]
) -> Replay:
    notes = tuple(
        f"The {_SENSOR_WORDS[g]} does not fit the reference in detail:"
        f" {'left out' if g in useless else 'it counts for less'}."
        for g in replayed.groups
        if g in doubtful
    )
    kept = tuple(g for g in replayed.groups if g not in useless)
    doubts = {g: noise for g, noise in doubtful.items() if g not in useless}
    # The noise is that beside the sensor's own errors: these no other cause may be blamed for.
    own = (Prior.of(e, e.neutral(), e.scale) for e in steady if set(e.groups) <= doubts.keys())
    prior = replayed.prior.beside(*own)
    return replace(replayed, groups=kept, doubtful=doubts, prior=prior, notes=(*replayed.notes, *notes))
