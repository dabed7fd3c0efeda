"""What the service makes of single messages: compasses, the world around them, restarts, course, current."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from mavcompass import messages as mav
from mavcompass.calibration.result import CalibrationResult, Mounting
from mavcompass.correction import IDENTITY, FieldCorrection
from mavcompass.enums import MavVtolState
from mavcompass.heading.doubt import prior_sigma_rad
from mavcompass.kinds import Kind
from mavcompass.procedure.vehicle_state import VehicleIdentity
from mavcompass.service.view import VehicleView

FIELD: dict[str, Any] = {"xmag": 200, "ymag": 0, "zmag": 400, "zacc": -1000}
ZURICH = mav.GlobalPositionInt(lat=473_977_000, lon=85_456_000, alt=488_000)


def view(autopilot: str = "ardupilot", kind: Kind = "rover") -> VehicleView:
    return VehicleView(VehicleIdentity(1, 1, autopilot, kind), "key", 2026.0)


def heard(message: mav.Message, time_s: float = 0.0) -> mav.Incoming:
    return mav.Incoming(time_s, 1, 1, message)


@pytest.mark.parametrize(
    ("autopilot", "message", "instance"),
    [
        ("ardupilot", mav.RawImu(time_usec=5_000_000, **FIELD), 1),
        ("px4", mav.RawImu(time_usec=5_000_000, **FIELD), None),  # its numbers are of no known unit
        ("px4", mav.ScaledImu(time_boot_ms=5000, **FIELD), 1),
        ("ardupilot", mav.ScaledImu2(time_boot_ms=5000, **FIELD), 2),
        ("ardupilot", mav.ScaledImu3(time_boot_ms=5000, **FIELD), 3),
        ("ardupilot", mav.Attitude(time_boot_ms=5000), None),
    ],
)
def test_which_messages_bring_a_heading(autopilot: str, message: mav.Message, instance: int | None) -> None:
    seen = view(autopilot)
    found = seen.hear(heard(message, 7.0))
    assert seen.heard_s == 7.0
    if instance is None:
        assert found is None and seen.instances() == ()
    else:
        assert found is not None and (found.instance, found.boot_s, found.time_s) == (instance, 5.0, 7.0)
        assert seen.instances() == (instance,)


def test_a_heading_has_the_doubt_of_what_was_just_written() -> None:
    seen = view()
    seen.hear(heard(mav.RawImu(time_usec=5_000_000, **FIELD)))
    bad = CalibrationResult(1, "sphere", False, ("no",), IDENTITY, heading_sigma_deg=0.2)
    seen.calibrated([bad])
    assert seen.compasses[1].calibration_sigma_rad > math.radians(4.0), "what was not written changes nothing"
    seen.calibrated([replace(bad, accepted=True)])
    assert seen.compasses[1].calibration_sigma_rad == pytest.approx(math.radians(0.2))


def test_compasses_that_stand_apart_claim_no_less_than_that() -> None:
    seen, east = view(), FIELD | {"xmag": 0, "ymag": -200}
    for tenth in range(100):
        seen.hear(heard(mav.RawImu(time_usec=100_000 * tenth, **FIELD), 0.1 * tenth))
        seen.hear(heard(mav.ScaledImu2(time_boot_ms=100 * tenth, **east), 0.1 * tenth))
    told = [compass.latest.sigma_rad for compass in seen.compasses.values() if compass.latest is not None]
    assert len(told) == 2 and min(told) > math.radians(30.0)


def test_scaled_imu_counts_where_raw_imu_was_not_heard_lately() -> None:
    seen = view()
    scaled = mav.ScaledImu(time_boot_ms=5000, **FIELD)
    assert seen.hear(heard(scaled, 1.0)) is not None
    seen.hear(heard(mav.RawImu(time_usec=5_100_000, **FIELD), 2.0))
    assert seen.hear(heard(scaled, 2.5)) is None
    assert seen.hear(heard(scaled, 60.0)) is not None


@pytest.mark.parametrize(
    ("message", "restarted"),
    [(mav.RawImu(time_usec=98_100_000), False), (mav.RawImu(time_usec=2_000_000), True),
     (mav.ScaledImu(time_boot_ms=2000), True), (mav.Attitude(time_boot_ms=2000), True),
     (mav.GlobalPositionInt(time_boot_ms=2000), True), (mav.Heartbeat(), False)],
)  # fmt: skip
def test_a_clock_that_begins_anew_is_a_restart(message: mav.Message, restarted: bool) -> None:
    seen = view()
    seen.hear(heard(mav.RawImu(time_usec=100_000_000, **FIELD)))
    seen.fresh = True
    assert seen.restarted(message) is restarted
    seen.restart()
    assert (seen.reboots, seen.fresh) == (1, False)
    assert not seen.restarted(message), "it is told once"


def test_the_world_is_looked_up_where_the_place_is_one_and_again_ten_kilometres_on() -> None:
    seen = view()
    seen.hear(heard(mav.RawImu(time_usec=1, **FIELD)))
    for nowhere in (mav.GlobalPositionInt(), mav.GlobalPositionInt(lat=910_000_000, lon=1)):
        seen.hear(heard(nowhere))
        assert seen.world is None
    seen.hear(heard(ZURICH))
    world = seen.world
    assert world is not None and seen.compasses[1].world is world
    assert world.inclination_rad == pytest.approx(math.radians(63.5), abs=0.02)
    near = mav.GlobalPositionInt(lat=ZURICH.lat + 900_000, lon=ZURICH.lon - 900_000, alt=ZURICH.alt)
    seen.hear(heard(near))
    assert seen.world is world
    far = mav.GlobalPositionInt(lat=ZURICH.lat + 1_100_000, lon=ZURICH.lon, alt=ZURICH.alt)
    seen.hear(heard(far))
    assert seen.world is not None and seen.world is not world
    assert seen.compasses[1].world is seen.world
    # A compass that is heard first now is told at once.
    seen.hear(heard(mav.ScaledImu2(time_boot_ms=1, **FIELD)))
    assert seen.compasses[2].world is seen.world


def test_px4s_raw_readings_are_corrected_by_its_parameters_as_soon_as_these_are_known() -> None:
    seen = view("px4")
    message = mav.ScaledImu(time_boot_ms=1, **FIELD)
    before = seen.hear(heard(message))
    seen.set_parameters({"CAL_MAG0_ID": 77.0, "CAL_MAG0_XOFF": 0.05, "CAL_MAG0_ROT": -1.0})
    after = seen.hear(heard(message))
    assert before is not None and after is not None
    assert before.level_mgauss[0] - after.level_mgauss[0] == pytest.approx(50.0)
    assert seen.device_id(1) == 77 and seen.device_id(2) == 0
    assert seen.fresh


@pytest.mark.parametrize(
    ("written", "ahead_mgauss", "sigma_deg"),
    [
        ({}, 230.0, 0.2),
        # Turned anew it is corrected once the vehicle has told how.
        ({"mounting": Mounting(True, np.diag((-1.0, -1.0, 1.0)), 180.0)}, 200.0, 0.2),
        ({"already_right": True}, 200.0, 9.0),
        ({"accepted": False}, 200.0, 9.0),
        ({"instance": 2}, 200.0, 9.0),  # of which nothing was heard
    ],
)
def test_px4s_raw_readings_are_corrected_by_what_was_just_written(
    written: dict[str, Any], ahead_mgauss: float, sigma_deg: float
) -> None:
    seen, message = view("px4"), mav.ScaledImu(time_boot_ms=1, **FIELD)
    seen.set_parameters({"CAL_MAG0_ID": 77.0, "CAL_MAG0_XOFF": 0.0, "CAL_MAG0_ROT": -1.0})
    seen.hear(heard(message))
    seen.compasses[1].calibration_sigma_rad = math.radians(9.0)
    new = CalibrationResult(1, "sphere", True, (), FieldCorrection((30.0, 0.0, 0.0)), heading_sigma_deg=0.2)
    seen.calibrated([replace(new, **written)])
    after = seen.hear(heard(message))
    assert after is not None and after.level_mgauss[0] == pytest.approx(ahead_mgauss)
    assert seen.compasses[1].calibration_sigma_rad == pytest.approx(math.radians(sigma_deg))


@pytest.mark.parametrize(
    ("sigma_deg", "sigma_rad"),
    [(1.0, math.radians(1.0)), (None, prior_sigma_rad(False)), (math.nan, prior_sigma_rad(False))],
)  # fmt: skip
def test_how_good_the_calibration_is(sigma_deg: float | None, sigma_rad: float) -> None:
    seen = view()
    seen.set_calibration_sigma(1, sigma_deg)  # nothing was heard of it yet
    seen.hear(heard(mav.RawImu(time_usec=1, **FIELD)))
    seen.compasses[1].calibration_sigma_rad = 9.0
    seen.set_calibration_sigma(1, sigma_deg)
    assert seen.compasses[1].calibration_sigma_rad == pytest.approx(sigma_rad)


@pytest.mark.parametrize(
    ("gps", "course_rad", "speed_mps"),
    [
        (mav.GpsRawInt(fix_type=3, cog=9000, vel=250), math.pi / 2, 2.5),
        (mav.GpsRawInt(fix_type=2, cog=9000, vel=250), None, 0.0),
        (mav.GpsRawInt(fix_type=3, cog=65535, vel=250), None, 0.0),
        (mav.GpsRawInt(fix_type=3, cog=9000, vel=65535), None, 0.0),
        (None, None, 0.0),
    ],
)
def test_course_and_speed_are_those_of_a_fix(
    gps: mav.GpsRawInt | None, course_rad: float | None, speed_mps: float
) -> None:
    seen = view()
    if gps is not None:
        seen.hear(heard(gps))
    glance = seen.glance(3.0)
    assert (glance.time_s, glance.course_rad, glance.speed_mps) == (3.0, pytest.approx(course_rad), speed_mps)


@pytest.mark.parametrize(("base_mode", "sways", "stands"), [(0, 0, True), (128, 0, False), (0, 200, False)])
def test_what_is_disarmed_and_still_stands(base_mode: int, sways: int, stands: bool) -> None:
    seen = view()
    seen.hear(heard(mav.Heartbeat(base_mode=base_mode)))
    for tenth in range(100):
        gyro = sways if tenth % 2 else -sways
        seen.hear(heard(mav.RawImu(time_usec=100_000 * tenth, zgyro=gyro, **FIELD), 0.1 * tenth))
    assert seen.glance(10.0).stands is stands


@pytest.mark.parametrize(("told", "current_a"), [(1234, 12.34), (0, 0.0), (-1, None)])
def test_a_current_is_known_where_it_is_measured(told: int, current_a: float | None) -> None:
    seen = view()
    seen.hear(heard(mav.SysStatus(current_battery=told)))
    assert seen.glance(0.0).current_a == pytest.approx(current_a)


@pytest.mark.parametrize(
    ("kind", "state", "is_now", "fixes"),
    [("plane", MavVtolState.FW, "plane", 1), ("plane", MavVtolState.MC, "vtol", 0),
     ("rover", MavVtolState.UNDEFINED, "rover", 1)],
)  # fmt: skip
def test_a_plane_that_its_rotors_hold_goes_any_way(
    kind: Kind, state: MavVtolState, is_now: str, fixes: int
) -> None:
    seen = view(kind=kind)
    seen.hear(heard(mav.RawImu(time_usec=5_000_000, **FIELD)))
    seen.hear(heard(mav.ExtendedSysState(state)))
    seen.hear(heard(mav.GpsRawInt(fix_type=3, cog=9000, vel=1500)))
    assert (seen.kind, seen.glance(0.0).kind) == (is_now, is_now)
    assert seen.compasses[1].fixes.numbers == (0, fixes)
