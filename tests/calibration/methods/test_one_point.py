"""One point: offsets from a heading that is given, and how sure the heading is by so little."""

from __future__ import annotations

import math
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from calibration_worlds import FIELD, Iron, four_positions, heading_errors, iron_of, rms, turning_track
from hypothesis import given, settings
from hypothesis import strategies as st

from mavcompass import api
from mavcompass.calibration import calibrate_track
from mavcompass.calibration.methods.four_positions import calibrate_positions
from mavcompass.calibration.observation import FourPositionData
from mavcompass.calibration.result import CalibrationResult, Limits, TrueHeading
from mavcompass.calibration.rigid import DEFAULT_PRIOR
from mavcompass.correction import IDENTITY, FieldCorrection
from mavcompass.errors import PoorCalibration, UsageError
from mavcompass.frames import wrap_pi
from mavcompass.gap.trial.vehicles.draw import draw_vehicle
from mavcompass.track import InForce, Series, Track

WIDE = Limits(heading_deg=20.0)


def stood(iron: Iron, true_deg: float, in_force: FieldCorrection | None = None) -> Track:
    """A recording of a level vehicle that stands for five seconds at a true heading."""
    magnetic_deg = true_deg - math.degrees(FIELD.declination_rad)
    return turning_track(iron, turns_deg=(), first_deg=magnetic_deg, noise=1.0, in_force=in_force)


def one_point(track: Track, true_deg: float) -> CalibrationResult:
    heading = TrueHeading(math.radians(true_deg))
    return calibrate_track(track, "one-point", earth=FIELD, limits=WIDE, true_heading=heading)


def at(
    data: FourPositionData, magnetic_rad: float, in_force: FieldCorrection = IDENTITY
) -> CalibrationResult:
    """Calibrate by one dwell at a heading that is given to a degree."""
    prior = DEFAULT_PRIOR.of(in_force)
    known = replace(data, first_heading=(magnetic_rad, math.radians(1.0)))
    return calibrate_positions(known, in_force, FIELD, limits=WIDE, prior=prior)


def test_the_offset_is_the_reading_less_the_field_at_that_heading() -> None:
    """Closed form, with the gains in force: b = r - T F."""
    gain = np.array([[1.1, 0.02, 0.0], [0.02, 0.9, 0.01], [0.0, 0.01, 1.05]])
    iron = Iron((120.0, -80.0, 40.0), gain)
    in_force = FieldCorrection.from_matrix((5.0, 6.0, 7.0), np.linalg.inv(gain))
    result = at(four_positions(iron, first=0.7, turns=np.zeros(0)), 0.7, in_force)
    assert result.raw_offset_mgauss == pytest.approx(iron.offset, abs=0.01)
    assert result.correction.matrix == pytest.approx(in_force.matrix, abs=1e-6)
    assert heading_errors(result.correction, iron) == pytest.approx(0.0, abs=0.01)


@settings(max_examples=40)
@given(
    st.floats(0.0, 2.0 * math.pi),
    st.floats(0.8, 1.2),
    st.floats(0.8, 1.2),
    st.floats(-300.0, 300.0),
    st.floats(-0.2, 0.2),
)
def test_at_the_given_heading_it_shows_that_heading(
    psi: float, x: float, y: float, offset: float, tilt: float
) -> None:
    """Whatever the iron, and however it leans there: gains that are not known bend other headings only."""
    iron = Iron((offset, 0.5 * offset, 10.0), np.diag([x, y, 1.0]))
    data = four_positions(iron, np.random.default_rng(1), first=psi, turns=np.zeros(0), tilt=tilt)
    result = at(data, psi)
    shown = data.dwells[0].heading_rad(result.correction)
    assert float(wrap_pi(shown - psi)) == pytest.approx(0.0, abs=1e-6)
    assert result.heading_error is not None
    here, opposite = result.heading_error.sigma_rad([psi, psi + 0.5 * math.pi])
    assert math.radians(1.0) <= here < opposite


def test_fifty_vehicles_are_within_what_is_claimed() -> None:
    """Irons of another make, of whose gains nothing is known; the heading is given as surely as is said."""
    within, seen = 0, 50
    for seed in range(seen):
        rng = np.random.default_rng(seed)
        drawn = draw_vehicle(rng, "rover", None, precise=False)
        iron = Iron(tuple(drawn.compass.iron_mgauss), drawn.compass.matrix)
        psi = float(rng.uniform(0.0, 2.0 * math.pi))
        data = four_positions(iron, rng, first=psi, turns=np.zeros(0), noise=3.0)
        result = at(data, psi + math.radians(float(rng.normal())))
        within += rms(heading_errors(result.correction, iron)) < 1.96 * result.heading_sigma_deg
    assert within >= 0.95 * seen


def test_a_calibration_in_force_makes_it_surer() -> None:
    """Its gains are known better than those that nobody has measured."""
    held = FieldCorrection((0.0, 5.0, 0.0), diagonals=(1.05, 0.96, 1.0))
    known, unknown = (one_point(stood(Iron(), 40.0, force), 40.0) for force in (held, IDENTITY))
    assert known.heading_budget_deg["prior"] < 0.5 * unknown.heading_budget_deg["prior"]
    assert known.correction.matrix == pytest.approx(held.matrix, abs=1e-6)


def test_too_unsure_it_is_refused_with_what_would_do() -> None:
    result = calibrate_track(stood(Iron(), 40.0), "one-point", earth=FIELD, true_heading=TrueHeading(0.7))
    assert not result.accepted
    assert "too few positions for all that is unknown (turn through four)" in result.reasons[0]
    assert "--max-error-deg" in result.warnings[0]
    assert any("cannot be seen at one heading" in said for said in result.warnings)


def test_values_in_force_that_are_wrong_here_are_not_called_right() -> None:
    """What is within the doubt of all headings together need not be within that of the one given."""
    held = FieldCorrection((0.0, 100.0, 0.0))
    result = one_point(stood(Iron(), 0.0, held), 0.0)
    assert result.accepted and not result.already_right
    assert one_point(stood(Iron((10.0, 0.0, 0.0)), 0.0, FieldCorrection((-9.0, 0.5, 0.0))), 0.0).already_right


def test_without_a_place_it_says_what_is_missing() -> None:
    with pytest.raises(PoorCalibration, match="The place is unknown") as caught:
        api.calibrate(stood(Iron(), 40.0), "one-point", true_heading_rad=0.7)
    assert "receiver's position" in caught.value.remedy


def test_without_a_heading_it_says_who_could_tell_it() -> None:
    with pytest.raises(UsageError, match="no second antenna") as caught:
        calibrate_track(stood(Iron(), 40.0), "one-point", earth=FIELD)
    assert "--true-heading DEG" in caught.value.remedy


def test_a_second_antenna_tells_the_heading_and_is_no_witness() -> None:
    track, iron = stood(Iron((60.0, 0.0, 0.0)), 40.0), Iron((60.0, 0.0, 0.0))
    times = np.arange(0.0, 5.0, 0.2)
    track = replace(track, gps_yaw_rad=Series.of(times, np.full(times.size, math.radians(40.0))))
    result = calibrate_track(track, "one-point", earth=FIELD, limits=WIDE)
    assert result.to_json()["true_heading"] == {
        "heading_deg": pytest.approx(40.0),
        "sigma_deg": pytest.approx(1.5),
    }
    assert rms(heading_errors(result.correction, iron)) < 0.3
    assert result.evidence == () and not result.mounting.seen


def test_a_recording_that_never_stands_is_refused() -> None:
    turning = turning_track(Iron(), dwell_s=0.2, turns_deg=(180.0, 180.0))
    with pytest.raises(PoorCalibration, match="never stood still"):
        one_point(turning, 0.0)


def test_of_several_stands_the_one_at_that_heading_is_taken() -> None:
    iron, track = Iron((30.0, -20.0, 0.0)), turning_track(Iron((30.0, -20.0, 0.0)), first_deg=0.0)
    for quarter in range(4):
        true_deg = 90.0 * quarter + math.degrees(FIELD.declination_rad)
        assert rms(heading_errors(one_point(track, true_deg).correction, iron)) < 0.5
    with pytest.raises(PoorCalibration, match="none is clearly the one given"):
        one_point(track, 45.0 + math.degrees(FIELD.declination_rad))


def test_a_heading_that_another_compass_contradicts_is_refused() -> None:
    track = stood(Iron(), 40.0)
    second = replace(track.compasses[1], instance=2, in_force=(InForce(-math.inf, IDENTITY),))
    result = one_point(replace(track, compasses={**track.compasses, 2: second}), 130.0)
    assert not result.accepted
    assert "compass 2" in result.reasons[0].lower()
    assert "the heading that was given" in result.reasons[0]


def test_the_recorded_firmware_is_cured_to_what_its_gains_leave(shared_data: Path) -> None:
    """True headings as its simulator told them in the notes beside the recording, before the gains' doubt."""
    track = api.read_track(shared_data / "ardupilot-4.6.3" / "rover_dist_use2.tlog")
    cure = FieldCorrection((120.0, -80.0, 40.0), diagonals=(1.1, 0.9, 1.0))
    for true_deg in (0.0, 90.0, 180.0):
        result = api.calibrate(
            track, "one-point", max_heading_error_deg=8.0, true_heading_rad=math.radians(true_deg)
        )
        assert result.accepted
        left_deg = rms(heading_errors(result.correction, iron_of(cure)))
        assert left_deg < 1.96 * result.heading_sigma_deg
        assert left_deg < 0.5 * result.heading_change_deg
    plain = api.read_track(shared_data / "ardupilot-4.6.3" / "rover_plain.tlog")
    result = api.calibrate(plain, "one-point", max_heading_error_deg=8.0, true_heading_rad=0.0)
    assert result.correction.offsets_mgauss == pytest.approx((5.0, 13.0, -18.0), abs=6.0)
