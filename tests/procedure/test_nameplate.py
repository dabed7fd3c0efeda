"""Which vehicle this is, as a person reads it, and as the vehicle tells it."""

from __future__ import annotations

from typing import Any

import pytest

from mavcompass.enums import MavCmd, MavResult
from mavcompass.messages import AutopilotVersion, CommandAck, CommandLong, Incoming
from mavcompass.procedure.nameplate import Nameplate, read_nameplate, unique_id
from mavcompass.procedure.script import Machine, Send, Tick


@pytest.mark.parametrize(
    ("plate", "words", "key"),
    [
        (
            Nameplate("ardupilot", 1),
            "system 1, ardupilot of unknown version, board unknown, no unique id, compasses none",
            "ardupilot-system-1",
        ),
        (
            Nameplate("px4", 3, "0a1b", "38-26ac-32", "1.15.4", (0, 97_539, 0, 131_874)),
            "system 3, px4 1.15.4, board 38-26ac-32, unique id 0a1b, compasses 97539, 131874",
            "px4-0a1b",
        ),
        (
            Nameplate("ardupilot", 2, "0c", compasses=(0, 0, 0)),
            "system 2, ardupilot of unknown version, board unknown, unique id 0c, compasses none",
            "ardupilot-0c",
        ),
    ],
)
def test_a_nameplate_says_what_is_known_and_what_is_not(plate: Nameplate, words: str, key: str) -> None:
    assert (str(plate), plate.key) == (words, key)
    assert Nameplate.of_document(plate.document()) == plate


BOARD = {"board_version": 0x38, "vendor_id": 0x26AC, "product_id": 0x32}


@pytest.mark.parametrize(
    ("told", "uid", "board", "firmware"),
    [
        (AutopilotVersion(flight_sw_version=0x040603FF, uid=0xAB, **BOARD), "00000000000000ab", "38-26ac-32",
         "4.6.3"),
        (AutopilotVersion(flight_sw_version=0x010F0A40, uid2=(1, 255, *[0] * 16)), "01ff", "", "1.15.10"),
        (AutopilotVersion(product_id=0x32), "", "0-0-32", "0.0.0"),
    ],
)  # fmt: skip
def test_what_the_autopilot_tells_is_on_its_nameplate(
    told: AutopilotVersion, uid: str, board: str, firmware: str
) -> None:
    assert unique_id(told) == uid
    machine = Machine(lambda context: read_nameplate(context, "px4", (7,)))
    machine.step(Tick(0.0))
    machine.step(Incoming(0.1, 1, 1, told))
    machine.step(Tick(0.4))  # another one would have answered by now
    assert machine.result == Nameplate("px4", 0, uid, board, firmware, (7,))


def asked_of_one_that_answers(
    result: MavResult | None,
) -> tuple[Machine[Any], list[tuple[float, int, float]]]:
    """Ask one that never tells who it is, and acknowledges so, or not at all; what it was asked, and when."""
    machine = Machine(lambda context: read_nameplate(context, "ardupilot", (7,)))
    asked, waiting = list[tuple[float, int, float]](), list[int]()
    for tenth in range(100):
        number = waiting.pop() if waiting and result is not None else None
        ack = None if number is None else CommandAck(number, result or 0)
        for action in machine.step(Tick(0.1 * tenth) if ack is None else Incoming(0.1 * tenth, 0, 0, ack)):
            assert isinstance(action, Send) and isinstance(action.message, CommandLong)
            waiting.append(action.message.command)
            asked.append((round(0.1 * tenth, 1), action.message.command, action.message.param1))
    return machine, asked


ASK, OF_OLDER_FIRMWARE = (MavCmd.REQUEST_MESSAGE, 148.0), (MavCmd.REQUEST_AUTOPILOT_CAPABILITIES, 1.0)


@pytest.mark.parametrize(
    ("result", "at_s"),
    [
        (None, [0.0, 0.5, 1.0, 1.5, 2.0, 2.5, 3.0, 3.5]),
        (MavResult.ACCEPTED, [0.0, 0.5, 1.0, 1.5, 2.0, 2.5, 3.0, 3.5]),
        (MavResult.IN_PROGRESS, [0.0, 0.5, 1.0, 1.5, 2.0, 2.5, 3.0, 3.5]),
        (MavResult.TEMPORARILY_REJECTED, [0.0, 0.5, 1.0, 1.5, 2.0, 2.5, 3.0, 3.5]),
        (MavResult.UNSUPPORTED, [0.0, 0.1]),
        (MavResult.DENIED, [0.0, 0.1]),
    ],
)
def test_it_is_asked_in_either_way_eight_times_in_all_but_not_again_what_it_refuses(
    result: MavResult | None, at_s: list[float]
) -> None:
    machine, asked = asked_of_one_that_answers(result)
    both = [ASK, OF_OLDER_FIRMWARE] * 4
    assert [what for _, *what in asked] == [list(one) for one in both[: len(at_s)]]
    assert [when for when, *_ in asked] == pytest.approx(at_s, abs=0.11)
    assert machine.result == Nameplate("ardupilot", 0, compasses=(7,))
