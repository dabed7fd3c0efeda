"""Several vehicles on a link, and two that share a system id: through every door, live and recorded."""

from __future__ import annotations

import json
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from dataclasses import replace
from pathlib import Path

import pytest
from dialogue import HEARTBEAT, MemoryVehicle, Said
from far_ends import write_tlog
from serving import serving

from mavcompass.cli.main import main
from mavcompass.errors import Refused
from mavcompass.messages import Attitude, AutopilotVersion, CommandAck, CommandLong, RawImu, SystemTime
from mavcompass.procedure.nameplate import read_nameplate
from mavcompass.procedure.script import Context, Machine, Script, pause
from mavcompass.procedure.vehicle_state import find_vehicle
from mavcompass.simulation.vehicle import SimulatedAutopilot
from mavcompass.vehicle.driver import run
from mavcompass.vehicle.link import LinkStatistics
from mavcompass.vehicle.links.simulated import SimulatedLink
from mavcompass.vehicle.transport import UdpIn, UdpOut, open_transport

SHARED = "Two autopilots share system id 1"


@contextmanager
def calling(port: int, *vehicles: SimulatedAutopilot) -> Iterator[str]:
    """Let vehicles call one port of this computer."""
    with ExitStack() as stack:
        for vehicle in vehicles:
            stack.enter_context(serving(vehicle, UdpOut("127.0.0.1", port), speed=2.0))
        yield f"udpin:127.0.0.1:{port}"


@pytest.fixture
def free_port() -> int:
    transport = open_transport(UdpIn("127.0.0.1", 0))
    port = int(transport.name.rpartition(":")[2])
    transport.close()
    return port


@pytest.mark.parametrize(
    "words",
    [["calibrate", "--yes"], ["heading"], ["check"], ["params", "show"], ["params", "restore", "--yes"]],
)
def test_of_several_vehicles_each_command_asks_for_one(
    words: list[str], free_port: int, capsys: pytest.CaptureFixture[str]
) -> None:
    vehicles = [SimulatedAutopilot("rover", seed=1), SimulatedAutopilot("copter", seed=2, system=2)]
    with calling(free_port, *vehicles) as source:
        *verb, options = (*words, []) if not words[-1].startswith("-") else (*words[:-1], words[-1:])
        assert main([*verb, source, *options]) == 2
    told = capsys.readouterr().err
    assert "2 vehicles are on this link:\n  system 1: rover, ardupilot, armed, unique id " in told
    assert "\n  system 2: copter, ardupilot, armed, unique id " in told and "--system" in told


def test_heading_goes_to_the_vehicle_that_is_named(
    free_port: int, capsys: pytest.CaptureFixture[str]
) -> None:
    vehicles = [
        SimulatedAutopilot("rover", seed=1, system=system, start_yaw_deg=yaw, calibration="exact")
        for system, yaw in ((1, 0.0), (2, 120.0))
    ]
    with calling(free_port, *vehicles) as source:
        assert main(["heading", source, "--system", "2", "--json-lines", "--duration", "1"]) == 0
    lines = [json.loads(line) for line in capsys.readouterr().out.splitlines()]
    assert lines and all(abs(line["true_deg"] - 120.0) < 15.0 for line in lines)


def test_two_vehicles_with_one_system_id_are_told_though_they_were_started_together(
    free_port: int, capsys: pytest.CaptureFixture[str]
) -> None:
    vehicles = [SimulatedAutopilot("rover", seed=1), SimulatedAutopilot("rover", seed=2)]
    with calling(free_port, *vehicles) as source:
        doors = (
            ["heading", source, "--duration", "20"],
            ["calibrate", source, "--yes"],
            ["check", source, "--turn", "none"],
            ["params", "show", source],
            ["params", "backup", source],
        )
        for words in doors:
            assert main(words) == 7, words
            assert SHARED in capsys.readouterr().err


class Twins(MemoryVehicle):
    """Be two autopilots with one system id, the second started half a minute before."""

    def __init__(self, numbers: tuple[int, int] = (10, 200)) -> None:
        super().__init__()
        self.statistics = LinkStatistics()
        self._numbers = list(numbers)
        self._next_s = 0.0

    def advance(self, until_s: float) -> list[Said]:
        said = super().advance(until_s)
        while self._next_s <= until_s:
            for which, ahead_s in enumerate((100.0, 130.0)):
                attitude = Attitude(time_boot_ms=round(1e3 * (self._next_s + ahead_s)))
                self.statistics.count(1, 1, self._numbers[which] & 0xFF, attitude)
                self._numbers[which] += 1
                said.append(Said(self._next_s, 1, 1, attitude))
            self._next_s += 0.25
        return said


def test_a_procedure_stops_where_two_clocks_and_two_counters_speak_as_one() -> None:
    def work(context: Context) -> Script[None]:
        yield from find_vehicle(context)
        yield from pause(context, 60.0)

    twins = Twins()
    with SimulatedLink(twins) as link:
        link.statistics = twins.statistics
        with pytest.raises(Refused, match=SHARED):
            run(Machine(work), link)
        assert link.now() < 6.0


def test_one_counter_is_one_autopilot_whatever_its_clock_says() -> None:
    twins = Twins()
    for at in range(200):
        twins.statistics.count(1, 1, at & 0xFF, Attitude(time_boot_ms=1000 * at + 30_000 * (at % 2)))
    assert not twins.statistics.shared


@pytest.mark.parametrize(("apart_ms", "shared"), [(100, set()), (700, set()), (1500, {1}), (30_000, {1})])
def test_messages_that_overtake_each_other_are_of_one_and_more_than_a_second_apart_of_two(
    apart_ms: int, shared: set[int]
) -> None:
    """A link may deliver a message late by a second. The sequence numbers go back and forth each time."""
    statistics = LinkStatistics()
    for at in range(40):
        for ahead in (1, 0):
            boot_ms = 100_000 + 250 * at + apart_ms * ahead
            statistics.count(1, 1, (2 * at + ahead) & 0xFF, Attitude(time_boot_ms=boot_ms))
    assert statistics.shared == shared


@pytest.mark.parametrize(("wanted", "told"), [(None, 1), (1, 0)])
def test_another_vehicle_that_appears_is_told_once(wanted: int | None, told: int) -> None:
    shown: list[str] = []
    vehicle = MemoryVehicle()

    class Latecomer(MemoryVehicle):
        def advance(self, until_s: float) -> list[Said]:
            late = [replace(said, system=7) for said in super().advance(until_s) if said.time_s > 4.0]
            return [*vehicle.advance(until_s), *late]

    def work(context: Context) -> Script[None]:
        yield from find_vehicle(context, wanted)
        yield from pause(context, 10.0)

    with SimulatedLink(Latecomer()) as link:
        run(Machine(work), link, on_show=lambda show: shown.append(show.text))
    assert len(shown) == told
    assert all("system 7, ardupilot rover" in text and "with system 1" in text for text in shown)


@pytest.mark.parametrize("uids", [(5,), (5, 5), (5, 6)])
def test_two_answers_to_who_are_you_are_of_two(uids: tuple[int, ...]) -> None:
    class Both(MemoryVehicle):
        def receive(self, message: object, system: int, component: int, port: int = 0) -> None:
            if isinstance(message, CommandLong):
                self.say(CommandAck(message.command))
                self.say(CommandAck(115, 4))  # a refusal, of what somebody else asked for
                for uid in uids:
                    self.say(AutopilotVersion(uid=uid), 0.05)

    def work(context: Context) -> Script[str]:
        yield from find_vehicle(context)
        return (yield from read_nameplate(context, "ardupilot", ())).uid

    with SimulatedLink(Both()) as link:
        if 6 not in uids:
            assert run(Machine(work), link) == "0000000000000005"
        else:
            with pytest.raises(Refused, match=SHARED):
                run(Machine(work), link)


@pytest.fixture
def recording(tmp_path: Path) -> Path:
    """Record two rovers with one system id, one of which was started 500 s before."""
    lines = []
    for tenth in range(300):
        for ahead_s, x in ((10.0, 200), (510.0, -150)):
            boot_ms = round(100.0 * tenth + 1e3 * ahead_s)
            lines += [
                (0.1 * tenth, 1, 1, RawImu(1000 * boot_ms, 0, 0, -1000, 0, 0, 0, x, 50, 400)),
                (0.1 * tenth, 1, 1, Attitude(boot_ms)),
                (0.1 * tenth, 1, 1, SystemTime(0, boot_ms)),
            ]
            lines += [(0.1 * tenth, 1, 1, HEARTBEAT)] if tenth % 10 == 0 else []
    return write_tlog(tmp_path / "two.tlog", lines)


@pytest.mark.parametrize(
    "words",
    [["calibrate"], ["heading"], ["check"], ["params", "show"], ["gap", "diagnose"], ["fleet", "diagnose"]],
)
def test_a_recording_of_two_with_one_system_id_is_told_through_every_door(
    words: list[str], recording: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    out = ["--out", str(tmp_path / "fleet.parquet")] if words[0] == "fleet" else []
    assert main([*words, str(recording), *out]) == 4
    assert SHARED in "".join(capsys.readouterr())
