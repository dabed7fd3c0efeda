"""The parts of the diagnosis, each against a closed form or a property."""

from __future__ import annotations

import json
import math
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from mavcompass.cli.main import main
from mavcompass.frames import euler_to_matrix, rotate_back
from mavcompass.gap import diagnose_gap
from mavcompass.gap.attitude.reference import body_rate, reference_attitude
from mavcompass.gap.fit.chance import CHANCE, least_gain
from mavcompass.gap.left.adequacy import ALPHA, _line, _recurring, _sweep
from mavcompass.gap.replay.noise import estimate_noise, rough_sigma, white
from mavcompass.gap.selection.split import probe, split_blocks, with_windows
from mavcompass.gap.trial.bench import draw_label
from mavcompass.gap.trial.cases import Recipe, make_track, stimulus_of
from mavcompass.gap.trial.score import wilson
from mavcompass.gap.trial.sealed import seal
from mavcompass.gap.trial.stored import read_case, write_case
from mavcompass.gap.trial.vehicles import make_case
from mavcompass.logs import write_track_csv
from mavcompass.simulation import effects
from mavcompass.track import Series, Track


def test_rate_of_a_steady_turn_is_exact() -> None:
    t = np.arange(200) * 0.05
    rate = body_rate(t, euler_to_matrix(0.0, 0.0, 0.8 * t))
    np.testing.assert_allclose(rate, np.tile([0.0, 0.0, 0.8], (200, 1)), atol=1e-9)


def test_rate_of_a_swing_is_right_to_fourth_order() -> None:
    t = np.arange(400) * 0.05
    angle, rate = 0.5 * np.sin(3.0 * t), 1.5 * np.cos(3.0 * t)
    found = body_rate(t, euler_to_matrix(angle, 0.0, 0.0))[:, 0]
    # The error of five points is h^4 w^4 / 30 of the amplitude.
    assert np.abs(found - rate)[4:-4].max() < 1.1 * 1.5 * (0.15**4) / 30.0


def test_correlated_noise_is_estimated_and_whitened() -> None:
    rng = np.random.default_rng(1)
    white_noise = rng.standard_normal((20_000, 3))
    error = np.empty_like(white_noise)
    error[0] = white_noise[0]
    for i in range(1, len(error)):
        error[i] = 0.6 * error[i - 1] + 2.0 * white_noise[i]
    noise = estimate_noise(error, np.ones(len(error), dtype=bool), 0.0)
    np.testing.assert_allclose(noise.coefficients[0], 0.6, atol=0.02)
    np.testing.assert_allclose(noise.sigma, 2.0, rtol=0.02)
    z = noise.whiten(error)[1:]
    assert abs(np.mean(z[1:] * z[:-1])) < 0.02 and abs(z.std() - 1.0) < 0.02


def test_scatter_is_seen_behind_a_slow_cause() -> None:
    rng = np.random.default_rng(2)
    t = np.arange(4000) * 0.05
    error = 50.0 * np.sin(0.3 * t)[:, None] + 2.0 * rng.standard_normal((4000, 3))
    np.testing.assert_allclose(rough_sigma(error, np.ones(4000, dtype=bool)), 2.0, rtol=0.1)
    assert white(np.full(3, 2.0)).whiten(error).std() > 10.0


@settings(max_examples=30, deadline=None)
@given(st.floats(20.0, 400.0), st.floats(5.0, 50.0))
def test_training_and_held_out_rows_never_touch(duration_s: float, rate_hz: float) -> None:
    t = np.arange(0.0, duration_s, 1.0 / rate_hz)
    split = split_blocks(t, np.ones(t.size, dtype=bool))
    assert not (split.train & split.test).any()
    guard = min(0.5, duration_s / 60.0) * 0.9
    distance = np.abs(t[split.train][:, None] - t[split.test][None, :: max(1, t.size // 200)])
    assert distance.min() > guard - 1.0 / rate_hz
    one, other = split.halves()
    assert not (one & other).any() and (one | other).sum() == split.train.sum()


def test_narrow_window_brings_a_change_between_training_rows() -> None:
    t = np.arange(0.0, 100.0, 0.05)
    valid = np.ones(t.size, dtype=bool)
    split = split_blocks(t, valid)
    moment = float(t[split.test][len(t[split.test]) // 2]) + 0.7
    narrowed = split
    for _ in range(6):
        middle = probe(narrowed, t, moment)
        if middle is None:
            break
        narrowed = with_windows(narrowed, t, valid, [middle])
    assert probe(narrowed, t, moment) is None and not (narrowed.train & narrowed.test).any()
    assert narrowed.test.sum() > 0.8 * split.test.sum()


def test_chance_of_one_more_effect_is_what_is_said() -> None:
    rng = np.random.default_rng(3)
    gains = rng.chisquare(3, 2_000_000)
    assert np.mean(gains > least_gain(3)) < 2.5 * CHANCE
    assert ALPHA <= 0.003


def test_gyro_reference_follows_a_tumbling_vehicle_without_its_compass() -> None:
    recipe = Recipe("rich", duration_s=60.0, seed=9)
    track = make_track(recipe)
    without = Track(
        compasses=track.compasses, acc_mps2=track.acc_mps2, gyro_radps=track.gyro_radps, place=track.place
    )
    t = track.compasses[1].time_s
    reference = reference_attitude(without, t)
    assert reference.kind == "fused" and reference.yaw_sigma_rad > 0.5
    truth = stimulus_of(recipe).rotation
    # Down in body axes is known; yaw but for a constant.
    tilt = np.degrees(np.arccos(np.clip(np.sum(reference.rotation[:, 2] * truth[:, 2], axis=1), -1, 1)))
    assert np.sqrt(np.mean(tilt**2)) < 0.5
    yaw = np.unwrap(np.arctan2(reference.rotation[:, 1, 0], reference.rotation[:, 0, 0]))
    true_yaw = np.unwrap(np.arctan2(truth[:, 1, 0], truth[:, 0, 0]))
    off = yaw - true_yaw
    assert np.degrees(np.std(off - np.polyval(np.polyfit(t, off, 1), t))) < 1.0


def test_sealed_cases_tell_nothing_of_their_labels(tmp_path: Path) -> None:
    digest = seal(tmp_path, 3, 5)
    assert (tmp_path / "seal").read_text().strip() == digest
    labels = json.loads((tmp_path / "labels.json").read_text())["labels"]
    track, baseline = read_case(tmp_path / "0001.npz")
    assert isinstance(track.acc_mps2, Series) and isinstance(baseline.gyro_radps, Series)
    with np.load(tmp_path / "0001.npz") as archive:
        assert not any("label" in name or "effect" in name for name in archive.files)
    again = draw_label(5, 1)
    assert list(again.effects) == labels[1]["effects"]


def test_stored_vehicle_is_the_same_and_tells_nothing_of_the_truth(tmp_path: Path) -> None:
    case = make_case(4, "single")
    write_case(tmp_path / "case.npz", case.track, case.baseline)
    track, _ = read_case(tmp_path / "case.npz")
    assert track.truth_q is None and case.track.truth_q is not None
    assert track.parameters == case.track.parameters and track.vehicle == case.track.vehicle
    assert track.compasses[1].in_force == case.track.compasses[1].in_force
    assert np.array_equal(track.raw_field(), case.track.raw_field())
    for name in ("attitude_rad", "gyro_radps", "place", "gps_velocity_mps", "motors"):
        one, other = getattr(track, name), getattr(case.track, name)
        assert (one is None) == (other is None)
        if one is not None:
            assert np.array_equal(one.time_s, other.time_s) and np.array_equal(one.values, other.values)
    with np.load(tmp_path / "case.npz") as archive:
        told = str(archive["rest"]) + " ".join(archive.files)
    assert not any(word in told for word in ("truth", "clean", *(name for name, _ in case.effects)))


def test_scatter_that_comes_again_is_seen_in_its_rhythm() -> None:
    rng = np.random.default_rng(9)
    n = 2000
    chance = [_recurring(rng.standard_normal(n), 0.05) for _ in range(200)]
    assert min(chance) > 1e-4 and np.mean(np.array(chance) < 0.1) < 0.16
    on = np.sin(2.0 * np.pi * np.arange(n) * 0.05 / 15.0) > 0.75
    louder = (rng.standard_normal((n, 3)) * np.sqrt(1.0 + 0.5 * on[:, None])) ** 2
    power = louder.mean(axis=1) - louder.mean()
    assert _recurring(power / power.std(), 0.05) < 1e-4


def test_line_that_sweeps_is_seen_where_no_line_stands() -> None:
    rng = np.random.default_rng(10)
    n = 1000
    chance = [_sweep(rng.standard_normal((n, 3))) for _ in range(60)]
    assert min(chance) > 1e-3 and np.mean(np.array(chance) < 0.1) < 0.2
    t = np.arange(n) * 0.05
    for rate in (0.02, 0.15):
        wave = np.sin(2.0 * np.pi * (0.1 + 0.5 * rate * t) * t)[:, None] * np.array([0.5, -0.3, 0.2])
        for swept in (wave, wave[::-1]):
            z = rng.standard_normal((n, 3)) + swept
            assert _sweep(z) < 1e-12
            assert _line(z) > 1e-5


@pytest.mark.parametrize("lasts_s", [0.0, 1.2])
def test_step_by_hand_keeps_its_size(lasts_s: float) -> None:
    """While a hand brings a magnet near, the field swings: what it does then is no part of the step."""
    fault = [effects.parse("hard_iron_step:x=60,y=-40,z=90,on_s=31.3")]
    track = make_track(Recipe("rich", duration_s=60.0, seed=31), fault)
    series = track.compasses[1].reported
    since = series.time_s - 31.3
    swing = np.where((since > 0.0) & (since < lasts_s), 150.0 * np.sin(4.0 * since), 0.0)
    moved = Series.of(series.time_s, series.values + swing[:, None] * np.array([1.0, 0.5, -0.7]))
    bent = replace(track, compasses={1: replace(track.compasses[1], reported=moved)})
    found = diagnose_gap(bent)
    step = next(c for c in found.causes if c.effect == "hard_iron_step")
    for name, true in (("x", 60.0), ("y", -40.0), ("z", 90.0)):
        assert step.parameters[name] == pytest.approx(true, abs=2.0)
    assert step.parameters["on_s"] == pytest.approx(31.3, abs=0.1 + lasts_s)


def test_interval_of_a_share_holds_it() -> None:
    low, high = wilson(8, 1100)
    assert math.isclose(low, 0.0037, abs_tol=3e-4) and math.isclose(high, 0.0143, abs_tol=3e-4)


def test_person_diagnoses_and_exports_a_csv(tmp_path: Path, capsys: object) -> None:
    log, good = tmp_path / "log.csv", tmp_path / "good.csv"
    recipe = Recipe("figure-8", duration_s=40.0, seed=31)
    write_track_csv(make_track(recipe, [effects.parse("hard_iron:x=50,y=-30,z=5")]), log)
    write_track_csv(make_track(Recipe("figure-8", duration_s=40.0, seed=32)), good)
    answer, report, parm = tmp_path / "gap.json", tmp_path / "gap.html", tmp_path / "found.parm"
    arguments = ["gap", "diagnose", str(log), "--baseline", str(good), "--json", str(answer)]
    assert main([*arguments, "--report", str(report)]) == 0
    document = json.loads(answer.read_text())
    assert [c["effect"] for c in document["causes"]] == ["hard_iron"]
    assert len(document["log"]["sha256"]) == 64
    html = report.read_text()
    assert "hard_iron" in html and "<svg" in html and "http" not in html.replace("http-equiv", "")
    export = ["gap", "export", str(log), "--baseline", str(good), "--to", "ardupilot-sitl", str(parm)]
    assert main(export) == 0
    values = dict(line.split(",") for line in parm.read_text().splitlines() if not line.startswith("#"))
    assert math.isclose(float(values["SIM_MAG1_OFS_X"]), -50.0, abs_tol=1.0)


def test_catalogue_is_machine_readable(tmp_path: Path) -> None:
    file = tmp_path / "catalogue.json"
    assert main(["gap", "catalogue", "--json", str(file)]) == 0
    listed = {e["id"] for e in json.loads(file.read_text())["effects"]}
    assert listed == set(effects.catalogue())


def test_field_of_a_replay_is_that_of_the_place() -> None:
    from mavcompass.gap.replay.nominal import replay

    track = make_track(Recipe("yaw-steps", duration_s=30.0, seed=3))
    replayed = replay(track)
    nominal = rotate_back(replayed.signals.stimulus.rotation, replayed.signals.stimulus.field_ned_mgauss)
    error = replayed.measured.mag_mgauss - nominal
    assert np.abs(error.mean(axis=0)).max() < 0.5 and 2.5 < error.std() < 3.5
