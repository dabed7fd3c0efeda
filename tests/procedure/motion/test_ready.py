"""What may be done to a vehicle so that it can turn itself: nothing without leave, all of it undone."""

from __future__ import annotations

from pathlib import Path

import pytest
from bent_vehicles import calibrated, commands, overheard

from mavcompass.enums import MavCmd
from mavcompass.errors import Refused
from mavcompass.procedure.motion import Permissions
from mavcompass.procedure.settings import CalibrateSettings
from mavcompass.simulation.heading_error import heading_error_rms_deg
from mavcompass.simulation.vehicle import SimulatedAutopilot
from mavcompass.vehicle.stopping import StopRequest

ARMING = {"ARMING_MAGTHRESH": 0.0, "ARMING_CHECK": 0.0}


def on_the_ground(kind: str, seed: int = 1) -> SimulatedAutopilot:
    """Make a disarmed vehicle that knows its place and would arm with a bent compass."""
    vehicle = SimulatedAutopilot(kind, seed=seed, armed=False, parameters=ARMING)
    vehicle.advance(10.0)
    return vehicle


def allow(permissions: Permissions) -> CalibrateSettings:
    return CalibrateSettings(motion="vehicle", writing="yes", permissions=permissions)


@pytest.mark.parametrize(
    ("kind", "mode", "permissions", "sentence"),
    [("rover", "GUIDED", Permissions(), "disarmed, so it cannot turn itself"),
     ("rover", "MANUAL", Permissions(arm=True), "The vehicle is in MANUAL; it turns itself in GUIDED only"),
     ("copter", "GUIDED", Permissions(set_mode=True), "disarmed, so it cannot turn itself")],
)  # fmt: skip
def test_what_was_not_allowed_is_refused_and_not_tried(
    kind: str, mode: str, permissions: Permissions, sentence: str, tmp_path: Path
) -> None:
    vehicle = on_the_ground(kind)
    vehicle.pilot_switches_mode(mode)
    heard = overheard(vehicle)
    with pytest.raises(Refused, match=sentence):
        calibrated(vehicle, tmp_path, allow(permissions))
    forbidden: set[int] = {MavCmd.NAV_TAKEOFF}
    forbidden |= set() if permissions.arm else {int(MavCmd.COMPONENT_ARM_DISARM)}
    forbidden |= set() if permissions.set_mode else {int(MavCmd.DO_SET_MODE)}
    assert not forbidden & commands(heard)


def test_a_copter_on_the_ground_is_not_turned_even_when_armed(tmp_path: Path) -> None:
    vehicle = on_the_ground("copter")
    vehicle.pilot_switches_mode("GUIDED")
    with pytest.raises(Refused, match="too low to be turned"):
        calibrated(vehicle, tmp_path, allow(Permissions(arm=True)))
    assert not vehicle.firmware.reports.heartbeat().base_mode & 128


def test_a_rover_is_switched_armed_calibrated_disarmed_and_switched_back(tmp_path: Path) -> None:
    vehicle = on_the_ground("rover")
    before, heard = vehicle.firmware.reports.heartbeat(), overheard(vehicle)
    report = calibrated(vehicle, tmp_path, allow(Permissions(set_mode=True, arm=True)))
    assert report.written and heading_error_rms_deg(vehicle) < 0.5
    assert MavCmd.PREFLIGHT_REBOOT_SHUTDOWN not in commands(heard)  # nobody asked for a restart
    assert report.on_vehicle_s == pytest.approx(report.duration_s, abs=12.0) and report.on_vehicle_s > 10.0
    assert vehicle.firmware.reports.heartbeat() == before


# PX4's: tests/procedure/test_calibrate_px4.py.
def test_a_copter_takes_off_is_calibrated_and_lands_where_it_was(tmp_path: Path) -> None:
    vehicle = on_the_ground("copter")
    before = vehicle.firmware.reports.heartbeat()
    shown: list[str] = []
    permissions = Permissions(set_mode=True, arm=True, takeoff_m=5.0)
    report = calibrated(vehicle, tmp_path, allow(permissions), shown=shown)
    assert report.written and heading_error_rms_deg(vehicle) < 0.5
    assert "Taking off to 5 m." in shown and "Landing." in shown
    assert vehicle.body.landed
    assert vehicle.firmware.reports.heartbeat() == before


def test_a_vehicle_that_will_not_arm_says_why_and_keeps_its_mode(tmp_path: Path) -> None:
    never_calibrated = {f"COMPASS_OFS_{axis}": 0.0 for axis in "XYZ"}
    vehicle = SimulatedAutopilot("rover", seed=1, armed=False, parameters=never_calibrated)
    vehicle.advance(10.0)
    before = vehicle.firmware.reports.heartbeat()
    with pytest.raises(Refused, match=r"refused to arm\. It said: Compass not calibrated\."):
        calibrated(vehicle, tmp_path, allow(Permissions(set_mode=True, arm=True)))
    assert vehicle.firmware.reports.heartbeat() == before


@pytest.mark.parametrize("kind", ["rover", "copter", "px4-copter"])
def test_what_was_started_a_moment_ago_is_asked_again_until_it_arms(kind: str, tmp_path: Path) -> None:
    vehicle = SimulatedAutopilot(kind, seed=1, armed=False, ready_s=41.0)
    shown: list[str] = []
    permissions = Permissions(set_mode=True, arm=True, takeoff_m=5.0)
    report = calibrated(vehicle, tmp_path, allow(permissions), shown=shown)
    assert report.written and not vehicle.firmware.status.armed
    assert any(text.startswith("It was started a moment ago and is not ready yet.") for text in shown)


def test_a_stop_in_the_air_tells_the_copter_to_land(tmp_path: Path) -> None:
    vehicle = on_the_ground("copter")
    stop = StopRequest()

    class StopAtTheSecondTurn(list[str]):
        def append(self, text: str) -> None:
            super().append(text)
            if text == "Turning to position 3 of 4.":
                stop.reason = "Stopped by Ctrl-C."

    permissions = Permissions(set_mode=True, arm=True, takeoff_m=5.0)
    shown = StopAtTheSecondTurn()
    with pytest.raises(Refused, match="Stopped by Ctrl-C"):
        calibrated(vehicle, tmp_path, allow(permissions), shown=shown, stop=stop)
    vehicle.advance(vehicle.time_s + 40.0)
    assert vehicle.body.landed and not vehicle.firmware.reports.heartbeat().base_mode & 128
