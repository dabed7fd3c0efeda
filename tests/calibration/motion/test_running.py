"""A running calibration: of the last minutes, believed only where its halves agree, and not led astray."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from calibration_worlds import FIELD, heading_errors, iron_of, rms, turning_track

from mavcompass.calibration import calibrate_track
from mavcompass.calibration.methods import running
from mavcompass.calibration.methods.running import calibrate
from mavcompass.calibration.recorded import Recorded
from mavcompass.correction import FieldCorrection
from mavcompass.track import Series, Track

STRONG = FieldCorrection((60.0, -40.0, 25.0), (1.08, 0.93, 1.0), (0.02, 0.0, 0.0))
ROUND = tuple(70.0 if k % 2 else 50.0 for k in range(18))


def driven(**changes: object) -> Track:
    return turning_track(iron_of(STRONG), dwell_s=2.0, turn_s=2.5, turns_deg=ROUND, **changes)  # type: ignore[arg-type]


def disturbed(track: Track, start_s: float, end_s: float, by: tuple[float, float, float]) -> Track:
    compass = track.compasses[1]
    inside = (compass.time_s >= start_s) & (compass.time_s < end_s)
    values = compass.reported.values + inside[:, np.newaxis] * np.asarray(by)
    return replace(track, compasses={1: replace(compass, reported=Series.of(compass.time_s, values))})


def test_a_recording_is_calibrated_as_it_runs() -> None:
    learnt = calibrate(Recorded(driven(), earth=FIELD))
    assert learnt.accepted, learnt.reasons
    assert learnt.changed is None and learnt.not_seen_deg == ()
    error = rms(heading_errors(learnt.correction, iron_of(STRONG)))
    assert error < 0.3
    assert error < 3.0 * learnt.heading_sigma_deg
    assert learnt.sure_gain_deg == pytest.approx(learnt.heading_change_deg, abs=1.0)


def test_a_gyro_that_drifts_and_never_stands_neither_bends_the_result_nor_lets_it_be_doubted() -> None:
    turns = tuple(70.0 if k % 3 else -50.0 for k in range(24))
    track = turning_track(iron_of(STRONG), dwell_s=0.1, turn_s=20.0, turns_deg=turns)
    gyro = track.gyro_radps
    assert gyro is not None
    to_and_fro = 0.12 * (1.0 - np.abs(2.0 * gyro.time_s / gyro.time_s[-1] - 1.0))  # in eight minutes
    drifting = gyro.values + np.radians(np.outer(to_and_fro, (0.0, 0.0, 1.0)))
    result = calibrate(Recorded(replace(track, gyro_radps=Series.of(gyro.time_s, drifting)), earth=FIELD))
    assert result.accepted and result.heading_sigma_deg < 0.3
    assert rms(heading_errors(result.correction, iron_of(STRONG))) < 0.1


def test_what_passes_is_left_out() -> None:
    result = calibrate_track(disturbed(driven(), 60.0, 63.0, (90.0, -70.0, 40.0)), "running", earth=FIELD)
    assert rms(heading_errors(result.correction, iron_of(STRONG))) < 0.4


def test_iron_that_changed_is_forgotten_and_dated() -> None:
    """A battery moved at 30 s: what was learnt before it is not believed after."""
    learnt = calibrate(Recorded(disturbed(driven(), 0.0, 30.0, (60.0, 50.0, 0.0)), earth=FIELD))
    assert learnt.changed is not None and 29.0 < learnt.changed.time_s < 37.0
    error = rms(heading_errors(learnt.correction, iron_of(STRONG)))
    assert error < 3.0 * learnt.heading_sigma_deg


def test_only_the_last_minutes_are_kept(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(running, "WINDOW_S", 40.0)
    track = disturbed(driven(), 0.0, 30.0, (60.0, 50.0, 0.0))
    result = calibrate_track(track, "running", earth=FIELD)
    assert not any("iron changed" in words for words in result.warnings)
    assert rms(heading_errors(result.correction, iron_of(STRONG))) < 0.4


def test_a_way_whose_halves_cannot_be_held_against_each_other_is_not_believed() -> None:
    track = turning_track(iron_of(STRONG), dwell_s=2.0, turn_s=2.5, turns_deg=(50.0,) * 5)
    learnt = calibrate(Recorded(track, earth=FIELD))
    assert not learnt.accepted and learnt.sure_gain_deg == 0.0
    assert any("go round often enough" in reason for reason in learnt.reasons)


def test_what_was_not_seen_is_told() -> None:
    track = turning_track(iron_of(STRONG), dwell_s=2.0, turn_s=2.5, turns_deg=(60.0, 60.0, 60.0))
    result = calibrate_track(track, "running", earth=FIELD)
    assert 4 <= len(result.not_seen_deg) <= 6
    assert any(words.startswith("Not seen yet: headings ") for words in result.warnings)
