"""How much a set of effects is worth beside another one: on sets without any data."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from mavcompass.gap.fit import Fit, Search, Term
from mavcompass.gap.replay.nuisance import AGE, WORLD_FIELD, Nuisance, reference_attitude_error
from mavcompass.simulation.effects import registry

LAG = registry.get("transport_lag")


def search(contradiction: float, monkeypatch: pytest.MonkeyPatch) -> Search:
    """Return a search of which each fit's one number is what it strains; blocks contradict each other."""
    problem: Any = SimpleNamespace(
        replay=SimpleNamespace(signals=None), count=500, strain=lambda fit: float(fit.nuisance_thetas[0][0])
    )
    found = Search(problem, (), exact=False)
    found._temper = contradiction
    monkeypatch.setattr(found, "contradiction", lambda smaller, larger: contradiction)
    return found


def fit(left: float, strain: float, *effects: Any) -> Fit:
    """Return a fit that leaves so much of the readings, and bends what is known by so much."""
    one = np.ones(1, dtype=np.bool_)
    terms = tuple(Term(e, one, np.zeros(1), np.ones(1)) for e in effects)
    return Fit(terms, tuple(np.array([0.25]) for _ in terms), (np.array([strain]),), left + strain)


@pytest.mark.parametrize("contradiction", [1.0, 5.0, 84.0])
def test_what_is_known_keeps_its_weight_however_blocks_contradict_each_other(
    contradiction: float, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Real errors last for seconds: they weaken what readings say, not what was measured of the vehicle."""
    one = search(contradiction, monkeypatch)
    bent, straight = fit(7444.0, 1188.0), fit(7418.0, 32.0, LAG)
    assert one.grows(bent, straight)
    assert one.score(bent) - one.score(straight) > 1000.0
    assert one.score(bent) == pytest.approx(7444.0 / contradiction + 1188.0)


def test_what_readings_gain_is_held_against_how_blocks_contradict_each_other(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    nothing, lag = fit(1000.0, 3.0), fit(900.0, 3.0, LAG)
    assert search(1.0, monkeypatch).grows(nothing, lag)
    assert not search(20.0, monkeypatch).grows(nothing, lag)
    assert not search(1.0, monkeypatch).grows(nothing, fit(995.0, 3.0, LAG))


def test_what_bends_the_known_to_fit_readings_closer_is_not_needed(monkeypatch: pytest.MonkeyPatch) -> None:
    nothing, bent = fit(1000.0, 3.0), fit(800.0, 60.0, LAG)
    assert search(1.0, monkeypatch).grows(nothing, bent)
    assert not search(4.0, monkeypatch).grows(nothing, bent)


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
    yaw = Nuisance.of(reference_attitude_error(np.zeros((3, 3, 4))), np.zeros(5), sigma)
    bent = sigma * np.array([constant, *[curves] * 4])
    problem: Any = SimpleNamespace(
        replay=SimpleNamespace(signals=None),
        count=500,
        nuisances=(yaw,),
        null=lambda: Fit((), (), (bent,), 100.0),
        straight=lambda fit: False,
    )
    one = Search(problem, ())
    (after,) = one._unbent(problem.null(), curves=True).nuisance_thetas
    assert after[0] == (bent[0] if kept[0] else 0.0)
    assert after[1:].tolist() == (bent[1:] if kept[1] else 0.0 * bent[1:]).tolist()
    # What is left without any effect is left beside the attitude that explains it best.
    (left,) = one.nothing().null.nuisance_thetas
    assert left[1:].tolist() == bent[1:].tolist()


@pytest.mark.parametrize(("late", "stays"), [(2.0, True), (9.0, False)])
def test_how_old_readings_are_is_not_bent_back_with_the_rest(late: float, stays: bool) -> None:
    field = Nuisance.of(WORLD_FIELD, np.zeros(3), np.full(3, 5.0))
    age = Nuisance.of(AGE, np.array([0.05]), np.array([0.01]))
    bent = (np.array([40.0, 0.0, 0.0]), np.array([0.05 + 0.01 * late]))
    problem: Any = SimpleNamespace(
        replay=SimpleNamespace(signals=None),
        count=500,
        nuisances=(field, age),
        null=lambda: Fit((), (), bent, 100.0),
        straight=lambda fit: False,
    )
    kept = Search(problem, ()).nothing().null.nuisance_thetas
    assert kept[0].tolist() == [0.0, 0.0, 0.0]
    assert kept[1].tolist() == (bent[1] if stays else age.mean).tolist()


# --- what the age of telemetry hides -------------------------------------------------------------------


def aged(bent_s: float, fitted: list[tuple[str, list[float], float]]) -> Search:
    """Return a search whose null has an age of telemetry that is bent; its fits are written down."""
    age = Nuisance.of(AGE, np.array([0.05]), np.array([0.01]))
    signals: Any = SimpleNamespace()

    def fit(terms: Any, thetas: Any, known: Any, iterations: int) -> Fit:
        fitted.append((terms[0].effect.id, [round(float(x), 6) for x in thetas[0]], float(known[0][0])))
        return Fit(tuple(terms), tuple(thetas), tuple(known), 50.0)

    problem: Any = SimpleNamespace(
        replay=SimpleNamespace(signals=signals),
        count=500,
        nuisances=(age,),
        null=lambda: Fit((), (), (np.array([0.05 + bent_s]),), 100.0),
        straight=lambda fit: True,
        fit=fit,
    )
    found = Search(problem, ())
    effects = [registry.get(name) for name in ("transport_lag", "low_pass", "eddy_current", "hard_iron")]
    found.terms = [
        Term(
            e,
            np.ones(len(e.parameters), dtype=np.bool_),
            *np.array([(p.low, p.high) for p in e.parameters]).T,
        )
        for e in effects
    ]
    return found


def test_what_makes_readings_late_is_fitted_from_their_known_age() -> None:
    fitted: list[tuple[str, list[float], float]] = []
    search = aged(0.08, fitted)
    assert len(search._late(search._null())) == 3
    assert fitted == [
        ("transport_lag", [0.08], 0.05),
        ("low_pass", [0.08], 0.05),
        # A loop of metal in all three axes alike, and nothing between them.
        ("eddy_current", [0.08, 0.08, 0.08, 0.0, 0.0, 0.0], 0.05),
    ]


@pytest.mark.parametrize("bent_s", [0.002, -0.08])
def test_an_age_as_it_is_known_hides_nothing(bent_s: float) -> None:
    fitted: list[tuple[str, list[float], float]] = []
    search = aged(bent_s, fitted)
    assert search._late(search._null()) == [] and fitted == []


def test_a_moment_moves_with_what_makes_readings_late() -> None:
    """A step that is seen at 30 s under a loop of metal was 0.08 s earlier, if readings are late instead."""
    fitted: list[tuple[str, list[float], float]] = []
    search = aged(0.0, fitted)
    lag, _, eddy, _ = search.terms
    step = registry.get("hard_iron_step")
    term = Term(step, np.ones(5, dtype=np.bool_), np.full(5, -1e7), np.full(5, 1e7))
    theta = np.array([9.0, 0.0, 0.0, 30.0, 1e7])
    seen = Fit((eddy, term), (np.array([0.07, 0.08, 0.09, 0, 0, 0.0]), theta), (np.array([0.05]),), 100.0)
    moments: list[list[float]] = []

    def fit(terms: Any, thetas: Any, known: Any, iterations: int = 12) -> Fit:
        moments.append([terms[1].effect.id == "transport_lag", *thetas[0][3:], thetas[1][0]])
        return Fit(tuple(terms), tuple(thetas), tuple(known), 40.0 if terms[1].effect is lag.effect else 90.0)

    search.problem.fit = fit  # type: ignore[method-assign]
    search.problem.refit = lambda fit: fit  # type: ignore[method-assign]
    search.problem.strain = lambda fit: 0.0  # type: ignore[method-assign]
    assert search._otherwise_late(seen).ids == {"hard_iron_step", "transport_lag"}
    assert moments[0] == [True, pytest.approx(29.92), 1e7, pytest.approx(0.08)]
    assert moments[1] == [False, 30.0, 1e7, pytest.approx(0.08)]
    assert search._otherwise_late(seen.without(0)).ids == {"hard_iron_step"}
