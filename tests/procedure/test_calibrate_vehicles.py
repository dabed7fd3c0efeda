"""One command calibrates each kind of vehicle, however wrong its compass and however bad the link."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from bent_vehicles import KINDS, bent_vehicle, calibrated, overheard, untouched

from mavcompass.messages import ParamSet
from mavcompass.procedure.motion.safety import MotionGuard
from mavcompass.procedure.settings import CalibrateSettings
from mavcompass.simulation.heading_error import heading_error_rms_deg
from mavcompass.simulation.vehicle import SimulatedAutopilot
from mavcompass.vehicle.links.faults import Faults, FaultyLink
from mavcompass.vehicle.links.simulated import SimulatedLink, simulated_autopilot

BAD_LINK = Faults(loss=0.3, duplicate=0.05, reorder=0.1, latency_s=0.3)


# Many seeds of each: scripts/campaigns/vehicles.py. PX4's: test_calibrate_px4.py.
@pytest.mark.parametrize("kind", [kind for kind in KINDS if not kind.startswith("px4")])
def test_one_command_brings_the_heading_within_half_a_degree(kind: str, tmp_path: Path) -> None:
    vehicle = bent_vehicle(kind, seed=11)
    before = untouched(vehicle)
    assert heading_error_rms_deg(vehicle) > 30.0
    report = calibrated(vehicle, tmp_path)
    assert report.written and report.proof is not None and report.proof.passed
    assert heading_error_rms_deg(vehicle) <= 0.5
    assert untouched(vehicle) == before
    if kind == "copter":  # what hovers is levelled by its receiver's velocity
        assert (velocity := report.track.gps_velocity_mps) is not None
        assert np.diff(velocity.time_s).max() < 0.5 and np.ptp(velocity.time_s) > 20.0


# What flies waits, before it turns on, until its estimator has followed the new compass: 9 s at the most.
# A dwell lasts until its level is known, by gyro and accelerometer together: 1.7 s at a rover.
@pytest.mark.parametrize(("kind", "within_s"), [("rover", 25.0), ("copter", 25.0 + 9.0)])
def test_four_dwells_and_the_proof_turn_take_25_seconds(kind: str, within_s: float, tmp_path: Path) -> None:
    vehicle = SimulatedAutopilot(kind, seed=11)
    report = calibrated(vehicle, tmp_path, CalibrateSettings(writing="yes", most_positions=4))
    time_s = report.track.compasses[1].time_s
    assert len(report.windows) == 4
    assert float(time_s[-1]) - report.windows[0].start_s <= within_s


def test_where_the_live_gyro_misled_the_proof_it_turns_on_until_it_tells(tmp_path: Path) -> None:
    """This copter sways at its last position: two degrees a second are taken for the gyro's bias."""
    vehicle = simulated_autopilot("copter", 14, ())
    report = calibrated(vehicle, tmp_path)
    assert report.written and report.proof is not None and report.proof.passed
    assert report.proof.compasses[0].gyro_turned_deg == pytest.approx(45.0, abs=8.0)
    assert heading_error_rms_deg(vehicle) <= 0.5


# Every kind, many seeds: scripts/campaigns/vehicles.py --quality lossy.
def test_over_a_bad_link_the_error_stays_within_what_the_sigma_claims(tmp_path: Path) -> None:
    vehicle = bent_vehicle("rover", 1, 0.6)
    before = untouched(vehicle)
    report = calibrated(vehicle, tmp_path, link=FaultyLink(SimulatedLink(vehicle), BAD_LINK, seed=1))
    assert report.written and report.proof is not None and report.proof.passed
    assert untouched(vehicle) == before
    error_deg = heading_error_rms_deg(vehicle, 1, report.results[0].correction)
    assert error_deg <= min(0.5, 3.0 * report.results[0].heading_sigma_deg)


@pytest.mark.parametrize(("share", "positions"), [(0.45, 6), (0.55, 4)])
def test_more_positions_are_visited_where_four_leave_too_much_in_doubt(
    share: float, positions: int, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Unless it has strayed over half of its room: stopped there, it would have all of it for nothing."""
    monkeypatch.setattr(MotionGuard, "strayed_m", property(lambda guard: share * guard.room_m))
    settings = CalibrateSettings(writing="never", enough_deg=0.01, most_positions=6)
    report = calibrated(bent_vehicle("rover", 1), tmp_path, settings)
    assert len(report.windows) == positions
    turned = np.degrees([window.turned_rad for window in report.windows]) % 360.0
    gaps = np.diff(np.sort(np.append(turned, turned.min() + 360.0)))
    assert gaps.min() > 25.0


def test_what_is_right_already_is_left_as_it_is_and_the_autopilots_heading_is_told(tmp_path: Path) -> None:
    vehicle = SimulatedAutopilot("rover", seed=3, calibration="exact")
    before, heard = dict(vehicle.firmware.store.values), overheard(vehicle)
    report = calibrated(vehicle, tmp_path, CalibrateSettings(writing="yes", rate_hz=10.0))
    assert report.accepted and report.results[0].already_right and not report.written
    assert (
        report.heading is not None
        and not report.heading.written
        and abs(report.heading.error_after_deg) < 2.0
    )
    assert not any(isinstance(message, ParamSet) for message in heard)
    assert all(vehicle.firmware.store.values[name] == before[name] for name in before if "COMPASS" in name)
