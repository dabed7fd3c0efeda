"""Positions one after the other: how long it stands, where it turns to, and what if nothing moves."""

from __future__ import annotations

import math
import random
from collections.abc import Callable
from dataclasses import dataclass, field

import pytest

from mavcompass import messages as mav
from mavcompass.errors import LinkLost, Refused
from mavcompass.procedure.positions import DwellSettings, Mover, Rest, VehicleMover, Window, dwell, visit
from mavcompass.procedure.positions.visiting import _next_turn
from mavcompass.procedure.script import Context, Machine, Script, Show, Tick, nothing
from mavcompass.procedure.turning import GyroAngle

STEP_S = 0.04
DEG = math.radians(1.0)


def imu(time_s: float, yaw_rate_deg_s: float = 0.0, jitter: int = 0) -> mav.Incoming:
    message = mav.RawImu(
        time_usec=round(time_s * 1e6),
        zacc=-1000 + jitter,
        zgyro=round(1000.0 * yaw_rate_deg_s * DEG),
        xmag=200,
        zmag=400,
    )
    return mav.Incoming(time_s, 1, 1, message)


@dataclass
class Obedient(Mover):
    """Wait for rest; turn the gyro's angle as far as is asked for, times a share."""

    share: float = 1.0
    resting: bool = True
    refused: int = 0
    done: list[str] = field(default_factory=list)
    turns_deg: list[float] = field(default_factory=list)
    held: list[float] = field(default_factory=list)

    def next(self, context: Context, angle_rad: float, remaining: int) -> Script[None]:
        self.turns_deg.append(math.degrees(angle_rad))
        self.done.append(f"turn, {remaining} left")
        self.gyro.angle_rad += self.share * angle_rad
        yield from nothing(None)

    def settle(self, context: Context, settings: DwellSettings) -> Script[bool]:
        while self.resting and self.rest.for_s() < settings.settle_s:
            yield context.now + STEP_S
        return self.resting

    def hold(self, context: Context, left_s: float) -> None:
        self.held.append(left_s)

    def accept(self, context: Context, turned_rad: float) -> bool:
        self.refused -= 1
        return self.refused < 0


def dwelt(
    settings: DwellSettings | None = None,
    sureness: Callable[[float, float], float] | None = None,
    heard: Callable[[float], mav.Incoming | None] = imu,
    resting: bool = True,
) -> tuple[float, Obedient, GyroAngle]:
    """Dwell once; return how long it took, by the vehicle's clock."""
    rest, gyro = Rest(), GyroAngle()
    mover = Obedient(gyro, rest, resting=resting)

    def script(context: Context) -> Script[Window]:
        context.listeners += [rest.hear, gyro.hear]
        while rest.for_s() < 0.5:
            yield context.now + 0.02
        return (yield from dwell(context, mover, settings or DwellSettings(), sureness))

    machine = Machine(script)
    for step in range(1500):
        time_s = 1.0 + STEP_S * step
        machine.step(heard(time_s) or Tick(time_s))
        if machine.done:
            break
    if machine.error is not None:
        raise machine.error
    assert machine.result is not None
    return machine.result.end_s - machine.result.start_s, mover, gyro


def test_a_dwell_ends_as_soon_as_the_heading_is_sure_enough() -> None:
    assert dwelt(sureness=lambda a, b: 0.15)[0] == pytest.approx(0.92, abs=0.09)
    assert dwelt(sureness=lambda a, b: 0.16)[0] == pytest.approx(1.4, abs=0.13)  # no surer than at half
    asked = list[float]()
    surer = lambda a, b: asked.append(b - a) or 0.3 / (b - a)  # type: ignore[func-returns-value]  # noqa: E731
    assert dwelt(sureness=surer)[0] == pytest.approx(1.7, abs=0.09)
    assert asked[:3] == pytest.approx([0.6, 0.92, 1.06], abs=0.09)  # no sooner than it may end
    assert dwelt(DwellSettings(shortest_s=1.2), lambda a, b: 0.1)[0] == pytest.approx(1.2, abs=0.09)
    # What is not at rest is not asked.
    assert dwelt(sureness=lambda a, b: 0.0, resting=False)[0] == pytest.approx(1.7, abs=0.09)


def test_twice_a_second_the_mover_is_told_how_much_longer_to_hold_it() -> None:
    _, mover, _ = dwelt()
    assert mover.held == pytest.approx([1.1, 0.6, 0.1], abs=0.12)


def test_noisy_sensors_are_stood_still_for_longer() -> None:
    def noisy() -> Callable[[float], mav.Incoming]:
        chance = random.Random(7)
        return lambda time_s: imu(time_s, jitter=round(chance.gauss(0.0, 150.0)))

    length_s, _, _ = dwelt(heard=noisy())
    assert 3.0 < length_s <= 6.1
    assert dwelt(DwellSettings(longest_s=2.6), heard=noisy())[0] == pytest.approx(2.6, abs=0.1)
    # There halves are not compared: noise goes on averaging out.
    assert dwelt(sureness=lambda a, b: 0.16, heard=noisy())[0] == pytest.approx(length_s, abs=0.1)


@pytest.mark.parametrize(("interval_s", "length_s"), [(0.04, 1.7), (0.28, 2.25), (0.48, 3.85), (1.0, 6.0)])
def test_a_dwell_is_measured_in_readings_too(interval_s: float, length_s: float) -> None:
    """Eight of them, and no more than six seconds."""
    slow = [-math.inf]

    def heard(time_s: float) -> mav.Incoming | None:
        if time_s - slow[0] < interval_s - 0.01:
            return None
        slow[0] = time_s
        return imu(time_s)

    assert dwelt(heard=heard)[0] == pytest.approx(length_s, abs=0.12 + 0.1 * interval_s)


@pytest.mark.parametrize(
    ("interval_s", "until_s", "length_s"), [(0.47, 4.6, 1.92), (0.59, 5.6, 3.0), (0.59, 6.2, 3.6)]
)
def test_who_moves_before_the_last_reading_is_dwelt_upon_for_as_long_as_it_stood(
    interval_s: float, until_s: float, length_s: float
) -> None:
    said = [-math.inf]

    def heard(time_s: float) -> mav.Incoming | None:
        if time_s - said[0] < interval_s:
            return None
        said[0] = time_s
        return imu(time_s, 0.0 if time_s < until_s else 40.0)

    assert dwelt(heard=heard)[0] == pytest.approx(length_s)


def test_a_dwell_that_is_disturbed_begins_anew_twice() -> None:
    def bumped(*at: float) -> Callable[[float], mav.Incoming]:
        return lambda t: imu(t, 60.0 if any(abs(t - a) < 0.3 for a in at) else 0.0)

    assert dwelt(heard=bumped(2.5))[0] == pytest.approx(1.7, abs=0.1)
    # After the third it is taken as it is.
    assert dwelt(heard=bumped(2.5, 4.5, 6.5))[0] < 1.5


def test_a_silence_ends_a_dwell_with_words() -> None:
    with pytest.raises(LinkLost, match="stopped coming"):
        dwelt(heard=lambda t: imu(t) if t < 2.4 else None)


def test_what_the_gyro_shows_at_rest_is_its_bias() -> None:
    _, _, gyro = dwelt(heard=lambda t: imu(t, 0.573))
    assert gyro.bias_radps == pytest.approx(0.01, rel=0.01)


def test_rest_is_told_by_the_imu_and_begins_anew_after_a_restart() -> None:
    rest = Rest()
    assert rest.for_s() == 0.0 and rest.why_not == "nothing was heard yet"
    for k in range(100):
        rest.hear(imu(10.0 + STEP_S * k))
        rest.hear(mav.Incoming(11.0, 1, 1, mav.Heartbeat()))
        rest.hear(mav.Incoming(11.0, 1, 1, mav.ScaledImu2(time_boot_ms=99000)))
    assert rest.time_s == pytest.approx(13.96) and rest.for_s() == pytest.approx(3.9, abs=0.2)
    since_s = rest.still_since_s
    rest.hear(imu(9.0))  # late: nothing changes
    assert rest.time_s == pytest.approx(13.96) and rest.still_since_s == since_s
    rest.hear(imu(8.9))  # more than five seconds back: another clock
    assert rest.time_s == 8.9 and rest.for_s() == 0.0
    assert rest.heard_s == 8.9


def visited(mover: Mover, count: int = 4, step_deg: float = 90.0, seen: tuple[Window, ...] = ()) -> list[str]:
    rest = mover.rest

    def at_each() -> Script[None]:
        mover.done.append("at each")
        yield from nothing(None)

    def script(context: Context) -> Script[list[Window]]:
        context.listeners.append(rest.hear)
        while rest.for_s() < 0.5:
            yield context.now + 0.02
        settings = DwellSettings(dwell_s=0.3)
        step_rad = math.radians(step_deg)
        return (yield from visit(context, mover, count, step_rad, settings, seen, at_each))

    machine, shown = Machine(script), list[str]()
    for step in range(1500):
        for action in machine.step(imu(1.0 + STEP_S * step)):
            if isinstance(action, Show):
                share = f"{action.fraction:.2f}" if action.fraction is not None else "-"
                shown.append(f"{action.step} {share}: {action.text}")
        if machine.done:
            break
    assert machine.result is not None
    shown.append(str(len(machine.result)))
    return shown


def test_four_positions_are_visited_with_three_turns() -> None:
    mover = Obedient(GyroAngle(), Rest())
    shown = visited(mover)
    assert mover.turns_deg == pytest.approx([90.0] * 3)
    assert mover.done == [
        "at each", "turn, 3 left", "at each", "turn, 2 left", "at each", "turn, 1 left",
    ]  # fmt: skip
    assert shown == [
        "dwell 0.00: Position 1 of 4: measuring.",
        "turn 0.10: Turning to position 2 of 4.",
        "dwell 0.20: Position 2 of 4: measuring.",
        "turn 0.30: Turning to position 3 of 4.",
        "dwell 0.40: Position 3 of 4: measuring.",
        "turn 0.50: Turning to position 4 of 4.",
        "dwell 0.60: Position 4 of 4: measuring.",
        "4",
    ]


def test_a_position_that_does_not_count_is_visited_again() -> None:
    mover = Obedient(GyroAngle(), Rest(), refused=1)
    assert visited(mover, 2)[-1] == "2" and len(mover.turns_deg) == 1


def test_a_fifth_position_lies_half_a_step_between() -> None:
    mover = Obedient(GyroAngle(angle_rad=270.0 * DEG), Rest())
    seen = tuple(Window(10.0 * k, 10.0 * k + 2.0, 90.0 * k * DEG) for k in range(4))
    shown = visited(mover, 4, 90.0, seen)
    assert shown[-1] == "5" and mover.turns_deg == pytest.approx([45.0])
    assert mover.done == ["at each", "turn, 1 left"]


@pytest.mark.parametrize(
    ("visited_deg", "now_deg", "turn_deg"),
    [([0.0], 0.0, 90.0), ([0.0, 100.0], 100.0, 80.0), ([0.0, 80.0], 80.0, 100.0),
     ([0.0, 200.0], 200.0, 45.0), ([0.0, 5.0], 5.0, 135.0), ([10.0], 20.0, 80.0),
     ([0.0, 90.0, 180.0, 270.0], 270.0, 45.0), ([0.0, 90.0, 180.0, 270.0, 315.0], 315.0, 90.0)],
)  # fmt: skip
def test_what_went_too_far_is_made_up(visited_deg: list[float], now_deg: float, turn_deg: float) -> None:
    windows = [Window(0.0, 1.0, d * DEG) for d in visited_deg]
    for sense in (1.0, -1.0):
        mirrored = [Window(0.0, 1.0, sense * w.turned_rad) for w in windows]
        turn = _next_turn(GyroAngle(angle_rad=sense * now_deg * DEG), mirrored, 4, sense * 90.0 * DEG)
        assert math.degrees(turn) == pytest.approx(sense * turn_deg)


@dataclass
class Way:
    """Be a way to turn that moves the vehicle, or does not."""

    name: str
    moves: bool
    did: list[str]
    meanwhile: Callable[[], None] = lambda: None

    @property
    def way(self) -> Way:
        return self

    def turn(self, context: Context, gyro: GyroAngle, angle_rad: float) -> Script[bool]:
        self.did.append(f"{self.name} turns")
        self.meanwhile()
        yield from nothing(None)
        return self.moves

    def hold(self, context: Context) -> None:
        self.did.append(f"{self.name} holds")

    def halt(self, context: Context) -> None:
        self.did.append(f"{self.name} halts")

    def release(self, context: Context) -> Script[None]:
        self.did.append(f"{self.name} releases")
        yield from nothing(None)


def ended(script: Script[None]) -> None:
    for _ in script:
        pass


def test_a_way_that_does_not_move_is_left_and_what_was_used_is_halted_once() -> None:
    did: list[str] = []
    mover = VehicleMover(
        GyroAngle(), Rest(), [Way("first", False, did), Way("second", True, did), Way("third", True, did)]
    )
    context = Context(heard_s=0.0)
    mover.hold(context, 1.0)
    mover.halt(context)
    ended(mover.release(context))
    assert not did  # nothing was taken
    ended(mover.next(context, 1.0, 3))
    assert did == ["first turns", "second turns"] and mover.accept(context, 0.0)
    assert [a.text for a in context.outbox if isinstance(a, Show)] == [
        "first did not move the vehicle; trying second."
    ]
    mover.hold(context, 1.0)
    mover.halt(context)
    mover.halt(context)
    ended(mover.release(context))
    assert did[2:] == ["second holds", "first halts", "second halts", "first releases", "second releases"]
    ended(mover.next(context, 1.0, 2))
    assert did[7:] == ["second turns"]  # the first is not tried again
    context.now = 1.0  # silent for so long it may not hear: it is told again when it speaks, and no more
    for context.heard_s in (0.0, 1.0, 1.0):
        mover.halt(context)
    assert did[8:] == 2 * ["first halts", "second halts"]


def test_where_no_way_moves_the_vehicle_it_is_refused() -> None:
    did: list[str] = []
    mover = VehicleMover(GyroAngle(), Rest(), [Way("first", False, did)])
    with pytest.raises(Refused, match="the gyro saw no turn"):
        ended(mover.next(Context(), 1.0, 3))
    mover.hold(Context(), 1.0)
    mover.halt(Context())
    assert did == ["first turns", "first halts"]


def test_what_turns_the_wrong_way_round_is_not_turned_by_other_means() -> None:
    did: list[str] = []
    gyro = GyroAngle()
    first = Way("first", False, did, lambda: setattr(gyro, "angle_rad", gyro.angle_rad + 0.5))
    with pytest.raises(
        Refused, match=r"turned 29 deg the wrong way round\. With its heading more than 90 deg"
    ):
        ended(VehicleMover(gyro, Rest(), [first, Way("second", True, did)]).next(Context(), -1.0, 3))
    assert did == ["first turns"]
