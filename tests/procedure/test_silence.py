"""A vehicle's silence ends a motion; a sleep of our own computer does not."""

from __future__ import annotations

import numpy as np

from mavcompass.enums import MavAutopilot, MavModeFlag, MavState, MavType
from mavcompass.messages import Heartbeat, Incoming
from mavcompass.procedure.motion.safety import MotionGuard
from mavcompass.procedure.turning import GyroAngle
from mavcompass.procedure.vehicle_state import VehicleState

ARMED = Heartbeat(
    MavType.GROUND_ROVER, MavAutopilot.ARDUPILOTMEGA, MavModeFlag.SAFETY_ARMED, 0, MavState.ACTIVE
)


def guard_at(time_s: float) -> MotionGuard:
    state = VehicleState()
    state.hear(Incoming(time_s, 1, 1, ARMED))
    guard = MotionGuard(state, GyroAngle(), "rover")
    guard.begin()
    return guard


def test_silence_while_listening_ends_the_motion() -> None:
    guard = guard_at(10.0)
    said = [guard.check(float(now_s)) for now_s in np.arange(10.0, 12.5, 0.05)]
    assert said[: int(1.9 / 0.05)] == [None] * int(1.9 / 0.05)
    assert said[-1] is not None and "fell silent" in said[-1]


def test_a_sleep_of_our_own_is_no_silence_of_the_vehicle() -> None:
    guard = guard_at(10.0)
    assert guard.check(10.0) is None
    assert guard.check(15.0) is None, "the computer was busy for five seconds"
    guard.state.hear(Incoming(15.01, 1, 1, ARMED))
    assert guard.check(15.01) is None
