"""What ends a motion, number by number; whole motions are interrupted in `test_interrupted`."""

from __future__ import annotations

import pytest

from mavcompass import messages as mav
from mavcompass.messages import Incoming
from mavcompass.printable import printable
from mavcompass.procedure.modes import ModeKeeper
from mavcompass.procedure.motion.safety import MotionGuard
from mavcompass.procedure.turning import GyroAngle
from mavcompass.procedure.vehicle_state import VehicleState

ARMED = mav.Heartbeat(type=10, autopilot=3, base_mode=128, custom_mode=15, system_status=4)


def guarded(lat: int, lon: int) -> tuple[VehicleState, MotionGuard]:
    state = VehicleState()
    modes = ModeKeeper(state, "ardupilot")
    guard = MotionGuard(state, GyroAngle(), "rover", modes)
    for message in (ARMED, mav.GlobalPositionInt(lat=lat, lon=lon)):
        state.hear(Incoming(0.0, 1, 1, message))
    modes.accept_present()
    guard.begin()
    return state, guard


@pytest.mark.parametrize(
    ("start", "now", "strayed"),
    [(1_799_999_990, -1_799_999_990, False), (-1_799_999_990, 1_799_999_990, False),
     (1_799_999_990, -1_799_990_000, True), (85_000_000, 85_000_100, False), (85_000_000, 85_001_000, True)],
)  # fmt: skip
def test_the_room_to_move_in_goes_on_beyond_the_date_line(start: int, now: int, strayed: bool) -> None:
    state, guard = guarded(-170_000_000, start)
    state.hear(Incoming(0.1, 1, 1, mav.GlobalPositionInt(lat=-170_000_000, lon=now)))
    said = guard.check(0.1)
    assert (said is not None) == strayed, said
    assert said is None or "m away from where it started" in said


def test_what_a_vehicle_says_cannot_move_a_cursor_or_begin_a_line() -> None:
    state, _ = guarded(470_000_000, 80_000_000)
    state.hear(Incoming(0.2, 1, 1, mav.Statustext(2, "PreArm: \x1b[2J\r\nERROR: all is well\u202e\x9b")))
    assert list(state.texts) == [r"PreArm: \x1b[2J\r\nERROR: all is well\u202e\x9b"]
    assert printable("Höhe 3 m, 20 °C") == "Höhe 3 m, 20 °C"


@pytest.mark.parametrize("odd", [float("inf"), float("-inf"), float("nan")])
def test_an_attitude_or_a_place_that_is_no_number_is_none(odd: float) -> None:
    state, guard = guarded(470_000_000, 80_000_000)
    told = (mav.Attitude(roll=0.1), mav.LocalPositionNed(x=3.0))
    for message in (*told, mav.Attitude(pitch=odd), mav.LocalPositionNed(z=odd)):
        state.hear(Incoming(0.1, 1, 1, message))
    assert (state.attitude, state.local) == told
    assert guard.check(0.1) is None


def test_a_place_off_the_globe_is_none() -> None:
    state, _ = guarded(470_000_000, 80_000_000)
    here = state.place
    for lat, lon in ((900_000_001, 0), (-2_147_483_648, 0), (0, 1_800_000_002), (0, -2_147_483_648)):
        state.hear(Incoming(0.1, 1, 1, mav.GlobalPositionInt(lat=lat, lon=lon)))
        assert state.place is here
    pole = mav.GlobalPositionInt(lat=-900_000_000, lon=1_800_000_000)
    state.hear(Incoming(0.1, 1, 1, pole))
    assert state.place is pole
