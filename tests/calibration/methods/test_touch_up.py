"""Touch-up: iron that moved since a calibration, by a quarter turn, with that calibration's scales."""

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
from mavcompass.calibration.result import CalibrationResult
from mavcompass.calibration.rigid import DEFAULT_PRIOR
from mavcompass.correction import FieldCorrection
from mavcompass.earth_field import EarthField
from mavcompass.errors import PoorCalibration
from mavcompass.gap.trial.vehicles.draw import draw_vehicle
from mavcompass.procedure.settings import CalibrateSettings
from mavcompass.simulation.heading_error import heading_error_rms_deg
from mavcompass.simulation.vehicle import SimulatedAutopilot
from mavcompass.track import InForce
from mavcompass.vehicle.calibrating import calibrate_on
from mavcompass.vehicle.links.simulated import SimulatedLink

GAIN = np.array([[1.06, 0.02, 0.01], [0.02, 0.95, -0.01], [0.01, -0.01, 1.02]])
SCALES = FieldCorrection.from_matrix((5.0, 6.0, -10.0), np.linalg.inv(GAIN))


def touched_up(
    data: FourPositionData, in_force: FieldCorrection, earth: EarthField | None = FIELD
) -> CalibrationResult:
    return calibrate_positions(data, in_force, earth, prior=DEFAULT_PRIOR.of(in_force))


@settings(max_examples=40)
@given(
    st.floats(0.0, 2.0 * math.pi),
    st.floats(math.radians(61.0), math.radians(299.0)),
    st.floats(-100.0, 100.0),
    st.sampled_from([FIELD, None]),
)
def test_two_positions_tell_the_offset_where_the_scales_are_known(
    first: float, turn: float, moved: float, earth: EarthField | None
) -> None:
    """Closed form: what a turn changes is the field's alone; what is left of a reading is the iron."""
    iron = Iron((60.0 + moved, -40.0 - 0.5 * moved, 10.0), GAIN)
    result = touched_up(four_positions(iron, first=first, turns=np.array([turn])), SCALES, earth)
    assert result.accepted, result.reasons
    assert result.raw_offset_mgauss[:2] == pytest.approx(iron.offset[:2], abs=0.2)
    assert rms(heading_errors(result.correction, iron)) < 0.05


def test_too_small_a_turn_is_refused() -> None:
    short = four_positions(Iron(), turns=np.array([math.radians(40.0)]))
    assert "only 40 degrees of the circle" in touched_up(short, SCALES).reasons[0]
    with pytest.raises(PoorCalibration, match="at least 3"):
        calibrate_positions(four_positions(Iron(), turns=np.array([1.6])), SCALES, FIELD)


def test_fifty_vehicles_are_within_what_is_claimed() -> None:
    """Irons of another make, whose scales in force are as wrong as is said of them."""
    within, seen = 0, 50
    for seed in range(seen):
        rng = np.random.default_rng(seed)
        drawn = draw_vehicle(rng, "rover", None, precise=False).compass
        _, stretches, axes = np.linalg.svd(drawn.matrix)  # how it is mounted is not sought
        gain = axes.T @ np.diag(stretches) @ axes
        off = np.triu(rng.normal(0.0, 0.016, (3, 3)))
        held = np.linalg.inv(gain + off + np.triu(off, 1).T)
        in_force = FieldCorrection.from_matrix((9.0, 9.0, 9.0), held)
        iron = Iron(tuple(drawn.iron_mgauss), gain)
        first = float(rng.uniform(0.0, 2.0 * math.pi))
        data = four_positions(iron, rng, first=first, turns=np.array([math.pi / 2]), noise=3.0)
        result = touched_up(data, in_force)
        within += rms(heading_errors(result.correction, iron)) < 1.96 * result.heading_sigma_deg
    assert within >= 0.95 * seen


def test_what_was_never_calibrated_has_no_scales_to_keep() -> None:
    with pytest.raises(PoorCalibration, match="never been calibrated") as caught:
        calibrate_track(turning_track(Iron()), "touch-up", earth=FIELD)
    assert "four positions" in caught.value.remedy
    bare = FieldCorrection((5.0, 6.0, 7.0))
    result = calibrate_track(turning_track(Iron(), turns_deg=(90.0,), in_force=bare), "touch-up", earth=FIELD)
    assert "too few positions for all that is unknown" in result.reasons[0]


def test_the_recorded_firmware_is_touched_up_by_its_first_quarter(shared_data: Path) -> None:
    """Its simulator's own scales, and offsets as they were before a magnet came aboard."""
    track = api.read_track(shared_data / "ardupilot-4.6.3" / "rover_dist_use2.BIN")
    cure = FieldCorrection((120.0, -80.0, 40.0), diagonals=(1.1, 0.9, 1.0))
    before = replace(cure, offsets_mgauss=(90.0, -60.0, 40.0))
    compass = track.compasses[1]
    raw = replace(compass.reported, values=before.apply(track.raw_field(1)))
    held = replace(compass, reported=raw, in_force=(InForce(-math.inf, before),))
    result = calibrate_track(replace(track, compasses={**track.compasses, 1: held}), "touch-up")
    assert result.accepted and result.method == "touch-up"
    assert rms(heading_errors(result.correction, iron_of(cure))) < 0.5


# One of each autopilot: how each kind turns, tests/procedure/test_calibrate_vehicles.py looks at.
@pytest.mark.parametrize("kind", ["rover", "px4-copter"])
def test_a_vehicle_cures_itself_by_a_quarter_turn(kind: str, tmp_path: Path) -> None:
    vehicle = SimulatedAutopilot(kind, seed=12, effects=("hard_iron:x=35,y=-25,z=8",))
    settings = CalibrateSettings(method="touch-up", writing="yes")
    report = calibrate_on(SimulatedLink(vehicle), "sim:test", settings, undo_directory=tmp_path)
    (result,) = report.results
    assert len(report.windows) == 2 and report.written
    assert report.proof is not None and report.proof.passed
    assert heading_error_rms_deg(vehicle) < 0.6 < result.heading_change_deg
