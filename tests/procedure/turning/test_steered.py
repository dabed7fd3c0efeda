"""Turning closed on the gyro, command by command: rates, boost, coasting, and what does not move."""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from typing import Any

import pytest

from mavcompass import messages as mav
from mavcompass.enums import MavFrame
from mavcompass.procedure.modes import PX4_OFFBOARD, ModeKeeper
from mavcompass.procedure.script import Context, Machine, Script, Send, Stop, Tick
from mavcompass.procedure.turning import GyroAngle
from mavcompass.procedure.turning.steered import SteeredTurn, TurnWay
from mavcompass.procedure.turning.ways.offboard import OffboardTurn, Setpoints
from mavcompass.procedure.vehicle_state import VehicleState

DEG = math.radians(1.0)
STEP_S = 0.05


@dataclass
class Vehicle:
    """Turn at a share of what was asked last, and coast for a while after it."""

    gyro: GyroAngle
    share: float = 1.0
    coasts_s: float = 0.0
    asked: list[tuple[float, float]] = field(default_factory=list)  # deg/s, degrees left
    did: list[str] = field(default_factory=list)
    wanted_radps: float = 0.0

    def turn(self, context: Context, rate_radps: float, left_rad: float) -> None:
        self.asked.append((math.degrees(rate_radps), math.degrees(left_rad)))
        self.wanted_radps = rate_radps

    def stand(self, context: Context) -> None:
        self.did.append("stand")
        self.wanted_radps = 0.0

    def let_go(self, context: Context) -> None:
        self.did.append("let go")

    def moves(self) -> None:
        self.gyro.angle_rad += STEP_S * self.share * self.wanted_radps
        self.gyro.rate_radps = self.share * self.wanted_radps


def turned(
    turn: SteeredTurn, vehicle: Vehicle, degrees: float, busy_s: float = 0.0
) -> tuple[bool | None, float, float]:
    """Turn once, our computer being busy at first; return whether it moved, how far, how long that took."""
    before = vehicle.gyro.angle_rad
    machine = Machine(lambda context: turn.turn(context, vehicle.gyro, degrees * DEG))
    for step in range(2000):
        machine.step(Tick(STEP_S * step + (busy_s if step else 0.0)))
        if machine.done:
            return machine.result, math.degrees(vehicle.gyro.angle_rad - before), STEP_S * step
        vehicle.moves()
    raise AssertionError("it hangs")


def steered(vehicle: Vehicle, arrives: bool = False, **way: float) -> SteeredTurn:
    return SteeredTurn(vehicle, TurnWay("a way", 40.0 * DEG, **way), arrives)


def test_time_in_which_our_computer_solved_is_not_the_vehicles() -> None:
    assert turned(steered(Vehicle(GyroAngle())), Vehicle(GyroAngle()), 90.0)[0] is False
    vehicle = Vehicle(GyroAngle())
    moved, degrees, _ = turned(steered(vehicle, coast_s=0.0), vehicle, 90.0, busy_s=8.0)
    assert moved and degrees == pytest.approx(90.0, abs=2.0)


@pytest.mark.parametrize("sense", [1.0, -1.0])
def test_the_rate_falls_toward_the_end(sense: float) -> None:
    vehicle = Vehicle(GyroAngle())
    moved, degrees, seconds = turned(steered(vehicle, coast_s=0.0), vehicle, sense * 90.0)
    assert moved and degrees == pytest.approx(sense * 90.0, abs=2.0)
    rates = [sense * rate for rate, _ in vehicle.asked]
    assert rates[0] == pytest.approx(40.0) and vehicle.asked[0][1] == pytest.approx(90.0)
    for rate, left in vehicle.asked:
        assert sense * rate == pytest.approx(min(40.0, max(15.0, left / 0.6)), rel=0.25)
    assert rates[-1] == pytest.approx(15.0) and sorted(rates, reverse=True)[-5:] == rates[-5:]
    # Ten commands a second, and two that ask for no turn.
    assert len(vehicle.asked) == pytest.approx(10.0 * seconds, abs=3) and vehicle.did == ["stand", "stand"]


@pytest.mark.parametrize(("degrees", "most_dps"), [(30.0, 30.0 / 4.1), (200.0, 40.0)])
def test_a_rate_grows_for_as_long_as_its_way_says_to_what_is_slowed_down_from_in_time(
    degrees: float, most_dps: float
) -> None:
    vehicle = Vehicle(GyroAngle())
    moved, *_ = turned(steered(vehicle, coast_s=0.0, speed_up_s=4.0, slow_down_s=2.0), vehicle, degrees)
    rates = [rate for rate, _ in vehicle.asked]
    assert moved and max(rates) == pytest.approx(most_dps, rel=0.08)
    assert rates[18] == pytest.approx(0.5 * most_dps, rel=0.1)  # after two seconds


def test_what_turns_too_slowly_once_it_has_gathered_way_is_asked_for_more_but_not_ever_more() -> None:
    vehicle = Vehicle(GyroAngle(), share=0.5)
    turned(steered(vehicle, coast_s=0.0), vehicle, 200.0)
    rates = [rate for rate, _ in vehicle.asked]
    assert max(rates[:5]) == pytest.approx(40.0) and max(rates[:30]) == pytest.approx(64.0) == max(rates)


@pytest.mark.parametrize(("coasts_deg", "driven_deg"), [(0.0, 88.5), (24.0, 90.0 - 1.6 * 40.0), (500.0, 2.0)])
def test_coasting_is_expected_and_then_learned_within_bounds(coasts_deg: float, driven_deg: float) -> None:
    vehicle = Vehicle(GyroAngle())
    turn = steered(vehicle)
    assert turned(turn, vehicle, 90.0)[1] == pytest.approx(90.0 - 0.3 * 15.0, abs=2.0)
    vehicle.gyro.angle_rad += coasts_deg * DEG
    assert turned(turn, vehicle, 90.0)[1] == pytest.approx(driven_deg, abs=3.0)


@pytest.mark.parametrize(("share", "moves"), [(0.0, False), (0.025, False), (0.05, True)])
def test_a_vehicle_that_has_not_turned_six_degrees_in_three_seconds_does_not_move(
    share: float, moves: bool
) -> None:
    vehicle = Vehicle(GyroAngle(), share=share)
    moved, degrees, seconds = turned(steered(vehicle), vehicle, 90.0)
    assert moved is moves
    if not moves:
        assert seconds == pytest.approx(3.05, abs=0.06)
        assert vehicle.did == ["stand", "stand", "let go", "let go"]
    else:
        assert seconds == pytest.approx(3.0 + 3.0 * 90.0 / 15.0, abs=0.1)  # then it is enough
        assert degrees < 90.0


@pytest.mark.parametrize(("rests_at_deg", "is_there"), [(60.0, True), (48.0, False)])
def test_what_arrives_by_itself_is_there_where_it_rests_beyond_most_of_the_way(
    rests_at_deg: float, is_there: bool
) -> None:
    class Resting(Vehicle):
        def moves(self) -> None:
            self.share = 0.0 if self.gyro.angle_rad >= rests_at_deg * DEG else 1.0
            super().moves()

    vehicle = Resting(GyroAngle())
    moved, degrees, seconds = turned(steered(vehicle, arrives=True), vehicle, 90.0)
    assert moved and degrees == pytest.approx(rests_at_deg, abs=2.0) and (seconds < 4.0) is is_there


def test_holding_asks_for_no_turn_and_halting_lets_go() -> None:
    vehicle = Vehicle(GyroAngle())
    turn = steered(vehicle, arrives=True)
    turn.hold(Context())
    assert vehicle.did == ["stand"]
    turn.halt(Context())
    assert vehicle.did[1:] == ["stand", "stand", "let go", "let go"]
    assert list(turn.release(Context())) == []


def test_what_holds_an_angle_is_halted_in_two_steps_while_it_turns() -> None:
    """Stopped dead it swings back; it turns on for a fifth of a second, at half the rate."""
    vehicle = Vehicle(GyroAngle())
    turn = steered(vehicle, arrives=True)
    machine = Machine(lambda context: turn.turn(context, vehicle.gyro, -90.0 * DEG))
    for step in range(30):
        machine.step(Tick(STEP_S * step))
        vehicle.moves()
    assert vehicle.asked[-1][0] == pytest.approx(-40.0) and not machine.done
    vehicle.asked.clear()
    turn.halt(machine.context)
    assert vehicle.did == ["stand", "stand"]
    assert vehicle.asked == [(pytest.approx(-20.0), pytest.approx(4.0))] * 2
    turn.halt(machine.context)  # it turns no more
    assert vehicle.did[2:] == ["stand", "stand", "let go", "let go"] and len(vehicle.asked) == 2


# --- the gyro's angle --------------------------------------------------------------------------------


def imu(
    time_s: float, deg_s: float, acc: tuple[int, int, int] = (0, 0, -1000), axis: str = "z"
) -> mav.Incoming:
    rate = {f"{axis}gyro": round(1000.0 * deg_s * DEG)}
    return mav.Incoming(
        time_s, 1, 1, mav.RawImu(time_usec=round(1e6 * time_s), xacc=acc[0], yacc=acc[1], zacc=acc[2], **rate)
    )


def test_the_angle_is_the_trapezoids_and_late_readings_change_nothing() -> None:
    gyro = GyroAngle()
    for time_s, deg_s in ((1.0, 0.0), (1.5, 10.0), (2.0, 10.0), (1.8, 99.0), (2.0, 99.0), (2.4, 0.0)):
        gyro.hear(imu(time_s, deg_s))
    assert math.degrees(gyro.angle_rad) == pytest.approx(2.5 + 5.0 + 2.0, rel=5e-3)
    assert gyro.samples == 4 and gyro.broken_s == -math.inf and gyro.latest_s == 2.4
    assert gyro.rate_radps == 0.0 and gyro.tilt_rad == 0.0


@pytest.mark.parametrize(("gap_s", "is_bridged"), [(0.99, True), (1.01, False)])
def test_a_silence_of_a_second_is_not_bridged(gap_s: float, is_bridged: bool) -> None:
    gyro = GyroAngle()
    for time_s in (1.0, 1.0 + gap_s):
        gyro.hear(imu(time_s, 20.0))
    assert math.degrees(gyro.angle_rad) == pytest.approx(20.0 * gap_s if is_bridged else 0.0, rel=5e-3)
    assert gyro.broken_s == (-math.inf if is_bridged else pytest.approx(1.0 + gap_s))


def test_one_kind_of_message_is_listened_to_and_the_bias_taken_out() -> None:
    gyro = GyroAngle()
    gyro.hear(imu(1.0, 0.0))
    gyro.hear(mav.Incoming(1.2, 1, 1, mav.ScaledImu(time_boot_ms=1200, zgyro=9000)))
    gyro.hear(mav.Incoming(1.2, 1, 1, mav.Heartbeat()))
    assert gyro.samples == 1
    gyro.note_rest(2.0 * DEG)
    gyro.hear(imu(1.5, 12.0))
    assert math.degrees(gyro.rate_radps) == pytest.approx(10.0, rel=5e-3)


def test_the_rate_is_about_the_vertical_of_what_leans() -> None:
    gyro = GyroAngle()
    for k in range(100):
        gyro.hear(imu(1.0 + 0.04 * k, 30.0, (0, -500, -866), "y"))
    assert math.degrees(gyro.rate_radps) == pytest.approx(15.0, rel=1e-2)
    assert math.degrees(gyro.tilt_rad) == pytest.approx(30.0, abs=0.3)
    # It follows within half a second, and not what falls.
    gyro.hear(imu(5.06, 0.0, (0, 0, -1000)))
    assert math.degrees(gyro.tilt_rad) == pytest.approx(30.0 * 0.8, abs=0.6)
    before = gyro.tilt_rad
    gyro.hear(imu(5.1, 0.0, (90, 0, 0)))
    assert gyro.tilt_rad == before
    gyro.hear(imu(5.2, 0.0, (110, 0, 0)))
    assert gyro.tilt_rad != before


# --- OFFBOARD ----------------------------------------------------------------------------------------


def state_of(
    mode: int, place: tuple[float, float, float] | None = (1.0, 2.0, -3.0), late_ms: int = 0
) -> VehicleState:
    state = VehicleState(heard_s=0.0)
    state.heartbeat = mav.Heartbeat(custom_mode=mode)
    if place is not None:
        state.local = mav.LocalPositionNed(time_boot_ms=5000, x=place[0], y=place[1], z=place[2])
        state.attitude = mav.Attitude(time_boot_ms=5000 + late_ms)
    return state


def targets(actions: list[Any]) -> list[mav.SetPositionTargetLocalNed]:
    sent = [a.message for a in actions if isinstance(a, Send)]
    return [m for m in sent if isinstance(m, mav.SetPositionTargetLocalNed)]


@pytest.mark.parametrize(
    ("state", "at_place"),
    [
        (state_of(7), True), (state_of(7, late_ms=1000), True), (state_of(7, late_ms=1001), False),
        (state_of(7, late_ms=-1001), False), (state_of(7, None), False),
    ],
)  # fmt: skip
def test_targets_stream_before_the_switch_and_ask_to_stay_at_the_place(
    state: VehicleState, at_place: bool
) -> None:
    turn = OffboardTurn(Setpoints(), TurnWay("w", 0.5), modes=ModeKeeper(state, "px4"))
    machine = Machine(lambda context: turn.turn(context, GyroAngle(), 1.0))
    seen: list[mav.SetPositionTargetLocalNed] = []
    asked_s = None
    for step in range(80):
        time_s = 0.02 * step
        state.heard_s = time_s
        actions = machine.step(Tick(time_s))
        seen += targets(actions)
        if asked_s is None and any(
            isinstance(a, Send) and isinstance(a.message, mav.CommandLong) for a in actions
        ):
            asked_s = time_s
    assert asked_s == pytest.approx(1.2, abs=0.03)
    assert len(seen) == pytest.approx(16, abs=1)  # ten a second
    for target in seen:
        if at_place:
            assert (target.x, target.y, target.z) == (1.0, 2.0, -3.0) and target.type_mask == 0x5F8
            assert target.coordinate_frame == MavFrame.LOCAL_NED
        else:
            assert (target.x, target.type_mask, target.coordinate_frame) == (0.0, 0x5C7, MavFrame.BODY_NED)
        assert target.yaw_rate == 0.0


def test_in_offboard_the_wish_is_streamed_and_a_halt_is_sent_at_once_twice() -> None:
    state = state_of(PX4_OFFBOARD)
    turn = OffboardTurn(Setpoints(), TurnWay("w", 0.5), modes=ModeKeeper(state, "px4"))
    context = Context(now=0.0)
    assert list(turn.release(context)) == []  # nothing was taken
    turn.halt(context)
    assert not context.outbox

    def script(context: Context) -> Script[bool]:
        return (yield from turn.turn(context, GyroAngle(), 1.0))

    machine = Machine(script)
    rates = []
    for step in range(100):
        state.heard_s = 0.02 * step
        rates += [t.yaw_rate for t in targets(machine.step(Tick(0.02 * step)))]
    assert rates[0] == 0.0 and pytest.approx(0.5) in rates and max(rates) <= 0.8
    turn.hold(machine.context)
    turn.halt(machine.context)
    assert [t.yaw_rate for t in targets(machine.context.outbox)] == [0.0, 0.0]
    assert len(machine.context.watches) == 1
    machine.step(Stop(2.0, "that is all"))
