"""The rehearsal: exact without errors, its budget and remedies where the cause is known, told plainly."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from click.testing import CliRunner

from mavcompass.cli.gap import command
from mavcompass.errors import UsageError
from mavcompass.gap import diagnose_gap
from mavcompass.gap.rehearsal import Rehearsal, read_stored, rehearse
from mavcompass.gap.rehearsal.draws import SOURCES, Draws
from mavcompass.gap.rehearsal.kind import Kind, kind_of
from mavcompass.gap.rehearsal.procedure import calibrate, heading_errors_deg
from mavcompass.gap.rehearsal.rehearse import Run
from mavcompass.gap.result import Diagnosis
from mavcompass.gap.trial.cases import Recipe, make_track
from mavcompass.logs import read_track, write_track_csv
from mavcompass.report.gap import is_worth_it, rehearsal_summary, write_rehearsal_report
from mavcompass.track import Series, Track

MOTOR_MGAUSS_PER_A = np.array([1.6, -1.0, 0.5])


@pytest.fixture(scope="module")
def loaded() -> Track:
    """A vehicle that turns in steps, whose current swings, with the current's field in its compass."""
    track = make_track(Recipe("yaw-steps", duration_s=60.0, rate_hz=10.0, seed=3))
    mag = track.compasses[1].reported
    current_a = 12.0 + 3.0 * np.sin(2.0 * np.pi * mag.time_s / 23.0)
    bent = replace(mag, values=mag.values + current_a[:, np.newaxis] * MOTOR_MGAUSS_PER_A)
    return replace(
        track,
        compasses={1: replace(track.compasses[1], reported=bent)},
        current_a=Series.of(mag.time_s, current_a),
    )


@pytest.fixture(scope="module")
def diagnosis(loaded: Track) -> Diagnosis:
    return diagnose_gap(loaded)


@pytest.fixture(scope="module")
def kind(loaded: Track, diagnosis: Diagnosis) -> Kind:
    return kind_of(loaded, diagnosis)


@pytest.fixture(scope="module")
def rehearsal(loaded: Track, diagnosis: Diagnosis) -> Rehearsal:
    return rehearse(loaded, diagnosis, draws=20)


def test_a_belief_holds_the_parameters_where_the_diagnosis_has_them(diagnosis: Diagnosis) -> None:
    (belief,) = diagnosis.beliefs
    (cause,) = diagnosis.causes
    assert belief.effects == ("motor_current",) and belief.places == (18,)
    assert belief.mean[18:].tolist() == [cause.parameters[axis] for axis in "xyz"]
    sigma = np.sqrt(np.diag(belief.covariance)[18:])
    assert cause.parameters["x"] + 1.96 * sigma[0] == pytest.approx(cause.ci95["x"][1])


def test_without_any_error_the_calibration_is_exact(kind: Kind) -> None:
    nothing = {*SOURCES, "motor_current"}
    draws = Draws(kind, seed=5)
    for number in range(3):
        drawn = draws[number].without(nothing, kind)
        vehicle = replace(drawn, iron=replace(drawn.iron, matrix=np.diag([1.04, 0.95, 1.0])))
        fit = calibrate(kind, vehicle)
        level, tilted = heading_errors_deg(kind, vehicle, fit.correction)
        assert level < 0.03 and level <= tilted
        assert np.allclose(fit.raw_offset_mgauss[:2], vehicle.iron.offset_mgauss[:2], atol=0.2)


def test_the_same_seed_draws_the_same_vehicles(kind: Kind) -> None:
    first, again, other = Draws(kind, 1)[4], Draws(kind, 1)[4], Draws(kind, 2)[4]
    assert np.array_equal(first.chances["noise"], again.chances["noise"]) and np.array_equal(
        first.iron.matrix, again.iron.matrix
    )
    assert not np.array_equal(first.chances["noise"], other.chances["noise"])


def test_draws_have_the_posterior_spread(kind: Kind) -> None:
    draws = Draws(kind, 1)
    (belief,) = kind.beliefs
    motors = np.array([draws[number].settings[0].theta for number in range(400)])
    sigma = np.sqrt(np.diag(belief.covariance)[18:])
    assert motors.std(axis=0) == pytest.approx(sigma, rel=0.15)
    assert motors.mean(axis=0) == pytest.approx(belief.mean[18:], abs=0.3 * float(sigma.max()))


def test_an_effect_that_no_calibration_cures_dominates_and_its_compensation_helps(
    rehearsal: Rehearsal,
) -> None:
    assert rehearsal.dominant is not None and rehearsal.dominant.name == "motor_current"
    assert rehearsal.dominant.share > 0.8
    best = rehearsal.remedies[0]
    assert "compensation" in best.what and best.change < 0.5 and is_worth_it(best)
    without = rehearsal.dominant.without.level.rms
    assert best.heading_error_deg.level.rms == pytest.approx(without, rel=0.5)
    assert {part.name for part in rehearsal.parts} == {*SOURCES, "motor_current"}


def test_it_is_told_in_words_as_json_and_as_a_page(rehearsal: Rehearsal, tmp_path: Path) -> None:
    first, *rest = rehearsal_summary(rehearsal)
    assert first.startswith("Expect ") and "leaning by 15 deg" in first
    assert any("motor_current (the field of the battery current)" in line for line in rest)
    assert any(line.startswith("  lower with the motor compensation") for line in rest)
    document = json.loads(json.dumps(rehearsal.to_json()))
    low, high = document["heading_error_deg"]["level"]["interval95"]
    assert low == 0.0 < document["heading_error_deg"]["level"]["median"] < high
    assert f"(95 of 100 below {high:.2f})" in first
    page = tmp_path / "r.html"
    write_rehearsal_report(rehearsal, page)
    text = page.read_text(encoding="utf-8")
    assert "motor_current" in text
    for remedy in rehearsal.remedies:
        assert f"<td>{100.0 * remedy.change:.0f}</td>" in text


def test_it_is_deterministic(loaded: Track, diagnosis: Diagnosis) -> None:
    one, other = (rehearse(loaded, diagnosis, draws=2) for _ in range(2))
    assert replace(other, seconds=one.seconds) == one


def test_a_stored_diagnosis_is_rehearsed_like_the_one_just_made(loaded: Track, tmp_path: Path) -> None:
    log, stored = tmp_path / "log.csv", tmp_path / "gap.json"
    write_track_csv(loaded, log)
    track = read_track(log)
    fresh = diagnose_gap(track)
    stored.write_text(json.dumps(fresh.to_json()))
    read = read_stored(stored)
    assert read.recording == log
    assert rehearse(track, read, draws=2).parts == rehearse(track, fresh, draws=2).parts
    out = tmp_path / "out.json"
    run = CliRunner().invoke(command, ["rehearse", str(stored), "--draws", "20", "--json", str(out)])
    assert run.exit_code == 0 and "motor_current" in run.output
    document = json.loads(out.read_text())
    assert document["schema"] == "mavcompass.gap-rehearsal/1" and document["draws"] == 20

    log.write_text(log.read_text() + "\n")
    with pytest.raises(UsageError, match="not the recording"):
        read_stored(stored)
    log.unlink()
    with pytest.raises(UsageError, match="not there"):
        read_stored(stored)
    stored.write_text(json.dumps({"schema": "mavcompass.gap/1", "log": {}}))
    with pytest.raises(UsageError, match="no diagnosis"):
        read_stored(stored)


def test_the_bound_holds_its_share_of_those_that_could_be_calibrated() -> None:
    errors = np.random.default_rng(2).gamma(2.0, 0.05, size=(4000, 2))
    errors[::3] = np.nan
    run = Run(np.column_stack([errors, errors[:, 0], np.full(4000, 4.0)]))
    for column, expected in zip(errors.T, (run.errors.level, run.errors.tilt_15), strict=True):
        calibrated = column[np.isfinite(column)]
        assert (calibrated <= expected.interval95[1]).mean() == pytest.approx(0.95, abs=0.001)
        assert expected.interval95[1] in calibrated


def test_without_a_gyro_it_says_what_to_record(loaded: Track, tmp_path: Path) -> None:
    log = tmp_path / "log.csv"
    write_track_csv(replace(loaded, gyro_radps=None), log)
    run = CliRunner().invoke(command, ["rehearse", str(log), "--draws", "20"])
    assert run.exit_code != 0 and "gyro" in str(run.exception)
