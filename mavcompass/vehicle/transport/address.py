"""Address: the spellings of a SOURCE, as values.

    udpin:HOST:PORT  udpout:HOST:PORT  tcp:HOST:PORT  tcpin:HOST:PORT  /dev/ttyACM0[:BAUD]
    udpin://HOST:PORT  udpout://..  tcpout://..  tcpin://..  serial:///dev/ttyACM0:BAUD   (MAVSDK's)
    sim:VEHICLE[,seed=N][,effect=NAME[+NAME..]]  mavsdk+URL  FILE.tlog|.bin|.log|.ulg|.csv|.mcap|.db3

`str(address)` is the canonical spelling.
"""

from __future__ import annotations

import difflib
import re
from dataclasses import dataclass, replace
from pathlib import Path
from typing import ClassVar

from mavcompass.errors import UsageError

VEHICLES = ("rover", "ackermann-rover", "boat", "copter", "sub", "quadplane", "px4-copter", "px4-vtol")
RECORDING_SUFFIXES = (".tlog", ".bin", ".log", ".ulg", ".csv", ".mcap", ".db3")
DEFAULT_BAUD = 115_200
# What a person may write, MAVSDK's spellings and old ones included, by what it means here.
_SCHEMES = {
    "udpin": "udpin",
    "udp": "udpin",
    "udpout": "udpout",
    "tcp": "tcp",
    "tcpout": "tcp",
    "tcpin": "tcpin",
}
_REMEDY = "Give an address (udpin:0.0.0.0:14550, tcp:HOST:5760, /dev/ttyACM0), sim:rover or a recording."


@dataclass(frozen=True, slots=True)
class _Network:
    """Name a port of the network; MAVSDK spells two of the schemes otherwise."""

    host: str
    port: int

    scheme: ClassVar[str]
    mavsdk_scheme: ClassVar[str]

    def __str__(self) -> str:
        return f"{self.scheme}:{_bracketed(self.host)}:{self.port}"


class UdpIn(_Network):
    """Wait on a local UDP port."""

    __slots__ = ()
    scheme = mavsdk_scheme = "udpin"


class UdpOut(_Network):
    """Speak first to a remote UDP port."""

    __slots__ = ()
    scheme = mavsdk_scheme = "udpout"


class Tcp(_Network):
    """Connect to a TCP server."""

    __slots__ = ()
    scheme, mavsdk_scheme = "tcp", "tcpout"


class TcpIn(_Network):
    """Wait for TCP connections."""

    __slots__ = ()
    scheme = mavsdk_scheme = "tcpin"


@dataclass(frozen=True, slots=True)
class Serial:
    """Open a serial port."""

    device: str
    baud: int = DEFAULT_BAUD

    def __str__(self) -> str:
        return f"{self.device}:{self.baud}"


@dataclass(frozen=True, slots=True)
class Simulated:
    """Embed a simulated vehicle; `effects` are names of the registry, with their default parameters."""

    vehicle: str
    seed: int = 0
    effects: tuple[str, ...] = ()

    def __str__(self) -> str:
        effects = f",effect={'+'.join(self.effects)}" if self.effects else ""
        return f"sim:{self.vehicle},seed={self.seed}{effects}"


@dataclass(frozen=True, slots=True)
class Mavsdk:
    """Go through MAVSDK; `url` is in its spelling."""

    url: str

    def __str__(self) -> str:
        return f"mavsdk+{self.url}"


@dataclass(frozen=True, slots=True)
class Recording:
    """Play a file."""

    path: Path

    def __str__(self) -> str:
        return str(self.path)


NetworkAddress = UdpIn | UdpOut | Tcp | TcpIn
WireAddress = NetworkAddress | Serial
Address = WireAddress | Simulated | Mavsdk | Recording

_NETWORK: dict[str, type[NetworkAddress]] = {kind.scheme: kind for kind in (UdpIn, UdpOut, Tcp, TcpIn)}


def parse_address(source: str) -> Address:
    """Read a SOURCE as a person wrote it.

    Raises UsageError for anything that is none of the spellings, with the nearest right one.
    """
    source = source.strip()
    scheme, colon, rest = source.partition(":")
    scheme = scheme.lower()
    if scheme.startswith("mavsdk+") and colon:
        return _mavsdk(source)
    if scheme == "sim":
        return _simulated(rest)
    if scheme == "replay" and rest:
        return Recording(Path(rest))
    if scheme in ("serial", "serial_flowcontrol") and rest:
        return _serial(rest.removeprefix("//"))
    if scheme in _SCHEMES and colon:
        return _network(source, _SCHEMES[scheme], rest)
    if Path(source).suffix.lower() in RECORDING_SUFFIXES:
        return Recording(Path(source))
    if re.match(r"/dev/|COM\d+(:|$)", source):
        return _serial(source)
    raise _unknown(source, scheme if colon else "")


def listening_address(where: str) -> WireAddress:
    """Read the ADDRESS of `--listen`: a SOURCE, but `tcp:` waits for connections and port 0 is any free one.

    Raises UsageError for what is no port.
    """
    scheme, _, rest = where.strip().partition(":")
    if _SCHEMES.get(scheme.lower()) == "tcp":
        where = f"tcpin:{rest}"
    if (waiting := re.fullmatch(r"(?P<at>(udp|udpin|tcpin):.*):0", where, re.IGNORECASE)) is not None:
        address = parse_address(f"{waiting['at']}:1")
        assert isinstance(address, UdpIn | TcpIn)
        return replace(address, port=0)
    match parse_address(where):
        case UdpIn() | UdpOut() | TcpIn() | Serial() as address:
            return address
    raise UsageError(
        f"{where} is not a port that one can listen on.",
        "Use tcp:127.0.0.1:5760, udpout:HOST:PORT, udpin:HOST:PORT or a serial device.",
    )


def _bracketed(host: str) -> str:
    return f"[{host}]" if ":" in host else host


def _network(source: str, scheme: str, rest: str) -> NetworkAddress:
    where = rest.removeprefix("//").rstrip("/")
    found = re.fullmatch(r"(?P<host>\[[^\]]*\]|[^:]*):(?P<port>\d+)", where)
    default = "0.0.0.0" if scheme in ("udpin", "tcpin") else "127.0.0.1"
    if found is None:
        guess = f"{scheme}:{default}:{where}" if where.isdigit() else f"{scheme}:{where or default}:14550"
        raise UsageError(f"{source} lacks its host or port.", f"Did you mean {guess}?")
    host, port = found["host"].strip("[]") or default, int(found["port"])
    if not 0 < port < 65_536:
        raise UsageError(f"{source} has no valid port: {port}.", "Ports are 1 to 65535; MAVLink's is 14550.")
    if scheme in ("udpout", "tcp") and host in ("0.0.0.0", "::"):
        raise UsageError(
            f"{source} names no machine: {host} means 'any'.",
            f"Give the vehicle's address, or {scheme}:127.0.0.1:{port} for this machine.",
        )
    return _NETWORK[scheme](host, port)


def _serial(rest: str) -> Serial:
    found = re.fullmatch(r"(?P<device>.+?)(?::(?P<baud>\d+))?", rest)
    if found is None or not re.match(r"/|COM\d", found["device"]):
        raise UsageError(f"{rest} is not a serial port.", "Give a device such as /dev/ttyACM0:115200.")
    return Serial(found["device"], int(found["baud"] or DEFAULT_BAUD))


def _simulated(rest: str) -> Simulated:
    vehicle, *options = rest.split(",")
    if vehicle not in VEHICLES:
        raise UsageError(
            f"There is no simulated vehicle {vehicle!r}.",
            f"{_did_you_mean(vehicle, VEHICLES, 'sim:')}The vehicles are {', '.join(VEHICLES)}.",
        )
    seed, effects = 0, list[str]()
    for option in options:
        name, _, value = option.partition("=")
        if name == "seed" and value.isdecimal():
            seed = int(value)
        elif name == "effect" and value:
            effects += [effect for effect in value.split("+") if effect]
        else:
            raise UsageError(
                f"{option!r} is not understood in sim:{rest}.",
                "After the vehicle come seed=NUMBER and effect=NAME[+NAME..].",
            )
    return Simulated(vehicle, seed, tuple(effects))


def _mavsdk(source: str) -> Mavsdk:
    url = source.partition("+")[2]
    match parse_address(url):
        case UdpIn() | UdpOut() | Tcp() | TcpIn() as port:
            return Mavsdk(f"{port.mavsdk_scheme}://{_bracketed(port.host)}:{port.port}")
        case Serial(device, baud):
            return Mavsdk(f"serial://{device}:{baud}")
    raise UsageError(f"MAVSDK cannot open {url}.", "Use mavsdk+udpin://0.0.0.0:14550 or another port.")


def _unknown(source: str, scheme: str) -> UsageError:
    known = [*_NETWORK, "serial", "sim", "replay", "mavsdk+udpin"]
    if re.fullmatch(r"(\[[^\]]+\]|localhost|[\w-]+(\.[\w-]+)+):\d+/?", source):
        return UsageError(
            f"{source!r} does not say what kind of link.", f"Did you mean tcp:{source}, or udpout:{source}?"
        )
    if scheme:
        hint = _did_you_mean(scheme, known, "", f":{source.partition(':')[2]}")
        return UsageError(f"{source!r} is not an address: {scheme!r} is no kind of link.", hint + _REMEDY)
    if source in VEHICLES:
        return UsageError(f"{source!r} is not an address.", f"Did you mean sim:{source}?")
    if suffix := Path(source).suffix:
        return UsageError(
            f"{source!r} is neither an address nor a recording: {suffix} is not a suffix that is read.",
            f"Recordings end in {', '.join(RECORDING_SUFFIXES)}.",
        )
    return UsageError(f"{source!r} is neither an address nor a recording.", _REMEDY)


def _did_you_mean(word: str, known: tuple[str, ...] | list[str], before: str, after: str = "") -> str:
    near = difflib.get_close_matches(word, known, n=1)
    return f"Did you mean {before}{near[0]}{after}? " if near else ""
