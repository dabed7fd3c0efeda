"""A ground station that knows nothing of us, only MAVLink: pymavlink on a socket of its own."""

from __future__ import annotations

import struct
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
from pymavlink.dialects.v20 import ardupilotmega as wire
from running_service import RunningService, configured, wait_for
from serving import serving

from mavcompass.service.run import Service
from mavcompass.simulation.vehicle import SimulatedAutopilot
from mavcompass.vehicle.transport import UdpOut
from mavcompass.vehicle.transport.udp import UdpTransport

SPEED = 6.0


class GroundStation:
    """Speak from system 255, component 190, to a UDP port."""

    def __init__(self, port: int) -> None:
        import socket

        self._socket = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self._socket.connect(("127.0.0.1", port))
        self._socket.settimeout(0.1)
        self.mav: Any = wire.MAVLink(self, srcSystem=255, srcComponent=190)
        self.mav.robust_parsing = True
        self.heard: list[Any] = []

    def write(self, data: bytes) -> None:
        self._socket.send(data)

    def listen(self, until: Any, timeout_s: float = 300.0) -> Any:
        """Collect messages of component 191 until one is what was waited for."""
        end, beat = time.monotonic() + timeout_s, 0.0
        while time.monotonic() < end:
            if time.monotonic() > beat:
                self.mav.heartbeat_send(wire.MAV_TYPE_GCS, wire.MAV_AUTOPILOT_INVALID, 0, 0, 4)
                beat = time.monotonic() + 0.5
            try:
                messages = self.mav.parse_buffer(self._socket.recv(4096)) or []
            except TimeoutError:
                continue
            for message in messages:
                if message.get_srcComponent() == 191:
                    self.heard.append(message)
                    if until(message):
                        return message
        raise AssertionError("what was waited for did not come")

    def command(self, number: int, *params: float) -> int:
        """Send a command to component 191 and return the result of its acknowledgement."""
        ack = None
        for confirmation in range(4):  # as the protocol has it: datagrams may be lost
            self.mav.command_long_send(1, 191, number, confirmation, *[*params, *[0.0] * 7][:7])
            try:
                ack = self.listen(lambda m: m.get_type() == "COMMAND_ACK" and m.command == number, 5.0)
                break
            except AssertionError:
                continue
        assert ack is not None
        assert (ack.target_system, ack.target_component) == (255, 190)
        return int(ack.result)

    def close(self) -> None:
        self._socket.close()


@pytest.fixture
def port() -> int:
    with_transport = UdpTransport.listening("127.0.0.1", 0)
    number = with_transport.port
    with_transport.close()
    return number


@pytest.fixture
def served(tmp_path: Path, port: int) -> Iterator[RunningService]:
    service = Service(configured(tmp_path, f"udpin:127.0.0.1:{port}"))
    vehicle = SimulatedAutopilot("rover", seed=3)
    with serving(vehicle, UdpOut("127.0.0.1", port), SPEED), RunningService(service, None) as running:
        yield running


@pytest.fixture
def station(port: int, served: RunningService) -> Iterator[GroundStation]:
    made = GroundStation(port)
    yield made
    made.close()


def single(value: float) -> float:
    """A number as it comes out of MAVLink's single precision."""
    return float(struct.unpack("<f", struct.pack("<f", value))[0])


def test_a_ground_station_calibrates_by_command_and_gets_the_numbers_of_the_json(
    served: RunningService, station: GroundStation
) -> None:
    heartbeat = station.listen(lambda m: m.get_type() == "HEARTBEAT")
    assert (heartbeat.get_srcSystem(), heartbeat.type) == (1, wire.MAV_TYPE_ONBOARD_CONTROLLER)
    assert heartbeat.autopilot == wire.MAV_AUTOPILOT_INVALID

    assert station.command(wire.MAV_CMD_DO_START_MAG_CAL, 0, 1, 1) == wire.MAV_RESULT_ACCEPTED
    assert station.command(wire.MAV_CMD_DO_START_MAG_CAL, 0, 1, 1) == wire.MAV_RESULT_TEMPORARILY_REJECTED
    reports: dict[int, Any] = {}

    def all_reported(message: Any) -> bool:
        if message.get_type() == "MAG_CAL_REPORT":
            reports[message.compass_id] = message
        return set(reports) == {0, 1, 2}

    station.listen(all_reported)
    progress = [m for m in station.heard if m.get_type() == "MAG_CAL_PROGRESS" and m.compass_id == 0]
    percents = [m.completion_pct for m in progress]
    assert percents == sorted(percents)
    assert percents[0] < 30 and percents[-1] == 100
    assert len(set(percents)) >= 5
    assert all(m.cal_mask == 7 for m in progress)

    document = wait_for(lambda: served.client.get("/api/task").json()["document"])
    assert document["written"] and document["verified"]
    for compass in document["compasses"]:
        report, found = reports[compass["instance"] - 1], compass["correction"]
        assert report.cal_status == 4 and report.autosaved == 1
        assert [report.ofs_x, report.ofs_y, report.ofs_z] == [single(v) for v in found["offsets_mgauss"]]
        assert [report.diag_x, report.diag_y, report.diag_z] == [single(v) for v in found["diagonals"]]
        assert [report.offdiag_x, report.offdiag_y, report.offdiag_z] == [
            single(v) for v in found["off_diagonals"]
        ]
        assert report.scale_factor == single(found["scale"])
        assert report.fitness == single(compass["residual_rms_mgauss"])

    def told(message: Any) -> bool:
        return message.get_type() == "STATUSTEXT" and "calibrated, heading" in message.text

    if not any(told(message) for message in station.heard):
        station.listen(told)
    assert station.listen(lambda m: m.get_type() == "NAMED_VALUE_FLOAT" and m.name == "MC_HDG")


def test_without_autosave_the_result_waits_for_accept(served: RunningService, station: GroundStation) -> None:
    station.listen(lambda m: m.get_type() == "HEARTBEAT")
    before = served.client.get("/api/parameters").json()["parameters"]["COMPASS_OFS_X"]
    assert station.command(wire.MAV_CMD_DO_START_MAG_CAL, 1, 0, 0) == wire.MAV_RESULT_ACCEPTED
    first = station.listen(lambda m: m.get_type() == "MAG_CAL_REPORT")
    assert (first.cal_status, first.autosaved, first.cal_mask) == (4, 0, 1)
    assert station.command(wire.MAV_CMD_DO_ACCEPT_MAG_CAL, 1) == wire.MAV_RESULT_ACCEPTED
    station.listen(lambda m: m.get_type() == "MAG_CAL_REPORT" and m.autosaved == 1)
    after = wait_for(lambda: served.client.get("/api/parameters").json().get("parameters"))
    assert after["COMPASS_OFS_X"] == pytest.approx(first.ofs_x, abs=1e-4)
    assert after["COMPASS_OFS_X"] != pytest.approx(before, abs=0.1)


def test_a_ground_station_cancels(served: RunningService, station: GroundStation) -> None:
    station.listen(lambda m: m.get_type() == "HEARTBEAT")
    assert station.command(wire.MAV_CMD_DO_START_MAG_CAL, 1, 0, 1) == wire.MAV_RESULT_ACCEPTED
    station.listen(lambda m: m.get_type() == "MAG_CAL_PROGRESS" and m.completion_pct > 10)
    assert station.command(wire.MAV_CMD_DO_CANCEL_MAG_CAL, 1) == wire.MAV_RESULT_ACCEPTED
    failed = station.listen(lambda m: m.get_type() == "MAG_CAL_REPORT")
    assert failed.cal_status == 5
    assert "Cancelled" in served.client.get("/api/task").json()["error"]


def test_commands_for_others_and_unknown_ones_do_nothing(
    served: RunningService, station: GroundStation
) -> None:
    station.listen(lambda m: m.get_type() == "HEARTBEAT")
    station.mav.command_long_send(1, 1, wire.MAV_CMD_DO_START_MAG_CAL, 0, 0, 0, 1, 0, 0, 0, 0)
    station.mav.command_long_send(1, 0, wire.MAV_CMD_DO_START_MAG_CAL, 0, 0, 0, 1, 0, 0, 0, 0)
    assert station.command(wire.MAV_CMD_COMPONENT_ARM_DISARM, 1) == wire.MAV_RESULT_UNSUPPORTED
    assert served.service.station.desk.current is None
