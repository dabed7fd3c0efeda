"""The iron that a calibration cures, read backwards; and derivatives through the whole chain."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from mavcompass.correction import IDENTITY, FieldCorrection
from mavcompass.frames import FloatArray
from mavcompass.gap.fit.candidates import Candidates
from mavcompass.gap.fit.hypothesis import Fit, make_term
from mavcompass.gap.fit.model import Problem
from mavcompass.gap.fit.search import Search
from mavcompass.gap.replay.noise import SensorNoise, white
from mavcompass.gap.replay.nominal import Replay, replay
from mavcompass.gap.replay.nuisance import (
    AGE,
    ANOTHER_IRON,
    REFERENCE_YAW,
    STATED,
    WORLD_FIELD,
    KnownIron,
    Prior,
    known_iron,
    reference_attitude_error,
)
from mavcompass.gap.residual.floor import from_recording
from mavcompass.gap.trial.cases import Recipe, make_track, stimulus_of
from mavcompass.simulation import effects
from mavcompass.simulation.effects.effect import Signals
from mavcompass.simulation.physics.signals import ideal

RICH = Recipe("rich", duration_s=30.0, rate_hz=20.0, seed=21)


def triple(low: float, high: float) -> st.SearchStrategy[tuple[float, float, float]]:
    one = st.floats(low, high)
    return st.tuples(one, one, one)


CORRECTIONS = st.builds(
    FieldCorrection,
    offsets_mgauss=triple(-900.0, 900.0),
    diagonals=triple(0.8, 1.2),
    off_diagonals=triple(-0.2, 0.2),
    scale=st.floats(0.8, 1.3),
    motor_mgauss=triple(-20.0, 20.0),
    motor_source=st.just("current"),
)
FULL = FieldCorrection(
    (120.0, -80.0, 45.0), (1.05, 0.93, 1.1), (0.06, -0.04, 0.09), 1.07, (1.5, -2.0, 0.7), "current"
)


def some_fields(seed: int = 0, n: int = 40) -> tuple[FloatArray, FloatArray]:
    rng = np.random.default_rng(seed)
    return rng.normal(0.0, 400.0, (n, 3)), rng.uniform(0.0, 30.0, n)


@settings(max_examples=80)
@given(CORRECTIONS, st.integers(0, 1000))
def test_raw_and_field_are_inverse_and_agree_with_the_correction(
    correction: FieldCorrection, seed: int
) -> None:
    field, load = some_fields(seed)
    iron = known_iron(correction, load, "current")
    raw = iron.raw(field)
    np.testing.assert_allclose(iron.field(raw), field, atol=1e-8)
    np.testing.assert_allclose(iron.raw(iron.field(field)), field, atol=1e-8)
    np.testing.assert_allclose(raw, correction.undo(field, load), atol=1e-8)
    np.testing.assert_allclose(iron.field(field), correction.apply(field, load), atol=1e-8)


def in_order(prior: Prior, signals: Signals, thetas: list[FloatArray]) -> FloatArray:
    """Run the two nuisances in the order of their stages."""
    assert prior.effects[0].stage < prior.effects[1].stage
    for effect, theta in zip(prior.effects, thetas, strict=True):
        signals = effect.forward(signals, theta, {}, None)
    return signals.reading.mag_mgauss


@pytest.mark.parametrize("loaded", [True, False])
def test_nuisances_at_zero_are_the_iron_and_beside_it_what_they_say(loaded: bool) -> None:
    stimulus = stimulus_of(RICH)
    signals = Signals(stimulus, ideal(stimulus))
    load = stimulus.current_a if loaded else np.zeros(stimulus.time_s.size)
    iron = known_iron(FULL, load, "current")
    prior = iron.prior(STATED)
    zeros = [prior.mean[place] for place in prior.places.values()]
    assert [z.size for z in zeros] == [9, 6 if loaded else 3]
    field = signals.reading.mag_mgauss
    np.testing.assert_allclose(in_order(prior, signals, zeros), iron.raw(field), atol=1e-9)
    rng = np.random.default_rng(1)
    off = [rng.normal(0.0, 0.02, 9), rng.normal(0.0, 5.0, zeros[1].size)]
    expected = field @ (iron.matrix @ (np.eye(3) + off[0].reshape(3, 3))).T + iron.offset_mgauss + off[1][:3]
    expected += load[:, None] * iron.motor_mgauss
    if loaded:
        expected += (load - load.mean())[:, None] * off[1][3:]
    np.testing.assert_allclose(in_order(prior, signals, off), expected, atol=1e-9)


def test_trust_grows_with_what_is_cured_and_a_steady_load_tells_nothing_of_motors() -> None:
    n = 30
    bare = known_iron(IDENTITY, np.zeros(n), "none")
    assert not bare.calibrated and known_iron(FULL, np.zeros(n), "current").calibrated
    np.testing.assert_allclose(bare.sigma(STATED), [1.0] * 3 + [0.003] * 9)
    full = known_iron(FULL, np.zeros(n), "current")
    np.testing.assert_allclose(full.sigma(STATED)[:3], 1.0 + 0.02 * np.array([120.0, 80.0, 45.0]))
    assert (full.sigma(STATED)[3:] > 0.003).all()
    np.testing.assert_allclose(full.sigma(ANOTHER_IRON), [150.0] * 3 + [0.1] * 9)

    def motor_sigma(iron: KnownIron) -> FloatArray:
        return np.diag(iron.prior(STATED).precision)[12:] ** -0.5

    varying = known_iron(FULL, np.linspace(2.0, 22.0, n), "current")
    np.testing.assert_allclose(motor_sigma(varying), 1.0 / 20.0)
    steady = known_iron(FULL, np.linspace(10.0, 10.5, n), "current")
    np.testing.assert_allclose(motor_sigma(steady), 1e-6)


@pytest.fixture(scope="module")
def replayed() -> Replay:
    return replay(make_track(RICH, [effects.parse("hard_iron:x=40,y=-25,z=10")]))


def plain(replayed: Replay) -> Problem:
    floor = from_recording(replayed)
    return Problem(replayed, floor.noise, replayed.valid, floor.prior)


def test_expected_gain_of_a_hard_iron_is_that_of_a_real_fit(replayed: Replay) -> None:
    problem = plain(replayed)
    null = problem.null()
    term = make_term(effects.catalogue()["hard_iron"], replayed.signals)
    block = np.floor((replayed.time_s - replayed.time_s[0]) / 2.5).astype(np.int64)
    candidates = Candidates(problem, [term], null, block)
    assert candidates.expected([()])[0] == pytest.approx(null.sse, rel=1e-6)
    fit = problem.fit(null.beside(term, np.zeros(3)))
    gain = null.sse - candidates.expected([candidates.list])[0]
    assert gain == pytest.approx(null.sse - fit.sse, rel=2e-3) and gain > 1000.0
    start = candidates.start(candidates.list, replace(null, terms=(), thetas=()))
    np.testing.assert_allclose(start.thetas[0], fit.thetas[0], atol=0.1)
    np.testing.assert_allclose(fit.thetas[0], [40.0, -25.0, 10.0], atol=1.0)


def test_search_takes_the_hard_iron_and_nothing_beside_it(replayed: Replay) -> None:
    some = [effects.catalogue()[name] for name in ("hard_iron", "axis_scale", "motor_current")]
    found = Search(plain(replayed), some).run(2)
    assert found.ids == {"hard_iron"}
    np.testing.assert_allclose(found.thetas[0], [40.0, -25.0, 10.0], atol=1.0)


def bends_of_the_yaw(t: FloatArray, yaw: FloatArray) -> FloatArray:
    """Return two curves of the yaw alone, of some degrees."""
    curves = np.zeros((t.size, 3, 2))
    curves[:, 2] = np.radians(np.stack([2.0 * np.sin(yaw), np.linspace(-3.0, 3.0, t.size)], axis=1))
    return curves


def wanderings_of_the_attitude(t: FloatArray, yaw: FloatArray) -> FloatArray:
    """Return two curves of the level and of all three axes: rotations add up where they are small."""
    curves = np.zeros((t.size, 3, 2))
    curves[:, :2, 0] = np.radians(np.stack([np.linspace(-0.1, 0.1, t.size), 0.07 * np.cos(yaw)], axis=1))
    curves[:, :, 1] = np.radians(0.05) * np.sin(0.4 * t[:, None] + np.array([0.0, 1.0, 2.0]))
    return curves


def whole_chain(
    replayed: Replay, noise: SensorNoise, drawn: Callable[[FloatArray, FloatArray], FloatArray]
) -> tuple[Problem, list[FloatArray]]:
    """Return a problem with every kind of nuisance, and values for them away from zero."""
    rotation = replayed.reference.rotation
    curves = drawn(replayed.time_s, np.arctan2(rotation[:, 1, 0], rotation[:, 0, 0]))
    with_yaw = 0.006 * np.stack([np.cos(0.3 * replayed.time_s + k) for k in range(3)], axis=1)
    iron = known_iron(FULL, replayed.signals.stimulus.current_a, "current")
    prior = Prior.of(WORLD_FIELD, np.zeros(3), np.full(3, 5.0)).beside(
        Prior.of(reference_attitude_error(curves, with_yaw), np.zeros(3), np.array([0.1, 1.0, 1.0])),
        iron.prior(STATED),
        Prior.of(AGE, np.array([0.06]), np.array([0.05])),
    )
    rng = np.random.default_rng(4)
    thetas = [
        np.array([5.0, -3.0, 4.0]),
        np.array([0.2, 0.7, -1.1]),
        rng.normal(0.0, 0.01, 9),
        rng.normal(0.0, 2.0, 6),
        np.array([0.0837]),
    ]
    reference = replace(replayed.reference, with_yaw=with_yaw, curves_rad=curves)
    bent = replace(replayed, reference=reference, groups=("mag",))
    return Problem(bent, {"mag": noise}, bent.valid, prior), thetas


WANDERING = SensorNoise(
    np.full((1, 3), 0.95), np.full(3, 3.0), np.full(3, 3.6), 500.0, moving=np.full(3, 0.7)
)


@pytest.mark.parametrize("noise", [white(np.full(3, 3.0)), WANDERING], ids=["white", "wandering"])
@pytest.mark.parametrize("drawn", [bends_of_the_yaw, wanderings_of_the_attitude])
def test_derivatives_are_finite_differences_through_the_whole_chain(
    replayed: Replay, noise: SensorNoise, drawn: Callable[[FloatArray, FloatArray], FloatArray]
) -> None:
    problem, nuisances = whole_chain(replayed, noise, drawn)
    texts = ("hard_iron:x=30,y=-20,z=10", "soft_iron:xx=0.03,xy=0.02", "motor_current:x=1,y=-0.5,z=0.2")
    members = [effects.parse(text) for text in (*texts, "misalignment:x=0.02,y=-0.03,z=0.04")]
    terms = [make_term(s.effect, replayed.signals) for s in members]
    thetas = [s.theta for s in members]
    fit = Fit(tuple(terms), tuple(thetas), np.concatenate(nuisances))
    everything = [*nuisances, *thetas]
    n = len(nuisances)
    columns = problem.columns(fit, problem.composition.states(fit), range(len(everything)))
    at = 0
    for place, theta in enumerate(everything):
        nuisance = place < n
        effect = problem.prior.effects[place] if nuisance else terms[place - n].effect
        free = range(theta.size) if nuisance else np.flatnonzero(terms[place - n].free)
        for j in free:
            h = 1e-4 * max(effect.parameters[j].scale, 1e-9)
            ends = []
            for sign in (1.0, -1.0):
                moved = [x.copy() for x in everything]
                moved[place][j] += sign * h
                reading = problem.predict(Fit(tuple(terms), tuple(moved[n:]), np.concatenate(moved[:n])))
                ends.append(-problem.residual(reading))
            exact = (ends[0] - ends[1]) / (2.0 * h)
            off = float(np.linalg.norm(columns[:, at] - exact))
            # What is late is interpolated, and a vehicle turns a little between two rows.
            assert off < 4e-3 * max(float(np.linalg.norm(exact)), 1e-6), (effect.id, j)
            at += 1
    assert at == columns.shape[1]
    assert problem.prior.effects[1].id == REFERENCE_YAW and math.isfinite(float(columns.sum()))
