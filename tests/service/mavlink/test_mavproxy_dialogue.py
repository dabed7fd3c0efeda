"""What the MAVProxy module makes of the lines that a person types, in virtual time."""

from __future__ import annotations

import os
import time
from collections.abc import Iterator
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest

from mavcompass import messages as mav
from mavcompass.errors import Refused
from mavcompass.procedure.script import Answer, Ask, Context, Script
from mavcompass.simulation.heading_error import heading_error_rms_deg
from mavcompass.simulation.vehicle import SimulatedAutopilot
from mavcompass.vehicle.link import LinkStatistics
from mavcompass.vehicle.links.simulated import SimulatedLink
from mavcompass.vehicle.wire import FrameParser, FrameWriter, decode

pytest.importorskip("MAVProxy")
from pymavlink.dialects.v20 import ardupilotmega

from mavcompass.service import mavproxy

STATION = (255, 230)
STREAM_RATES = (4, -7)


class Console:
    """MAVProxy's window, for the lines written to it."""

    def __init__(self) -> None:
        self.lines: list[str] = []

    def writeln(self, text: str) -> None:
        self.lines.append(text)


class ToVehicle:
    """What pymavlink writes to: its bytes reach the vehicle."""

    def __init__(self, link: SimulatedLink) -> None:
        self._link, self._parser = link, FrameParser(LinkStatistics())

    def write(self, data: bytes) -> None:
        for frame in self._parser.feed(data):
            message = decode(frame.message_id, frame.payload)
            assert message is not None
            self._link.send(message)


class Ground:
    """A ground station with the module loaded; `pass_time` is MAVProxy's main loop."""

    def __init__(self, autopilot: SimulatedAutopilot) -> None:
        self.link = SimulatedLink(autopilot, "sim:rover")
        self.console = Console()
        mav = ardupilotmega.MAVLink(ToVehicle(self.link), *STATION)
        self._reads, self.writer = ardupilotmega.MAVLink(None), FrameWriter()
        self.settings = SimpleNamespace(
            target_system=1, streamrate=STREAM_RATES[0], streamrate2=STREAM_RATES[1]
        )
        self.state: Any = SimpleNamespace(
            public_modules={},
            command_map={},
            completions={},
            console=self.console,
            settings=self.settings,
            master=lambda: SimpleNamespace(mav=mav),
        )
        self.module = mavproxy.init(self.state)

    def type(self, line: str) -> None:
        """Type a line of which MAVProxy takes the first word."""
        command, *words = line.split()
        self.state.command_map[command][0](words)

    def pass_time(self, seconds: float, until: str = "\0") -> None:
        """Pass on all that the vehicle says for so long, or until the module says something."""
        end_s = self.link.now() + seconds
        while self.link.now() < end_s and not self.said(until):
            heard = self.link.receive(0.05)
            if heard is not None:
                raw = self.writer.write(heard.message, heard.system, heard.component)
                for packet in self._reads.parse_buffer(raw) or ():
                    self.module.mavlink_packet(packet)
            self.module.idle_task()

    def said(self, words: str) -> bool:
        """Tell whether these words stand in any line."""
        return any(words in line for line in self.console.lines)


@pytest.fixture
def ground(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> Iterator[Ground]:
    monkeypatch.setenv("MAVCOMPASS_UNDO_DIR", str(tmp_path))
    vehicle = SimulatedAutopilot("rover", seed=3)
    vehicle.moor(str(os.getpid()))
    station = Ground(vehicle)
    clock: Any = SimpleNamespace(monotonic=station.link.now, gmtime=time.gmtime)
    monkeypatch.setattr(mavproxy, "time", clock)
    yield station
    station.module.unload()


def test_a_calibration_asks_before_it_writes_and_keeps_the_streams_meanwhile(ground: Ground) -> None:
    before_deg = heading_error_rms_deg(ground.link.autopilot)
    ground.type("mavcompass calibrate vehicle")
    assert (ground.settings.streamrate, ground.settings.streamrate2) == (-1, -1)
    ground.pass_time(300.0, until="mavcompass yes, or mavcompass no")
    assert heading_error_rms_deg(ground.link.autopilot) == pytest.approx(before_deg, abs=1.0)
    ground.type("mavcompass yes")
    ground.pass_time(300.0, until="calibrated, written and read back")
    assert ground.said("calibrated, written and read back"), ground.console.lines
    assert heading_error_rms_deg(ground.link.autopilot) < 1.0 < before_deg
    assert (ground.settings.streamrate, ground.settings.streamrate2) == STREAM_RATES
    document = ground.module.document
    assert document is not None and document["written"] is True


def test_a_check_names_what_does_not_pass_and_sums_up_in_mavlink_1_too(ground: Ground) -> None:
    ground.writer = FrameWriter(1)
    ground.type("mavcompass check")
    ground.type("mavcompass status")
    assert ground.console.lines[-1] == "mavcompass: running"
    ground.pass_time(120.0, until="Not fit to ")
    document = ground.module.document
    assert document is not None and document["verdict"] == "fail"
    bad = [item["text"] for item in document["items"] if item["verdict"] != "pass"]
    good = [item["text"] for item in document["items"] if item["verdict"] == "pass"]
    assert bad and all(ground.said(text) for text in bad)
    assert good and not any(ground.said(text) for text in good)
    ground.type("mavcompass status")
    assert ground.console.lines[-1] == "mavcompass: idle"


@pytest.mark.parametrize(
    "line",
    ["mavcompass", "mavcompass calibrate sideways", "mavcompass check write", "mavcompass yes",
     "mavcompass stop"],
)  # fmt: skip
def test_what_makes_no_sense_now_is_answered_by_the_usage(line: str, ground: Ground) -> None:
    ground.type(line)
    assert ground.console.lines == [f"mavcompass: {mavproxy._USAGE}"]


def test_one_thing_at_a_time_and_a_stop_ends_it_with_its_reason(ground: Ground) -> None:
    ground.type("mavcompass calibrate")
    ground.pass_time(2.0)
    ground.type("mavcompass check")
    assert ground.said("something is under way; mavcompass stop ends it")
    ground.type("mavcompass stop")
    ground.pass_time(30.0, until="Stopped from MAVProxy.")
    assert ground.said("Stopped from MAVProxy.")
    ground.pass_time(30.0)
    ground.type("mavcompass status")
    assert ground.console.lines[-1] == "mavcompass: idle"
    assert ground.settings.streamrate == STREAM_RATES[0]


@pytest.mark.parametrize("answer", ["yes", "no"])
def test_an_answer_reaches_the_procedure_once(
    answer: str, ground: Ground, monkeypatch: pytest.MonkeyPatch
) -> None:
    def asking(context: Context, *_: object) -> Script[Any]:
        context.outbox.append(Ask("Go on?"))
        while not isinstance(event := (yield context.now + 1.0), Answer):
            pass
        raise Refused(f"The answer was {event.yes}.")

    monkeypatch.setattr(mavproxy, "check", asking)
    ground.type("mavcompass check turn")
    ground.pass_time(0.2)
    ground.type(f"mavcompass {answer}")
    ground.type(f"mavcompass {answer}")
    assert ground.console.lines == [
        "mavcompass: Go on?\nmavcompass yes, or mavcompass no",
        f"mavcompass: The answer was {answer == 'yes'}.",
        f"mavcompass: {mavproxy._USAGE}",
    ]


def test_unloading_stops_what_is_under_way_and_takes_the_command_away(
    ground: Ground, monkeypatch: pytest.MonkeyPatch
) -> None:
    ground.type("mavcompass calibrate")
    ground.pass_time(60.0, until="Turning")
    sent = list[mav.Message]()
    monkeypatch.setattr(ground.link, "send", sent.append)
    ground.module.unload()
    assert sent and ground.state.command_map == {}  # what turns is told to stand
    assert (ground.settings.streamrate, ground.settings.streamrate2) == STREAM_RATES
    ground.module.unload()  # once more harms nothing
    ground.module._step(mavproxy.Tick(ground.link.now()))


def test_noise_on_the_link_and_an_unexpected_error_do_not_end_mavproxy(
    ground: Ground, monkeypatch: pytest.MonkeyPatch
) -> None:
    def broken(*_: object) -> Any:
        raise ZeroDivisionError("by zero")
        yield

    monkeypatch.setattr(mavproxy, "check", broken)
    ground.type("mavcompass check")
    for noise in (b"", b"GARBAGE"):
        ground.module.mavlink_packet(SimpleNamespace(get_msgbuf=lambda noise=noise: noise))
    ground.pass_time(1.0)
    assert ground.console.lines == ["mavcompass: ZeroDivisionError: by zero"]
