"""`--sign-key` against a vehicle that signs and believes nobody who does not, with pymavlink's signatures."""

from __future__ import annotations

import hashlib
import json
import time
from pathlib import Path
from typing import Any

import pytest
from pymavlink.dialects.v20 import ardupilotmega
from vehicle_on_wire import VehicleOnWire

from mavcompass.cli.main import main
from mavcompass.simulation.autopilot.board import Outgoing
from mavcompass.simulation.vehicle import SimulatedAutopilot
from mavcompass.vehicle.link import LinkStatistics
from mavcompass.vehicle.links.wire import WireLink
from mavcompass.vehicle.opening import SIGN_KEY_VARIABLE
from mavcompass.vehicle.transport import Peer
from mavcompass.vehicle.wire import FrameParser, FrameWriter, decode

SOURCE = "tcp:127.0.0.1:5760"
PASSPHRASE = "seven of nine"
Show = pytest.CaptureFixture[str]


def _signed(key: bytes, **options: Any) -> Any:
    end = ardupilotmega.MAVLink(None, **options)
    end.signing.secret_key = key
    end.signing.sign_outgoing = True
    end.signing.link_id = 1
    end.signing.timestamp = int((time.time() - 1_420_070_400) * 1e5)
    return end


class SigningVehicle(VehicleOnWire):
    """Sign what is said, and believe only what is signed with the same key.

    Attributes:
        refused: frames that it did not believe.
    """

    name = SOURCE

    def __init__(self, key: bytes) -> None:
        super().__init__(SimulatedAutopilot("rover", seed=1, armed=False))
        self.refused = 0
        self._key, self._ends = key, dict[tuple[int, int], Any]()
        self._ears, self._writer = _signed(key), FrameWriter()
        self._read = ardupilotmega.MAVLink(None)

    def packed(self, said: Outgoing) -> bytes:
        """Return the bytes of a message as pymavlink signs them."""
        sender = (said.system, said.component)
        if sender not in self._ends:
            self._ends[sender] = _signed(self._key, srcSystem=said.system, srcComponent=said.component)
        (packet,) = self._read.parse_buffer(self._writer.write(said.message, *sender))
        return bytes(packet.pack(self._ends[sender]))

    def write(self, data: bytes, peer: Peer) -> bool:
        """Let the vehicle hear what pymavlink believes."""
        for frame in FrameParser(LinkStatistics()).feed(data):
            try:
                (packet,) = self._ears.parse_buffer(data)
            except ardupilotmega.MAVError:
                self.refused += 1
                continue
            assert packet.get_signed()
            message = decode(frame.message_id, frame.payload)
            assert message is not None
            self.vehicle.receive(message, frame.system, frame.component, 0)
        return True


@pytest.fixture
def wire(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> SigningVehicle:
    wire = SigningVehicle(hashlib.sha256(PASSPHRASE.encode()).digest())
    monkeypatch.setenv("MAVCOMPASS_UNDO_DIR", str(tmp_path / "undo"))
    monkeypatch.setenv(SIGN_KEY_VARIABLE, "")
    monkeypatch.setattr("mavcompass.vehicle.transport.open_transport", lambda *_: wire)
    monkeypatch.setattr(WireLink, "now", lambda _: wire.vehicle.time_s)
    return wire


def key_file(folder: Path, passphrase: str) -> str:
    path = folder / "key"
    path.write_text(f"{passphrase}\n")
    return str(path)


def test_with_the_vehicles_key_parameters_are_read_and_written(
    wire: SigningVehicle, tmp_path: Path, capsys: Show
) -> None:
    key, wanted = key_file(tmp_path, PASSPHRASE), tmp_path / "wanted.param"
    wanted.write_text("COMPASS_OFS_X,42\n")
    assert main(["params", "write", SOURCE, str(wanted), "--yes", "--sign-key", key]) == 0
    capsys.readouterr()
    assert main(["params", "show", SOURCE, "--json", "-", "--sign-key", key]) == 0
    assert json.loads(capsys.readouterr().out)["parameters"]["COMPASS_OFS_X"] == 42.0
    assert wire.refused == 0


@pytest.mark.parametrize(
    ("passphrase", "told"),
    [("seven of eight", "was not signed with the key in use"),
     (None, "is signed: the vehicle may believe only who signs, too")],
)  # fmt: skip
def test_with_another_key_or_none_the_vehicle_believes_nothing(
    passphrase: str | None, told: str, wire: SigningVehicle, tmp_path: Path, capsys: Show
) -> None:
    before = dict(wire.vehicle.firmware.store.storage)
    wanted = tmp_path / "wanted.param"
    wanted.write_text("COMPASS_OFS_X,42\n")
    key = [] if passphrase is None else ["--sign-key", key_file(tmp_path, passphrase)]
    assert main(["params", "write", SOURCE, str(wanted), "--yes", *key]) != 0
    assert told in capsys.readouterr().err
    assert wire.refused > 0 and dict(wire.vehicle.firmware.store.storage) == before
