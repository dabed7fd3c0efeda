"""A running calibration: as good as the whole fit, of constant size, and not led astray."""

from __future__ import annotations

import numpy as np
import pytest
from calibration_worlds import FIELD, heading_errors, iron_of, rms, turning_track

from mavcompass.calibration import calibrate_track
from mavcompass.calibration.motion.observed import observe_motion
from mavcompass.calibration.motion.running import RunningFit, begin, begin_at, update
from mavcompass.calibration.recorded import Recorded
from mavcompass.correction import FieldCorrection
from mavcompass.errors import PoorCalibration
from mavcompass.track import Track

STRONG = FieldCorrection((60.0, -40.0, 25.0), (1.08, 0.93, 1.0), (0.02, 0.0, 0.0))
ROUND = tuple(70.0 if k % 2 else 50.0 for k in range(18))


def driven(**changes: object) -> Track:
    return turning_track(iron_of(STRONG), dwell_s=2.0, turn_s=2.5, turns_deg=ROUND, **changes)  # type: ignore[arg-type]


def run_through(track: Track, until: int | None = None) -> tuple[RunningFit, list[RunningFit]]:
    motion = observe_motion(Recorded(track, earth=FIELD))
    count = begin_at(motion.sections)
    assert count is not None
    first = motion.first(count)
    running = begin(first.sections, first.fit)
    history = [running]
    for k in range(count, len(motion.sections)):
        running = update(
            running, motion.sections.rows(k, k + 1), float(motion.sections.step_sigma_rad[k - 1])
        )
        history.append(running)
    return running, history


def disturbed(track: Track, start_s: float, end_s: float, by: tuple[float, float, float]) -> Track:
    from dataclasses import replace

    from mavcompass.track import Series

    compass = track.compasses[1]
    inside = (compass.time_s >= start_s) & (compass.time_s < end_s)
    values = compass.reported.values + inside[:, np.newaxis] * np.asarray(by)
    return replace(track, compasses={1: replace(compass, reported=Series.of(compass.time_s, values))})


def test_without_noise_it_stays_exact() -> None:
    running, _ = run_through(driven(noise=0.0, gyro_noise=0.0))
    matrix = np.linalg.inv(
        np.array(
            [
                [running.state[3], running.state[6], running.state[7]],
                [running.state[6], running.state[4], running.state[8]],
                [running.state[7], running.state[8], running.state[5]],
            ]
        )
    )
    correction = FieldCorrection.from_matrix(-running.state[:3], matrix)
    assert rms(heading_errors(correction, iron_of(STRONG))) < 0.05


def test_its_size_is_constant_and_its_sigma_falls() -> None:
    _, history = run_through(driven())
    assert {h.state.size for h in history} == {18}
    assert {h.covariance.shape for h in history} == {(18, 18)}
    assert history[-1].heading_error.rms_rad() < 0.8 * history[0].heading_error.rms_rad()
    assert len(history[-1].not_seen_deg) <= len(history[0].not_seen_deg)
    assert np.linalg.eigvalsh(history[-1].covariance).min() > -1e-9


def test_a_recording_is_calibrated_as_it_runs() -> None:
    result = calibrate_track(driven(), "running", earth=FIELD)
    assert result.accepted, result.reasons
    error = rms(heading_errors(result.correction, iron_of(STRONG)))
    assert error < 0.3
    assert error < 3.0 * result.heading_sigma_deg


def test_what_passes_is_left_out() -> None:
    result = calibrate_track(disturbed(driven(), 60.0, 63.0, (90.0, -70.0, 40.0)), "running", earth=FIELD)
    assert rms(heading_errors(result.correction, iron_of(STRONG))) < 0.4


def test_iron_that_changed_is_forgotten_and_dated() -> None:
    """A battery moved at 45 s: what was learnt before it is not believed after."""
    track = disturbed(driven(), 0.0, 45.0, (60.0, 50.0, 0.0))
    running, _ = run_through(track)
    assert 44.0 < running.changed_s < 52.0
    result = calibrate_track(track, "running", earth=FIELD)
    error = rms(heading_errors(result.correction, iron_of(STRONG)))
    assert error < 3.0 * result.heading_sigma_deg


def test_a_vehicle_that_hardly_turns_cannot_begin() -> None:
    with pytest.raises(PoorCalibration, match="begin"):
        calibrate_track(turning_track(iron_of(STRONG), turns_deg=(80.0,)), "running", earth=FIELD)
