"""A stop beside something magnetic is left out where the rest then agrees, and told."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
from calibration_worlds import FIELD, Iron, heading_errors, iron_of, rms, turning_track

from mavcompass.calibration import calibrate_track
from mavcompass.calibration.motion.left_out import Disturbed, without_disturbed_stop
from mavcompass.calibration.motion.observed import Motion, observe_motion
from mavcompass.calibration.recorded import Recorded
from mavcompass.correction import FieldCorrection
from mavcompass.track import Series, Track

DWELL_S, TURN_S = 5.0, 4.5
STEEL = np.array([40.0, -30.0, 20.0])
IRON = iron_of(FieldCorrection((60.0, -40.0, 25.0), (1.08, 0.93, 1.0)))


def beside_steel(stop: int | None, stops: int = 4, iron: Iron = IRON) -> Track:
    """A turn with stops, one of them (from 0) beside steel whose field fades on the turns around."""
    track = turning_track(iron, dwell_s=DWELL_S, turn_s=TURN_S, turns_deg=(90.0,) * (stops - 1), noise=3.0)
    if stop is None:
        return track
    compass = track.compasses[1]
    since_s = np.abs(compass.time_s - (DWELL_S / 2.0 + stop * (DWELL_S + TURN_S))) - DWELL_S / 2.0
    near = np.clip(1.0 - np.maximum(since_s, 0.0) / TURN_S, 0.0, 1.0) ** 3
    field = Series.of(compass.time_s, compass.reported.values + near[:, np.newaxis] * STEEL)
    return replace(track, compasses={1: replace(compass, reported=field)})


def motion_of(track: Track) -> Motion:
    return observe_motion(Recorded(track, earth=FIELD))


@pytest.mark.parametrize(("stop", "stops"), [(1, 4), (2, 4), (3, 5)])
def test_the_disturbed_stop_is_found_and_left_out(stop: int, stops: int) -> None:
    track = beside_steel(stop, stops)
    found = without_disturbed_stop(motion_of(track))
    assert found is not None and found.at_s == pytest.approx(
        [DWELL_S / 2.0 + stop * (DWELL_S + TURN_S)], abs=2.0
    )
    assert found.open_rad == 0.0 and not found.said(0.0)[1]
    result = calibrate_track(track, "world-field", earth=FIELD)
    assert result.accepted, result.reasons
    assert rms(heading_errors(result.correction, IRON)) < 2.0 * result.heading_sigma_deg < 1.2
    assert f"where it stopped at {found.at_s[0]:.0f} s: without that stop" in result.warnings[1]


def test_nothing_is_left_out_where_all_agree_or_stops_are_few() -> None:
    assert without_disturbed_stop(motion_of(beside_steel(None))) is None
    assert without_disturbed_stop(motion_of(beside_steel(1, stops=3))) is None


def test_where_two_stops_may_be_it_the_result_is_refused(monkeypatch: pytest.MonkeyPatch) -> None:
    motion = motion_of(beside_steel(1))
    either = Disturbed(motion, (12.0, 22.0), math.radians(2.5))
    reason, refused = either.said(2.0)
    assert "stopped at 12 s or 22 s, and the recording does not tell where" in reason and refused
    assert not either.said(3.0)[1]
    monkeypatch.setattr(
        "mavcompass.calibration.methods.world_field.without_disturbed_stop", lambda motion: either
    )
    result = calibrate_track(beside_steel(1), "world-field", earth=FIELD)
    assert not result.accepted and reason in result.reasons
    assert result.heading_sigma_deg >= 2.499


def test_the_turns_across_a_gap_are_joined() -> None:
    sections = motion_of(beside_steel(None)).sections
    rest = sections.chosen(np.array([0, 1, 5, 6]))
    joined = math.sqrt(float((sections.step_sigma_rad[1:5] ** 2).sum()))
    assert rest.step_sigma_rad == pytest.approx(
        [sections.step_sigma_rad[0], joined, sections.step_sigma_rad[5]]
    )
    assert rest.turned_rad.tolist() == sections.turned_rad[[0, 1, 5, 6]].tolist()
