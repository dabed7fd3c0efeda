"""Every way to turn a vehicle, on simulated vehicles: the gyro counts, the truth judges."""

from __future__ import annotations

import math
from dataclasses import dataclass

import pytest
from bent_vehicles import bent_vehicle, perform

from mavcompass import messages as mav
from mavcompass.errors import Refused
from mavcompass.procedure.commands import MessageRates
from mavcompass.procedure.modes import PX4_OFFBOARD, ModeKeeper
from mavcompass.procedure.positions import VehicleMover
from mavcompass.procedure.script import Context, Script, pause
from mavcompass.procedure.turning import GyroAngle, SteeredTurn, TurnBy, strategies_for
from mavcompass.procedure.turning.ways.offboard import OffboardTurn
from mavcompass.procedure.vehicle_state import VehicleState
from mavcompass.simulation.vehicle import SimulatedAutopilot
from mavcompass.vehicle.link import GROUND_STATION, ONBOARD_COMPUTER

# Each way of each, to either side in turn.
WAYS = [
    (kind, index, 90.0 if index % 2 else -90.0)
    for kind, ways in (("rover", 3), ("boat", 3), ("copter", 2), ("sub", 2))
    for index in range(ways)
]


@dataclass
class Turned:
    moved: bool
    by_gyro_deg: float
    truly_deg: float


def turn(
    vehicle: SimulatedAutopilot,
    strategy: SteeredTurn,
    angle_deg: float,
    by: TurnBy = "auto",
) -> Turned:
    """Turn once and wait for rest."""
    gyro = GyroAngle()
    yaw_rad = [vehicle.body.yaw_rad]

    def script(context: Context, state: VehicleState) -> Script[Turned]:
        px4 = vehicle.profile.firmware == "px4"
        yield from MessageRates().ask(context, {mav.ScaledImu if px4 else mav.RawImu: 25.0})
        if isinstance(strategy, OffboardTurn):
            strategy.modes = ModeKeeper(state, "px4")
            strategy.modes.accept_present()
        start_rad = gyro.angle_rad
        yaw_rad[0] = vehicle.body.yaw_rad
        moved = yield from strategy.turn(context, gyro, math.radians(angle_deg))
        yield from pause(context, 3.0)
        truly = math.remainder(vehicle.body.yaw_rad - yaw_rad[0], 2.0 * math.pi)
        strategy.halt(context)
        yield from strategy.release(context)
        return Turned(moved, math.degrees(gyro.angle_rad - start_rad), math.degrees(truly))

    identity = ONBOARD_COMPUTER if by == "auto" else GROUND_STATION
    return perform(vehicle, script, (gyro.hear,), identity)


@pytest.mark.parametrize(("kind", "index", "angle_deg"), WAYS)
def test_each_way_turns_its_vehicle_about_as_far_as_asked(kind: str, index: int, angle_deg: float) -> None:
    strategy = strategies_for(kind, "ardupilot")[index]
    turned = turn(bent_vehicle(kind, seed=1, share=0.6), strategy, angle_deg)
    assert turned.moved
    assert turned.truly_deg == pytest.approx(angle_deg, abs=35.0)
    assert turned.by_gyro_deg == pytest.approx(turned.truly_deg, abs=4.0)


def test_steered_wheels_turn_on_an_arc_and_stop() -> None:
    vehicle = bent_vehicle("ackermann-rover", seed=1)
    turned = turn(vehicle, strategies_for("rover", "ardupilot", ackermann=True)[0], 90.0)
    assert turned.moved and turned.truly_deg == pytest.approx(90.0, abs=15.0)
    assert 1.0 < math.hypot(vehicle.body.north_m, vehicle.body.east_m) < 6.0
    assert abs(vehicle.body.speed_mps) < 0.05


def test_px4_turns_in_offboard_and_gets_its_mode_back() -> None:
    vehicle = bent_vehicle("px4-copter", seed=1)
    before = vehicle.firmware.reports.heartbeat().custom_mode
    seen: set[int] = set()
    strategy = strategies_for("copter", "px4")[0]
    setpoints = vehicle.firmware.flight.setpoints  # type: ignore[attr-defined]
    heard = setpoints.heard

    def witness() -> None:
        seen.add(vehicle.firmware.reports.heartbeat().custom_mode)
        heard()

    setpoints.heard = witness
    turned = turn(vehicle, strategy, 90.0)
    assert turned.moved and turned.truly_deg == pytest.approx(90.0, abs=25.0)
    # Setpoints flowed before the switch and in it, and the mode is the old one again.
    assert {before, PX4_OFFBOARD} <= seen
    assert vehicle.firmware.reports.heartbeat().custom_mode == before


@pytest.mark.parametrize("by", ["rc-override", "manual-control"])
@pytest.mark.parametrize("name", ["rover", "boat"])
def test_the_pilots_controls_turn_a_vehicle_in_manual(name: str, by: TurnBy) -> None:
    vehicle = bent_vehicle(name, seed=2)
    vehicle.pilot_switches_mode("MANUAL")
    turned = turn(vehicle, strategies_for(name, "ardupilot", by=by)[0], 90.0, by)
    assert turned.moved and turned.truly_deg == pytest.approx(90.0, abs=35.0)
    radio = vehicle.firmware.radio  # type: ignore[attr-defined]
    vehicle.advance(vehicle.time_s + 4.0)
    assert radio.channel(1, vehicle.board.boot_time_s) == 1500


def test_a_heading_target_ends_by_itself_when_the_link_dies() -> None:
    vehicle = bent_vehicle("rover", seed=1)
    gyro = GyroAngle()

    def script(context: Context, state: VehicleState) -> Script[float]:
        yield from MessageRates().ask(context, {mav.RawImu: 25.0})
        turning = strategies_for("rover", "ardupilot")[0].turn(context, gyro, math.radians(170.0))
        end_s = context.now + 2.0
        wake_s = next(turning)
        while context.now < end_s:
            wake_s = turning.send((yield wake_s))
        return abs(vehicle.body.yaw_rate_radps)

    assert perform(vehicle, script, (gyro.hear,)) > math.radians(20.0)
    vehicle.advance(vehicle.time_s + 1.0)
    assert abs(vehicle.body.yaw_rate_radps) < math.radians(5.0)


def test_a_vehicle_that_nothing_moves_is_told_as_such() -> None:
    vehicle = bent_vehicle("rover", seed=1)
    vehicle.jam()
    gyro = GyroAngle()

    def script(context: Context, state: VehicleState) -> Script[None]:
        yield from MessageRates().ask(context, {mav.RawImu: 25.0})
        mover = VehicleMover(gyro, strategies_for("rover", "ardupilot"))
        yield from mover.next(context, math.radians(90.0), 1)

    with pytest.raises(Refused, match="the gyro saw no turn"):
        perform(vehicle, script, (gyro.hear,))


@pytest.mark.parametrize(
    ("kind", "autopilot"), [("plane", "ardupilot"), ("unknown", "ardupilot"), ("rover", "px4")]
)
def test_what_nobody_knows_how_to_turn_is_left_to_a_person(kind: str, autopilot: str) -> None:
    assert strategies_for(kind, autopilot) == ()
