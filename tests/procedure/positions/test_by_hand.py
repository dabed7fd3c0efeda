"""A person turns the vehicle: what the person reads, and what comes of it."""

from __future__ import annotations

import math
import re
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import pytest
from bent_vehicles import calibrated, commands, overheard

from mavcompass.enums import MavCmd
from mavcompass.messages import Incoming, Message
from mavcompass.procedure.report import CalibrationReport
from mavcompass.procedure.settings import CalibrateSettings
from mavcompass.simulation.heading_error import heading_error_rms_deg
from mavcompass.simulation.physics.hand import HandMove, four_turns
from mavcompass.simulation.vehicle import SimulatedAutopilot
from mavcompass.vehicle.link import Link
from mavcompass.vehicle.links.faults import Faults, FaultyLink
from mavcompass.vehicle.links.simulated import SimulatedLink

# Ten readings a second are as many as a compass has; the rest is told by all other tests.
BY_HAND = CalibrateSettings(motion="hand", writing="yes", rate_hz=10.0)


def disarmed(kind: str = "rover", seed: int = 1) -> SimulatedAutopilot:
    """Make a disarmed vehicle that knows its place."""
    vehicle = SimulatedAutopilot(kind, seed=seed, armed=False)
    vehicle.advance(10.0)
    return vehicle


def turns(*degrees: float, roll_deg: float = 0.0) -> list[HandMove]:
    """Stand a while, then turn and rest, again and again."""
    stand = HandMove(0.0, lasts_s=0.5, rests_s=6.0)
    return [stand, *(HandMove(math.radians(d), 3.0, 5.0, roll_rad=math.radians(roll_deg)) for d in degrees)]


def by_hand(
    vehicle: SimulatedAutopilot, moves: list[HandMove], folder: Path, link: Link | None = None
) -> tuple[CalibrationReport, list[str]]:
    shown: list[str] = []
    vehicle.turn_by_hand(moves)
    return calibrated(vehicle, folder, BY_HAND, link, shown), shown


def test_the_person_is_told_how_far_to_turn_and_how_long_to_hold_still(tmp_path: Path) -> None:
    vehicle = disarmed()
    heard = overheard(vehicle)
    report, shown = by_hand(vehicle, turns(90, 90, 90, 90), tmp_path)
    assert report.written and report.proof is not None and report.proof.passed
    assert heading_error_rms_deg(vehicle) < 0.5
    told = [int(m[1]) for text in shown if (m := re.fullmatch(r"Turn right (\d+) deg more\.", text))]
    assert told[0] == 90 and min(told) < 30
    assert "Hold still 2 s." in shown and "Hold still 1 s." in shown
    assert [text for text in shown if text.endswith("is taken.")][:4] == [
        f"Position {n} is taken." for n in (1, 2, 3, 4)
    ]
    # Nothing is commanded while a person turns it.
    kinds = {type(message).__name__ for message in heard}
    assert kinds <= {"Heartbeat", "CommandLong", "ParamRequestRead", "ParamSet"}
    assert not commands(heard) & {MavCmd.COMPONENT_ARM_DISARM, MavCmd.DO_SET_MODE, MavCmd.CONDITION_YAW}


@pytest.mark.parametrize(
    "degrees",
    [(-90, -90, -90, -90), (90, 180, -90, 90), (75, 105, 80, 90)],
    ids=["to the left", "across and back", "roughly"],
)
def test_positions_come_in_any_order_from_either_side(degrees: tuple[float, ...], tmp_path: Path) -> None:
    vehicle = disarmed(seed=3)
    report, shown = by_hand(vehicle, turns(*degrees), tmp_path)
    assert report.written
    assert heading_error_rms_deg(vehicle) < 0.5
    if max(degrees) < 0.0:
        assert any(re.fullmatch(r"Turn left \d+ deg more\.", text) for text in shown)


def test_a_tilted_vehicle_is_to_be_levelled_before_a_position_counts(tmp_path: Path) -> None:
    vehicle = disarmed()
    tilted = [
        HandMove(0.0, lasts_s=0.5, rests_s=6.0),
        HandMove(math.radians(90.0), 3.0, 3.0, roll_rad=math.radians(18.0)),
        HandMove(0.0, 1.0, 5.0),
        *turns(90, 90, 90)[1:],
    ]
    report, shown = by_hand(vehicle, tilted, tmp_path)
    assert report.written
    assert any(re.fullmatch(r"Tilted by 1[6-9] deg: level it\.", text) for text in shown)
    assert heading_error_rms_deg(vehicle) < 0.5


def test_a_slope_is_taken_as_it_is_after_a_while(tmp_path: Path) -> None:
    vehicle = SimulatedAutopilot("rover", seed=1, armed=False, tilt_deg=13.0)
    vehicle.advance(10.0)
    moves = [HandMove(0.0, 0.5, 22.0)] + [HandMove(math.radians(90.0), 3.0, 22.0)] * 4
    report, _ = by_hand(vehicle, moves, tmp_path)
    assert len(report.windows) == 4


class SlowRadio(Link):
    """Carry each kind of message four times a second at most, as a telemetry radio does."""

    def __init__(self, link: Link) -> None:
        super().__init__("radio", link.identity)
        self._link = link
        self._last_s: dict[type[Message], float] = {}
        self.send: Callable[[Message], None] = link.send  # type: ignore[method-assign]

    def now(self) -> float:
        return self._link.now()

    def send(self, message: Message) -> None:  # replaced by the wrapped link's own
        self._link.send(message)

    def receive(self, timeout_s: float) -> Incoming | None:
        end_s = self.now() + timeout_s
        while (heard := self._link.receive(max(end_s - self.now(), 0.0))) is not None:
            kind, answer = type(heard.message), hasattr(heard.message, "result")
            streamed = "Imu" in kind.__name__ or kind.__name__ in ("Attitude", "RcChannels")
            if answer or not streamed or heard.time_s - self._last_s.get(kind, -1.0) >= 0.24:
                self._last_s[kind] = heard.time_s
                return heard
        return None

    def close(self) -> None:
        self._link.close()


def test_a_radio_that_carries_four_messages_a_second_is_enough_and_its_sigma_says_so(tmp_path: Path) -> None:
    vehicle = disarmed()
    moves = [HandMove(0.0, 0.5, 7.0), *four_turns(1)]
    vehicle.turn_by_hand(moves)
    report = calibrated(vehicle, tmp_path, BY_HAND, SlowRadio(SimulatedLink(vehicle)))
    result = report.results[0]
    assert result.accepted, result.reasons
    error_deg = heading_error_rms_deg(vehicle, 1, result.correction)
    assert error_deg < 3.0 * result.heading_sigma_deg + 0.2
    assert error_deg < 1.0


def test_a_lossy_link_changes_nothing_but_the_sigma(tmp_path: Path) -> None:
    vehicle = disarmed(seed=2)
    # Every third message lost, a stretch that was not heard begins anew: a hand that waits longer.
    patient = [replace(move, rests_s=2.0 * move.rests_s) for move in four_turns(2)]
    vehicle.turn_by_hand([HandMove(0.0, 0.5, 25.0), *patient])
    link = FaultyLink(SimulatedLink(vehicle), Faults(loss=0.3, duplicate=0.05, reorder=0.1), seed=2)
    report = calibrated(vehicle, tmp_path, replace(BY_HAND, rate_hz=25.0), link)
    assert report.written
    assert heading_error_rms_deg(vehicle) < 0.7
