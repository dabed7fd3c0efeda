"""A vehicle that speaks and understands MAVLink 1 only is calibrated like any other."""

from __future__ import annotations

import contextlib
from pathlib import Path

import pytest
from bent_vehicles import bent_vehicle, calibrated
from vehicle_on_wire import VehicleOnWire

from mavcompass.simulation.autopilot.board import Outgoing
from mavcompass.simulation.heading_error import heading_error_rms_deg
from mavcompass.simulation.vehicle import SimulatedAutopilot
from mavcompass.vehicle.link import LinkStatistics
from mavcompass.vehicle.links.wire import WireLink
from mavcompass.vehicle.transport import Peer
from mavcompass.vehicle.wire import FrameParser, FrameWriter, decode


class OldVehicle(VehicleOnWire):
    """Speak and understand version 1 alone.

    Attributes:
        heard, not_understood: how many frames came in version 1 and in version 2.
    """

    name = "old vehicle"

    def __init__(self, vehicle: SimulatedAutopilot) -> None:
        super().__init__(vehicle)
        self.heard = self.not_understood = 0
        self._parser = FrameParser(LinkStatistics(), None)
        self._writer = FrameWriter(version=1)

    def packed(self, said: Outgoing) -> bytes:
        """Return the bytes of a message; what has no number in version 1 cannot be said."""
        with contextlib.suppress(ValueError):
            return self._writer.write(said.message, said.system, said.component)
        return b""

    def write(self, data: bytes, peer: Peer) -> bool:
        """Let the vehicle hear what it understands."""
        for frame in self._parser.feed(data):
            if frame.version != 1:
                self.not_understood += 1
                continue
            self.heard += 1
            message = decode(frame.message_id, frame.payload)
            assert message is not None
            self.vehicle.receive(message, frame.system, frame.component, 0)
        return True


def test_a_vehicle_of_version_1_is_calibrated(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    vehicle = bent_vehicle("rover", 2)
    wire = OldVehicle(vehicle)
    monkeypatch.setattr(WireLink, "now", lambda _: vehicle.time_s)
    report = calibrated(vehicle, tmp_path, link=WireLink(wire))
    assert report.written and report.proof is not None and report.proof.passed
    assert heading_error_rms_deg(vehicle) <= 0.5
    assert wire.heard > 100
    # Once it has not answered in version 2 for three seconds, nothing is said in that any more.
    assert wire.not_understood < 0.2 * wire.heard
