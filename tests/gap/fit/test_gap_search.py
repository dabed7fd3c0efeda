"""How sets of effects are looked for: what is returned to the known, how many, and when it ends."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from mavcompass.gap.fit.hypothesis import Fit, Term, make_term
from mavcompass.gap.fit.model import Problem
from mavcompass.gap.fit.search import Search, nuisances_at_prior
from mavcompass.gap.replay.nominal import replay
from mavcompass.gap.replay.nuisance import AGE, WORLD_FIELD, Prior, reference_attitude_error
from mavcompass.gap.tables import usual
from mavcompass.gap.trial.cases import CASE_NOISE, Recipe, make_track
from mavcompass.simulation.effects import parse, registry


@pytest.mark.parametrize(
    ("constant", "curves", "kept"),
    [
        # Sigmas of the constant, of each of four curves; which of them keep their value.
        (1.0, 1.0, (True, True)),
        (9.0, 1.0, (False, True)),
        (1.0, 9.0, (True, False)),
    ],
)
def test_an_attitude_that_a_gap_has_bent_is_returned_to_what_is_known(
    constant: float, curves: float, kept: tuple[bool, bool]
) -> None:
    sigma = np.array([0.02, 1.0, 1.0, 1.0, 1.0])
    yaw = Prior.of(reference_attitude_error(np.zeros((3, 3, 4))), np.zeros(5), sigma)
    bent = sigma * np.array([constant, *[curves] * 4])
    problem: Any = SimpleNamespace(
        replay=SimpleNamespace(signals=None),
        count=500,
        prior=yaw,
        null=lambda: Fit((), (), bent, 100.0),
        nuisances_within_prior=lambda fit: False,
    )
    after = nuisances_at_prior(problem, problem.null(), curves=True).nuisances
    assert after[0] == (bent[0] if kept[0] else 0.0)
    assert after[1:].tolist() == (bent[1:] if kept[1] else 0.0 * bent[1:]).tolist()
    # What is left without any effect is left beside the attitude that explains it best.
    left = nuisances_at_prior(problem, problem.null()).nuisances
    assert left[1:].tolist() == bent[1:].tolist()


def _field_and_age() -> Prior:
    age = Prior.of(AGE, np.array([0.05]), np.array([usual.age.sigma_s]))
    return Prior.of(WORLD_FIELD, np.zeros(3), np.full(3, 5.0)).beside(age)


@pytest.mark.parametrize(("late", "stays"), [(2.0, True), (9.0, False)])
def test_how_old_readings_are_is_not_bent_back_with_the_rest(late: float, stays: bool) -> None:
    prior = _field_and_age()
    bent = np.array([40.0, 0.0, 0.0, 0.05 + usual.age.sigma_s * late])
    problem: Any = SimpleNamespace(
        replay=SimpleNamespace(signals=None),
        count=500,
        prior=prior,
        null=lambda: Fit((), (), bent, 100.0),
        nuisances_within_prior=lambda fit: False,
    )
    kept = nuisances_at_prior(problem, problem.null()).nuisances
    assert kept.tolist() == [0.0, 0.0, 0.0, bent[3] if stays else prior.mean[3]]


def test_a_search_of_few_effects_names_no_more_whatever_was_explored() -> None:
    problem: Any = SimpleNamespace(
        replay=SimpleNamespace(signals=None), count=500, mahalanobis2=lambda fit: 0.0
    )

    def fit(left: float, *ids: str) -> Fit:
        one = np.ones(1, dtype=np.bool_)
        terms = tuple(Term(registry.get(e), one, np.zeros(1), np.ones(1)) for e in ids)
        return Fit(terms, tuple(np.array([0.25]) for _ in terms), np.zeros(0), left)

    one = Search(problem, ())
    nothing, lag, both = fit(1000.0), fit(700.0, "transport_lag"), fit(300.0, "transport_lag", "low_pass")
    one.explored = {f.ids: f for f in (lag, both)}
    assert one._cheapest(nothing, 2) is both
    assert one._cheapest(nothing, 1) is lag
    assert one._cheapest(nothing, 0) is nothing


@pytest.mark.parametrize("beside", ["", "transport_lag:lag_s=0.1"])
def test_a_turn_that_leaves_nothing_is_found_without_a_second_look_at_others(
    beside: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    effects = [parse("orientation:orientation=10"), *([parse(beside)] if beside else [])]
    replayed = replay(make_track(Recipe("rich", duration_s=60.0, rate_hz=8.0, seed=6), effects))
    problem = Problem(replayed, CASE_NOISE, replayed.valid, replayed.prior)
    one = Search(
        problem, [registry.get(e) for e in ("orientation", "hard_iron", "soft_iron", "transport_lag")]
    )
    looks: list[tuple[frozenset[str], int]] = []
    rounds = one._rounds

    def counted(first: Fit, most: int, held: Any, best: Any = None, times: int = 4) -> Fit:
        looks.append((first.ids, times))
        return rounds(first, most, held, best, times)

    monkeypatch.setattr(one, "_rounds", counted)
    assert one.run().ids == {e.effect.id for e in effects}
    # A lag hides how well a turn does by itself: others are looked at to the end.
    assert [times for first, times in looks if not first] == [4 if beside else 1]


@pytest.mark.parametrize("beside", ["", "transport_lag:lag_s=0.3"])
@pytest.mark.parametrize("off_s", [0.3, -0.4])
def test_a_moment_of_change_is_found_to_the_reading(beside: str, off_s: float) -> None:
    """No derivative leads there, and beside a lag no first guess: readings tell it later than it was."""
    step = parse("hard_iron_step:x=9,y=-6,on_s=21.15")
    effects = [step, *([parse(beside)] if beside else [])]
    replayed = replay(make_track(Recipe("rich", duration_s=60.0, rate_hz=10.0, seed=6), effects))
    problem = Problem(replayed, CASE_NOISE, replayed.valid, replayed.prior)
    start = problem.null()
    for setting in effects:
        start = start.beside(make_term(setting.effect, replayed.signals), setting.theta)
    late = start.changed(0, start.terms[0], step.theta + off_s * np.eye(5)[3])
    assert Search(problem, ()).polished(late).thetas[0][3] == pytest.approx(21.15, abs=0.051)


def test_nuisances_alone_begin_where_another_problem_has_them_as_far_as_it_does() -> None:
    """A second pass may have found that places wander, of which the first knew nothing."""

    def begun(near: Fit | None) -> list[float]:
        fit = lambda start: start  # noqa: E731
        problem: Any = SimpleNamespace(_null=None, prior=_field_and_age(), fit=fit)
        return Problem.null(problem, near).nuisances.tolist()

    assert begun(None) == [0.0, 0.0, 0.0, 0.05]
    assert begun(Fit(nuisances=np.array([1.0, 2.0, 3.0]))) == [1.0, 2.0, 3.0, 0.05]
    assert begun(Fit(nuisances=np.array([1.0, 2.0, 3.0, 0.1]))) == [1.0, 2.0, 3.0, 0.1]
