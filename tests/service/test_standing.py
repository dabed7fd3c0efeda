"""Iron that is put aboard while a vehicle stands: noticed before it is armed, and told from other changes."""

from __future__ import annotations

import math
from collections.abc import Callable

import pytest

from mavcompass import messages as mav
from mavcompass.enums import MavCmd
from mavcompass.heading.live import Heading
from mavcompass.messages import Incoming
from mavcompass.procedure.vehicle_state import VehicleIdentity
from mavcompass.service.config import WatchConfig
from mavcompass.service.standing import FieldStep
from mavcompass.service.view import VehicleView
from mavcompass.service.watch import CompassWatch
from mavcompass.simulation.vehicle import SimulatedAutopilot

DEG, STEP_S, LIMIT_DEG = math.pi / 180.0, 0.1, WatchConfig().step_deg
SECONDS = 65.0


def after(
    seconds: float,
    iron: Callable[[float], float],
    rate_dps: Callable[[float], float],
    bias_dps: float = 0.0,
    swing: Callable[[float], float] = lambda t: 0.0,
) -> FieldStep:
    """A compass in 200 mG whose vehicle is nudged round and has iron put aboard, forward, by the time.

    It swings beside that, by an angle that its gyro takes for a bias.
    """
    step, turned = FieldStep(), 0.4
    for k in range(round(seconds / STEP_S)):
        t, rate = k * STEP_S, rate_dps(k * STEP_S) * DEG
        turned += rate * STEP_S
        yaw, stands = turned + swing(t) * DEG, abs(rate) < 0.3 * DEG
        level = (200.0 * math.cos(yaw) + iron(t), -200.0 * math.sin(yaw), 400.0)
        seen = Heading(t, t, 1, 0.0, None, 0.01, level)
        step.add(seen, rate, bias_dps * DEG, stands, STEP_S, LIMIT_DEG)
    return step


def put_aboard(t: float) -> float:
    return 15.0 if t > 20.0 else 0.0


def test_iron_that_is_put_aboard_is_measured_though_the_vehicle_is_nudged_round() -> None:
    nudged = after(60.0, put_aboard, lambda t: 10.0 if 20.0 < t < 22.0 else 0.0)
    for seen in (after(60.0, put_aboard, lambda t: 0.0), nudged):
        assert seen.off_deg == pytest.approx(math.degrees(math.atan(15.0 / 214.0)), abs=0.3)


def test_what_turns_swings_or_warms_is_no_step() -> None:
    quiet = lambda t: 0.0  # noqa: E731
    assert after(60.0, put_aboard, lambda t: 20.0 if 40.0 < t < 45.0 else 0.0).off_deg < 0.1, "it has turned"
    assert after(120.0, quiet, lambda t: 20.0 if 40.0 < t < 44.5 else 0.0).off_deg < 0.1
    assert after(120.0, lambda t: 0.1 * t, lambda t: 0.0).off_deg < LIMIT_DEG
    assert after(120.0, quiet, lambda t: 0.28 * math.sin(0.1 * t)).off_deg < 0.1
    for dps in (-0.2, 0.2):
        hidden, swung = (after(60.0, quiet, quiet, bias, lambda t, dps=dps: dps * t) for bias in (0.2, 0.0))
        assert hidden.off_deg < 0.1 < swung.off_deg


def told(vehicle: SimulatedAutopilot, kind: str, seconds: float) -> dict[str, float]:
    """What the watch says of a vehicle that stands disarmed, and from when on."""
    view = VehicleView(VehicleIdentity(1, 1, "ardupilot", kind), kind, 2026.0)
    view.set_parameters(vehicle.firmware.store.values)
    watch, said = CompassWatch(WatchConfig()), {}
    for message, hz in ((mav.RawImu, 20), (mav.ScaledImu2, 10), (mav.Attitude, 10), (mav.GpsRawInt, 5)):
        number, every_us = float(mav.message_id(message)), 1e6 / hz
        vehicle.receive(mav.CommandLong(1, 1, MavCmd.SET_MESSAGE_INTERVAL, 0, number, every_us), 255, 190)
    start_s = vehicle.time_s
    for look in range(1, round(seconds / STEP_S)):
        for out in vehicle.advance(start_s + look * STEP_S):
            view.hear(Incoming(out.time_s, 1, 1, out.message))
        for finding in watch.update(view.glance(vehicle.time_s)):
            said.setdefault(f"{finding.id}{finding.instance}", look * STEP_S)
    return said


@pytest.mark.parametrize("kind", ["rover", "boat", "copter"])
def test_a_battery_that_is_swapped_is_noticed_before_arming(kind: str) -> None:
    step = f"hard_iron_step:x=9,y=6,z=0,on_s={(on_s := 40.0)}"
    vehicle = SimulatedAutopilot(kind, seed=6, armed=False, effects=(step,))
    said = told(vehicle, kind, SECONDS)
    assert list(said) == ["step1"] and on_s < said["step1"] + vehicle.time_s - SECONDS < on_s + 20.0
    assert told(SimulatedAutopilot(kind, seed=6, armed=False, calibration="exact"), kind, SECONDS) == {}
