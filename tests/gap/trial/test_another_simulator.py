"""Another simulator: it shares nothing with this one, its formulas agree with each other, it is scored."""

from __future__ import annotations

import ast
from pathlib import Path

import numpy as np
import pytest

import mavcompass.gap.trial.closed_form as closed_form
from mavcompass.gap import diagnose_gap
from mavcompass.gap.trial.cases import SHARES, case_of
from mavcompass.gap.trial.closed_form import PLACES, make, quaternion, rotation_of, wave
from mavcompass.gap.trial.trial import run_trial
from mavcompass.logs.formats.csv.reader import KNOWN
from mavcompass.simulation.effects import parse

STEP_S = 1e-4


def test_it_imports_nothing_but_numpy() -> None:
    imported = set()
    for node in ast.walk(ast.parse(Path(closed_form.__file__).read_text(encoding="utf-8"))):
        if isinstance(node, ast.Import):
            imported |= {alias.name for alias in node.names}
        elif isinstance(node, ast.ImportFrom):
            assert node.level == 0
            imported.add(node.module or "")
    assert imported == {"__future__", "collections.abc", "dataclasses", "numpy", "numpy.typing"}


def test_its_columns_are_those_of_the_contract() -> None:
    for seed in range(6):
        columns = make(seed, 0).flight.columns
        assert columns.keys() <= KNOWN


def test_a_wave_s_derivatives_are_those_of_its_values() -> None:
    rng = np.random.default_rng(1)
    one, t = wave(rng, 0.7, 3.0, 9.0, offset=2.0, rate=0.1), np.linspace(0.0, 20.0, 9)
    for order in (1, 2):
        slope = (one.at(t + STEP_S, order - 1) - one.at(t - STEP_S, order - 1)) / (2.0 * STEP_S)
        assert one.at(t, order) == pytest.approx(slope, abs=1e-6)


def test_gyro_accelerometer_and_attitude_are_of_one_motion() -> None:
    """Without noise: the rate turns the rotation, the force is what moves the place against gravity."""
    rng = np.random.default_rng(2)
    roll, pitch, yaw = rng.uniform(-1.0, 1.0, (3, 5))
    q = np.stack(quaternion(np.stack([roll, pitch, yaw], axis=1)), axis=1)
    w, x, y, z = q.T
    again = np.stack([1 - 2 * (y * y + z * z), 2 * (x * y + w * z), 2 * (x * z - w * y)], axis=1)
    assert rotation_of(roll, pitch, yaw)[:, :, 0] == pytest.approx(again)
    flight = make(3, 0).flight
    t, columns = flight.time_s, flight.columns
    rotation = rotation_of(*flight.angles_rad.T)
    gyro = np.stack([columns[f"gyro_{axis}_radps"] for axis in "xyz"], axis=1)
    acc = np.stack([columns[f"acc_{axis}_mps2"] for axis in "xyz"], axis=1)
    turned = np.swapaxes(rotation[:-2], 1, 2) @ rotation[2:] / (t[2] - t[0])
    rate = np.stack([turned[:, 2, 1], turned[:, 0, 2], turned[:, 1, 0]], axis=1)
    assert np.abs((gyro[1:-1] - rate).mean(axis=0)).max() < 0.01
    assert np.std(gyro[1:-1] - rate) < 0.01
    felt = np.einsum("nij,nj->ni", rotation, acc)
    pushed = np.gradient(flight.velocity_mps, t, axis=0)
    assert np.corrcoef(felt[:, 0], np.convolve(pushed[:, 0], np.ones(9) / 9, "same"))[0, 1] > 0.5


def test_the_field_it_makes_is_the_place_s_through_its_compass() -> None:
    made = make(5, 0).flight
    assert np.array_equal(made.raw_mgauss, made.plain_mgauss)
    length = np.linalg.norm(made.plain_mgauss - made.plain_mgauss.mean(axis=0), axis=1).max()
    fields = {place: np.linalg.norm(field) for place, field in PLACES}
    assert 0.0 < length < 2.2 * fields[made.place]


@pytest.mark.parametrize("seed", range(4))
def test_its_effects_have_the_catalogue_s_names_and_units(seed: int) -> None:
    for name, values in make(seed, 2).effects:
        assert parse(f"{name}:" + ",".join(f"{k}={v}" for k, v in values.items())).effect.id == name


def test_the_diagnosis_finds_in_it_what_was_put_in() -> None:
    case = case_of("another", "single", 10)
    assert case.effects[0][0] == "hard_iron_step" and case.track.reference_q is None
    diagnosis = diagnose_gap(case.track, case.baseline)
    assert diagnosis.effects == {"hard_iron_step"} and diagnosis.field.after < 0.8 * diagnosis.field.nominal


def test_it_is_sealed_and_scored_by_the_same_table() -> None:
    assert set(SHARES["another"]) == {"none", "single", "pair"}
    trial = run_trial(1, 2, "none", generator="another")
    (case,) = trial.cases
    assert case.label.generator == "another" and trial.to_json()["generator"] == "another"
    assert trial.figures()["no effect: named or unknown"] == (0, 1)
