"""Cut links, reboots, and a service that starts before its vehicle."""

from __future__ import annotations

import time
from collections import defaultdict
from collections.abc import Callable
from contextlib import ExitStack
from itertools import pairwise
from pathlib import Path
from statistics import median
from types import ModuleType

import pytest
from running_service import StartService, configured, wait_for
from serving import serving

from mavcompass import messages as mav
from mavcompass.enums import MavCmd
from mavcompass.service.run import link_opener
from mavcompass.service.station import Station
from mavcompass.service.work.clock import Schedule
from mavcompass.service.work.history import History
from mavcompass.simulation.vehicle import SimulatedAutopilot
from mavcompass.vehicle.links.simulated import SimulatedLink
from mavcompass.vehicle.transport import TcpIn


class Vehicle:
    """A vehicle on a TCP port that can be switched off and on."""

    def __init__(self) -> None:
        self.autopilot = SimulatedAutopilot("rover", seed=3)
        self.port = 0
        self._on = ExitStack()

    def switch_on(self) -> None:
        served = serving(self.autopilot, TcpIn("127.0.0.1", self.port), speed=2.0)
        _, self.port = self._on.enter_context(served)

    def switch_off(self) -> None:
        self._on.close()


@pytest.fixture
def tcp_station(tmp_path: Path) -> Callable[[int], Station]:
    def make(port: int) -> Station:
        config = configured(tmp_path, f"tcp:127.0.0.1:{port}")
        station = Station(config, History(tmp_path / "history.db"), link_opener(config))
        station.start()
        return station

    return make


def test_a_connection_that_breaks_is_back_within_two_seconds(tcp_station: Callable[[int], Station]) -> None:
    vehicle = Vehicle()
    vehicle.switch_on()
    station = tcp_station(vehicle.port)
    try:
        wait_for(lambda: station.view and station.view.fresh)
        for _ in range(2):
            vehicle.switch_off()
            wait_for(lambda: not station.connected)
            station.headings, began = 0, time.monotonic()
            vehicle.switch_on()
            wait_for(lambda: station.headings > 5)
            assert time.monotonic() - began < 2.0
        assert station.view is not None and station.view.reconnects == 2
    finally:
        assert station.stop()
        vehicle.switch_off()


def test_the_service_may_be_there_before_the_vehicle(
    tcp_station: Callable[[int], Station], caplog: pytest.LogCaptureFixture
) -> None:
    vehicle = Vehicle()
    vehicle.switch_on()
    vehicle.switch_off()
    station = tcp_station(vehicle.port)
    try:
        wait_for(lambda: station.beat >= 3)
        assert "could not be opened" in station.link_error
        assert caplog.messages == [station.link_error], "the journal has it once"
        assert not station.connected
        vehicle.switch_on()
        wait_for(lambda: station.connected)
        assert station.link_error == ""
    finally:
        assert station.stop()
        vehicle.switch_off()


def test_a_reboot_is_noticed_and_rates_and_parameters_are_asked_again(start_service: StartService) -> None:
    running = start_service(speed=5.0)
    station = running.service.station
    assert running.link is not None and station.view is not None
    wait_for(lambda: station.view.boot_s > 61.0)  # type: ignore[union-attr]
    running.link.autopilot.reboot()  # type: ignore[attr-defined]
    wait_for(lambda: station.view.reboots == 1)  # type: ignore[union-attr]
    wait_for(lambda: station.view.fresh and 0.0 < station.view.boot_s < 60.0)  # type: ignore[union-attr]
    before, boot_s = station.headings, station.view.boot_s
    wait_for(lambda: station.view.boot_s > boot_s + 4.0)  # type: ignore[union-attr]
    rate_hz = (station.headings - before) / (station.view.boot_s - boot_s)
    assert rate_hz > 40.0, "RAW_IMU at 40 Hz, the others at 10"


def test_a_calibration_on_a_link_that_dies_ends_with_the_reason(start_service: StartService) -> None:
    running = start_service(speed=4.0)
    assert running.link is not None
    task = running.client.post("/api/calibration", json={"writing": "yes"}).json()
    wait_for(lambda: len(running.client.get("/api/task").json()["lines"]) > 3)
    running.link.autopilot.reboot()  # type: ignore[attr-defined]
    ended = running.finish(task)
    assert ended["state"] == "failed"
    assert ended["error"]
    entry = running.client.get("/api/history").json()["entries"][0]
    assert (entry["kind"], entry["ok"], entry["summary"]) == ("calibration", False, ended["error"])


def test_a_stop_of_the_service_halts_the_vehicle_first(start_service: StartService) -> None:
    running = start_service(speed=4.0)
    assert running.link is not None
    running.client.post("/api/calibration", json={})
    wait_for(lambda: abs(running.link.autopilot.truth.yaw_rate_radps) > 0.3)  # type: ignore[union-attr,attr-defined]
    running.service.stop()
    wait_for(lambda: not running._thread.is_alive())
    running.link.autopilot.advance(running.link.autopilot.time_s + 1.0)
    assert abs(running.link.autopilot.truth.yaw_rate_radps) < 0.05  # type: ignore[attr-defined]
    task = running.service.station.desk.current
    assert task is not None and "stopping" in task.error


@pytest.mark.parametrize(("kind", "may_hover"), [("rover", False), ("quadplane", True)])
def test_what_is_asked_for_is_given_back_at_the_end_and_a_heartbeat_told_every_second(
    kind: str, may_hover: bool, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    link, asked, first = SimulatedLink.of(kind, seed=1, speed=20.0), dict[int, float](), dict[int, float]()
    send, beats_s = link.send, list[float]()

    def note(message: mav.Message) -> None:
        if isinstance(message, mav.CommandLong) and message.command == MavCmd.SET_MESSAGE_INTERVAL:
            asked[int(message.param1)] = message.param2
            first.setdefault(int(message.param1), message.param2)
        if isinstance(message, mav.Heartbeat):
            beats_s.append(link.now())
        send(message)

    monkeypatch.setattr(link, "send", note)
    station = Station(configured(tmp_path), History(tmp_path / "history.db"), lambda: link)
    station.start()
    wait_for(lambda: station.headings and len(asked) > 5 and len(beats_s) > 9)
    assert median(b - a for a, b in pairwise(beats_s)) == pytest.approx(1.0, abs=0.3)
    assert all(asked.values())
    rates_hz = {mav.RawImu: 40.0, mav.ScaledImu2: 10.0, mav.ScaledImu3: 10.0, mav.Attitude: 10.0}
    rates_hz |= {mav.GpsRawInt: 5.0, mav.GlobalPositionInt: 2.0, mav.SysStatus: 2.0, mav.SystemTime: 1.0}
    rates_hz |= {mav.ExtendedSysState: 1.0} if may_hover else {}
    assert first == {mav.message_id(kind): 1e6 / hz for kind, hz in rates_hz.items()}
    assert station.stop() and not any(asked.values())


def test_a_vehicle_that_does_not_tell_its_parameters_is_left_in_peace_between_the_tries(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    link, sent_s = SimulatedLink.of("rover", seed=1), defaultdict[type[mav.Message], list[float]](list)
    monkeypatch.setattr(link, "send", lambda message: sent_s[type(message)].append(link.now()))
    station = Station(configured(tmp_path), History(tmp_path / "history.db"), lambda: link)
    station.start()
    wait_for(lambda: link.now() > 20.0)
    assert station.stop() and sent_s[mav.ParamRequestRead][0] < 5.0
    assert max(b - a for a, b in pairwise(sent_s[mav.ParamRequestRead])) > 4.0
    assert len(sent_s[mav.Heartbeat]) < 1.5 * link.now(), "one a second, and where a procedure begins"


def test_cuts_and_reboots_are_bridged_and_no_calibration_result_is_missed(
    campaigns: Callable[[str], ModuleType],
) -> None:
    """Three minutes of the campaign `scripts/campaigns/service_soak.py`."""
    figures = campaigns("service_soak").Soak(hours=0.05, cuts=5, reboots=1, calibrations=1).run()
    faults = [fault for fault in figures.faults if "memory" not in fault]  # too short for that
    assert faults == []
    assert figures.calibrations == 1
    assert figures.written == 1
    assert figures.reconnects >= 4
    assert figures.slowest_reconnect_s < 2.0


def test_a_simulated_vehicle_that_is_opened_again_is_the_same(tmp_path: Path) -> None:
    opener = link_opener(configured(tmp_path, "sim:rover,seed=2"))
    link = opener()
    assert isinstance(link, SimulatedLink) and opener() is link and link.name == "sim:rover,seed=2"


def test_things_are_due_again_when_the_clock_begins_anew() -> None:
    due = Schedule()
    assert due.is_due("x", 100.0, 1.0)
    assert not due.is_due("x", 100.5, 1.0)
    assert due.is_due("x", 101.0, 1.0) and not due.is_due("x", 101.0, 1.0)
    assert due.is_due("x", 3.0, 1.0)
    assert due.next_s("x", 3.2, 1.0) == 4.0
    due.hurry("x")
    assert due.is_due("x", 3.3, 1.0)
