"""The population of a fleet: what the vehicles have in common, and which is not like the others."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

from mavcompass.fleet.examine import Row
from mavcompass.fleet.population import learn, write_distribution
from mavcompass.fleet.population.estimates import pool
from mavcompass.fleet.summary import summarise
from mavcompass.simulation.effects.registry import distortion

OFFSET, GAIN, MOTOR = np.array([120.0, -60.0, 30.0]), np.array([1.03, 0.97, 1.0, 0.0, 0.0, 0.0]), np.zeros(3)
SPREAD = np.array([15.0, 15.0, 15.0, 0.02, 0.02, 0.02, 0.005, 0.005, 0.005, 0.1, 0.1, 0.1])
KNOWN = np.array([2.0, 2.0, 3.0, 0.003, 0.003, 0.003, 0.002, 0.002, 0.002, 0.03, 0.03, 0.03])


def row(name: str, rng: np.random.Generator, alike: float = 1.0, **changed: object) -> Row:
    """Make the row of a vehicle of the fleet, known with an error."""
    iron = np.concatenate([OFFSET, GAIN, np.array([0.5, -0.3, 0.1])])
    iron = iron + alike * (SPREAD * rng.standard_normal(12) + KNOWN * rng.standard_normal(12))
    iron = iron + np.asarray(changed.get("iron", np.zeros(12)))
    causes, known = changed.get("causes", []), np.diag((alike * KNOWN) ** 2)
    return {
        "recording": f"{name}.BIN",
        "status": "ok",
        "vehicle": name,
        "compass": 1,
        "verdict": "named" if causes else "no_gap",
        "iron_json": json.dumps({"values": iron.tolist(), "covariance": known.tolist()}),
        "causes_json": json.dumps(causes),
        "scatter_mgauss": changed.get("scatter", 2.5 * np.exp(0.1 * rng.standard_normal())),
        "field_gap_mgauss": changed.get("gap", 3.0 * np.exp(0.3 * rng.standard_normal())),
        "heading_gap_deg": 1.0,
    }


def fleet(count: int, seed: int) -> list[Row]:
    rng = np.random.default_rng(seed)
    return [row(f"v{number}", rng) for number in range(count)]


def lag(value: float) -> dict[str, object]:
    return {
        "effect": "transport_lag",
        "parameters": {"lag_s": value},
        "ci95": {"lag_s": [value - 0.01, value + 0.01]},
    }


def test_location_and_spread_are_those_between_the_vehicles() -> None:
    rng = np.random.default_rng(7)
    known = rng.uniform(0.5, 3.0, 1500)  # how well each is known
    values = 5.0 + 2.0 * rng.standard_normal(1500) + known * rng.standard_normal(1500)
    found = pool(values[:, np.newaxis], known[:, np.newaxis, np.newaxis] ** 2)
    assert found.location[0] == pytest.approx(5.0, abs=0.15)
    assert np.sqrt(found.spread[0, 0]) == pytest.approx(2.0, rel=0.15)


def test_a_tenth_of_gross_outliers_hardly_moves_them() -> None:
    rng = np.random.default_rng(8)
    values = np.concatenate([rng.standard_normal((180, 3)), 40.0 + rng.standard_normal((20, 3))])
    found = pool(values, np.tile(0.01 * np.eye(3), (200, 1, 1)))
    assert np.abs(found.location).max() < 0.4
    assert np.sqrt(np.diag(found.spread)) == pytest.approx(np.ones(3), rel=0.3)
    assert found.distance2[180:].min() > 9.0 * found.distance2[:180].max()


def test_the_odd_ones_are_named_for_what_is_odd_about_them() -> None:
    rng = np.random.default_rng(9)
    iron = np.zeros(12)
    iron[:2] = 90.0, -90.0
    motor = np.zeros(12)
    motor[9:] = 1.5, -1.0, 0.0
    rows = fleet(60, 3)
    rows += [row("iron", rng, iron=iron), row("motor", rng, iron=motor), row("noise", rng, scatter=11.0)]
    rows += [row("loose", rng, gap=30.0), row("quiet", rng, gap=0.2, scatter=0.4)]
    odd = {(one.vehicle, one.quantity) for one in learn(rows).odd}
    assert odd == {
        ("iron", "hard_iron"),
        ("motor", "motor_current"),
        ("noise", "scatter_mgauss"),
        ("loose", "field_gap_mgauss"),
    }
    summary = summarise(rows, "diagnose")
    whys = {vehicle.name: " ".join(vehicle.why) for vehicle in summary.look_first}
    assert "not like the others: hard iron of (" in whys["iron"] and "usually (1" in whys["iron"]
    assert "scatter of the readings of 11.0 mG" in whys["noise"]


def test_a_sure_difference_that_moves_no_heading_is_not_odd() -> None:
    rng = np.random.default_rng(10)
    rows = [row(f"v{number}", rng, alike=0.1) for number in range(60)]
    for name, per_ampere in (("hardly", 0.2), ("much", 0.5)):
        motor = np.zeros(12)
        motor[9] = per_ampere
        rows.append(row(name, rng, iron=motor, alike=0.1))
    assert [one.vehicle for one in learn(rows).odd] == ["much"]


def test_a_fleet_without_odd_ones_seldom_has_one_named() -> None:
    """One in twenty is what is claimed; the chance of more than three of twenty is then 2 %."""
    assert sum(bool(learn(fleet(40, seed)).odd) for seed in range(100, 120)) <= 3


def test_effects_have_their_prevalence_and_their_spread() -> None:
    rng = np.random.default_rng(11)
    rows = fleet(40, 5)
    rows += [row(f"late{i}", rng, causes=[lag(0.15 + 0.02 * rng.standard_normal())]) for i in range(10)]
    (spread,) = learn(rows).effects
    assert (spread.effect, spread.vehicles, spread.names) == ("transport_lag", 10, ("lag_s",))
    middle, low, high = spread.prevalence
    assert low < 0.2 < high and middle == pytest.approx(0.2, abs=0.02)
    assert spread.location[0] == pytest.approx(0.15, abs=0.02)


def test_presets_are_vehicles_of_the_fleet_for_our_simulator(tmp_path: Path) -> None:
    learnt = learn(fleet(60, 6))
    rng = np.random.default_rng(1)
    drawn = [distortion(learnt.preset(rng)).settings for _ in range(300)]
    irons = np.array([next(s for s in settings if s.effect.id == "hard_iron").theta for settings in drawn])
    assert np.median(irons, axis=0) == pytest.approx(OFFSET, abs=6.0)
    file = tmp_path / "d.json"
    first, *presets = write_distribution(learnt, file, presets=3)
    assert first == file and len(presets) == 3
    assert distortion([f"@{presets[0]}"]).settings


def test_too_few_vehicles_have_no_odd_one() -> None:
    rng = np.random.default_rng(12)
    assert learn([*fleet(8, 1), row("far", rng, gap=300.0)]).odd == ()
    assert learn([]).vehicles == 0
