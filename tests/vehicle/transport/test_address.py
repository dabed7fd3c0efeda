"""What a person may write as SOURCE, and what they read when it is wrong."""

from __future__ import annotations

from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st

from mavcompass.errors import UsageError
from mavcompass.vehicle.transport import (
    Address,
    Mavsdk,
    Recording,
    Serial,
    Simulated,
    Tcp,
    TcpIn,
    UdpIn,
    UdpOut,
    listening_address,
    parse_address,
)

SPELLINGS: dict[str, Address] = {
    "udpin:0.0.0.0:14550": UdpIn("0.0.0.0", 14550),
    "udpin::14550": UdpIn("0.0.0.0", 14550),
    "udp:127.0.0.1:14550": UdpIn("127.0.0.1", 14550),
    "udpout:192.168.2.1:14550": UdpOut("192.168.2.1", 14550),
    "tcp:localhost:5760": Tcp("localhost", 5760),
    "TCP:localhost:5760": Tcp("localhost", 5760),
    "tcpin:0.0.0.0:5760": TcpIn("0.0.0.0", 5760),
    "udpin://0.0.0.0:14540": UdpIn("0.0.0.0", 14540),
    "udp://:14540": UdpIn("0.0.0.0", 14540),
    "udpout://10.0.0.2:14550": UdpOut("10.0.0.2", 14550),
    "tcpout://10.0.0.2:5760": Tcp("10.0.0.2", 5760),
    "tcpin://0.0.0.0:5760": TcpIn("0.0.0.0", 5760),
    "tcp:[::1]:5760": Tcp("::1", 5760),
    "/dev/ttyACM0": Serial("/dev/ttyACM0", 115_200),
    "/dev/ttyUSB0:57600": Serial("/dev/ttyUSB0", 57_600),
    "/dev/serial/by-path/pci-0000:00:14.0-usb-0:1:1.0": Serial(
        "/dev/serial/by-path/pci-0000:00:14.0-usb-0:1:1.0"
    ),
    "serial:///dev/ttyACM0:57600": Serial("/dev/ttyACM0", 57_600),
    "serial:/dev/ttyACM0": Serial("/dev/ttyACM0"),
    "COM3:57600": Serial("COM3", 57_600),
    "sim:rover": Simulated("rover"),
    "sim:copter,seed=7": Simulated("copter", 7),
    "sim:boat,seed=2,effect=soft_iron+noise_excess": Simulated("boat", 2, ("soft_iron", "noise_excess")),
    "mavsdk+udpin://0.0.0.0:14550": Mavsdk("udpin://0.0.0.0:14550"),
    "mavsdk+tcp:127.0.0.1:5760": Mavsdk("tcpout://127.0.0.1:5760"),
    "mavsdk+/dev/ttyACM0:57600": Mavsdk("serial:///dev/ttyACM0:57600"),
    "flight.tlog": Recording(Path("flight.tlog")),
    "logs/00000042.BIN": Recording(Path("logs/00000042.BIN")),
    "text.log": Recording(Path("text.log")),
    "a.ulg": Recording(Path("a.ulg")),
    "track.csv": Recording(Path("track.csv")),
    "replay:odd name": Recording(Path("odd name")),
}


@pytest.mark.parametrize("source", SPELLINGS)
def test_every_spelling_is_understood(source: str) -> None:
    address = parse_address(source)
    assert address == SPELLINGS[source]
    if address != Recording(Path("odd name")):  # which only the word before it tells from an address
        assert parse_address(str(address)) == address, "the canonical spelling means the same"


HELP = {
    "udpim:0.0.0.0:14550": "Did you mean udpin:0.0.0.0:14550?",
    "udpin:14550": "Did you mean udpin:0.0.0.0:14550?",
    "tcp:raspberrypi": "Did you mean tcp:raspberrypi:14550?",
    "192.168.1.1:5760": "Did you mean tcp:192.168.1.1:5760, or udpout:",
    "tcp:host:0": "1 to 65535",
    "tcp:host:70000": "1 to 65535",
    "udpout:0.0.0.0:14550": "Did you mean|this machine",
    "sim:rovr": "Did you mean sim:rover?",
    "sim:": "The vehicles are",
    "sim:rover,sed=3": "seed=NUMBER",
    "sim:rover,seed=x": "seed=NUMBER",
    "rover": "Did you mean sim:rover?",
    "flight.tlogg": "Recordings end in",
    "nonsense": "sim:rover or a recording",
    "": "sim:rover or a recording",
    "mavsdk+sim:rover": "mavsdk.udpin",
    "serial:ttyACM0": "/dev/ttyACM0",
    "http://example.org": "no kind of link",
}


@pytest.mark.parametrize("source", HELP)
def test_a_wrong_address_gets_a_hint(source: str) -> None:
    with pytest.raises(UsageError, match=HELP[source].replace("?", r"\?")) as caught:
        parse_address(source)
    assert caught.value.exit_code == 2 and caught.value.remedy


@given(st.text(max_size=40))
def test_any_text_is_an_address_or_a_usage_error(source: str) -> None:
    try:
        parse_address(source)
    except UsageError as error:
        assert error.what.endswith(".") and error.remedy


def test_listening_on_tcp_waits_for_connections() -> None:
    assert listening_address("tcp:127.0.0.1:5760") == TcpIn("127.0.0.1", 5760)
    assert listening_address("udpout:127.0.0.1:14550") == UdpOut("127.0.0.1", 14550)
    assert listening_address("tcp:127.0.0.1:0") == TcpIn("127.0.0.1", 0)
    assert listening_address("udpin::0") == UdpIn("0.0.0.0", 0)
    with pytest.raises(UsageError, match="listen"):
        listening_address("sim:rover")
