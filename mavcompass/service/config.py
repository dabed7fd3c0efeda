"""The service's configuration: TOML, checked as a whole at the start, each error with its line."""

from __future__ import annotations

import ipaddress
import os
import re
import tomllib
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, fields
from difflib import get_close_matches
from pathlib import Path
from typing import Any

from mavcompass.errors import MavCompassError, UsageError

# Returns what is wrong with a value, as the rest of a sentence that begins with the key; None if nothing is.
Check = Callable[[Any], str | None]


def _number(low: float, high: float) -> Check:
    def check(value: Any) -> str | None:
        if isinstance(value, bool) or not isinstance(value, int | float):
            return "must be a number"
        return None if low <= value <= high else f"must be between {low:g} and {high:g}"

    return check


def _integer(low: int, high: int) -> Check:
    def check(value: Any) -> str | None:
        if isinstance(value, bool) or not isinstance(value, int):
            return "must be a whole number"
        return None if low <= value <= high else f"must be between {low} and {high}"

    return check


def _switch(value: Any) -> str | None:
    return None if isinstance(value, bool) else "must be true or false"


def _text(value: Any) -> str | None:
    return None if isinstance(value, str) and value else "must be a text that is not empty"


def _optional_text(value: Any) -> str | None:
    return None if isinstance(value, str) else "must be a text"


def _list_of(element: Check, what: str) -> Check:
    def check(value: Any) -> str | None:
        if not isinstance(value, list):
            return f"must be a list of {what}"
        return next((wrong for wrong in map(element, value) if wrong is not None), None)

    return check


def _source(value: Any) -> str | None:
    if (wrong := _text(value)) is not None:
        return wrong
    from mavcompass.vehicle.transport import Recording, parse_address

    try:
        address = parse_address(value)
    except MavCompassError as error:
        return f"is not an address: {error}"
    return "must be a vehicle, not a recording" if isinstance(address, Recording) else None


def _host_and_port(value: Any) -> str | None:
    if (wrong := _text(value)) is not None:
        return wrong
    try:
        split_host_port(value)
    except ValueError as error:
        return str(error)
    return None


def _publish_address(value: Any) -> str | None:
    if value == "":
        return None
    if not isinstance(value, str) or not value.startswith("udp:"):
        return 'must be "udp:HOST:PORT", or "" for none'
    return _host_and_port(value.removeprefix("udp:"))


def _origin(value: Any) -> str | None:
    good = isinstance(value, str) and re.fullmatch(r"https?://[^/\s]+", value)
    return None if good else 'must be origins such as "http://boat.local:8808", without a path'


def split_host_port(text: str) -> tuple[str, int]:
    """Split HOST:PORT or [IPV6]:PORT; raises ValueError with the rest of a sentence."""
    host, colon, port = text.rpartition(":")
    host = host.removeprefix("[").removesuffix("]")
    if not colon or not host:
        raise ValueError("must be HOST:PORT, such as 127.0.0.1:8808")
    if not port.isdecimal() or int(port) > 65535:
        raise ValueError(f"has the port {port!r}, which is not a number from 0 to 65535")
    return host, int(port)


def state_folder() -> Path:
    """Return where the service keeps its data unless told: systemd's state folder or the XDG one."""
    if given := os.environ.get("STATE_DIRECTORY"):
        return Path(given.split(":")[0])
    state = os.environ.get("XDG_STATE_HOME") or Path.home() / ".local" / "state"
    return Path(state) / "mavcompass"


def _key(default: Any, check: Check) -> Any:
    return field(default=default, metadata={"check": check})


@dataclass(frozen=True, slots=True)
class VehicleConfig:
    """Say which vehicle to serve.

    Attributes:
        source: its address. system: its MAVLink id where several share the link, 0 for the first heard.
        compasses: those to calibrate, counted from 1; empty means all that it has.
        rate_hz: at which IMU messages are asked for. speed: of a simulated vehicle's time.
    """

    source: str = _key("udpin:127.0.0.1:14571", _source)
    system: int = _key(0, _integer(0, 255))
    compasses: tuple[int, ...] = _key((), _list_of(_integer(1, 3), "compass numbers"))
    rate_hz: float = _key(40.0, _number(1.0, 1000.0))
    speed: float = _key(1.0, _number(0.01, 1000.0))


@dataclass(frozen=True, slots=True)
class HttpConfig:
    """Say who may talk to the web page and its interface.

    Attributes:
        listen: HOST:PORT; loopback unless told. token_file: where the secret lies that writing and moving
            need ("": `token` in the storage folder; made at the first start).
        allowed_origins, allowed_hosts: pages of other places, and names of this machine, to accept.
    """

    listen: str = _key("127.0.0.1:8808", _host_and_port)
    token_file: str = _key("", _optional_text)
    allowed_origins: tuple[str, ...] = _key((), _list_of(_origin, "origins"))
    allowed_hosts: tuple[str, ...] = _key((), _list_of(_text, "host names"))


@dataclass(frozen=True, slots=True)
class MavlinkConfig:
    """Say what ground stations see of the service.

    Attributes:
        accept_commands: let them start calibrations. heading_hz: of NAMED_VALUE_FLOAT; 0 sends none.
        statustext: tell the pilot what the watch finds.
    """

    accept_commands: bool = _key(True, _switch)
    heading_hz: float = _key(5.0, _number(0.0, 50.0))
    statustext: bool = _key(True, _switch)


@dataclass(frozen=True, slots=True)
class HeadingConfig:
    """Say where each heading goes as a JSON datagram: `publish` is "udp:HOST:PORT" or empty."""

    publish: str = _key("", _publish_address)


@dataclass(frozen=True, slots=True)
class WatchConfig:
    """Say what the watch over the compass in service calls worth a word.

    Attributes:
        field_percent, dip_deg: difference of the field's strength and dip from the world model.
        agreement_deg: between two compasses. gyro_deg: heading's change against the gyro's, rms.
        course_deg: heading against the GPS course of a vehicle that drives ahead.
        current_deg: swing of the heading that goes with the battery's current.
        age_days: from which a calibration is called old.
    """

    field_percent: float = _key(8.0, _number(0.5, 100.0))
    dip_deg: float = _key(4.0, _number(0.2, 90.0))
    agreement_deg: float = _key(8.0, _number(0.2, 180.0))
    gyro_deg: float = _key(6.0, _number(0.2, 180.0))
    course_deg: float = _key(12.0, _number(0.2, 180.0))
    current_deg: float = _key(4.0, _number(0.2, 180.0))
    age_days: float = _key(365.0, _number(0.01, 36500.0))


@dataclass(frozen=True, slots=True)
class StorageConfig:
    """Say where history, undo files and reports lie ("": systemd's or the user's state folder)."""

    folder: str = _key("", _optional_text)


@dataclass(frozen=True, slots=True)
class ServiceConfig:
    """Hold the whole configuration; every table may be left out."""

    vehicle: VehicleConfig = VehicleConfig()
    http: HttpConfig = HttpConfig()
    mavlink: MavlinkConfig = MavlinkConfig()
    heading: HeadingConfig = HeadingConfig()
    watch: WatchConfig = WatchConfig()
    storage: StorageConfig = StorageConfig()

    @property
    def folder(self) -> Path:
        """Return the storage folder."""
        return Path(self.storage.folder) if self.storage.folder else state_folder()

    @property
    def token_file(self) -> Path:
        """Return the file that holds the secret."""
        return Path(self.http.token_file) if self.http.token_file else self.folder / "token"

    @property
    def is_open_to_the_network(self) -> bool:
        """Tell whether other machines can reach the page."""
        host, _ = split_host_port(self.http.listen)
        if host == "localhost":
            return False
        try:
            return not ipaddress.ip_address(host).is_loopback
        except ValueError:
            return True


_TABLES: dict[str, type] = {
    "vehicle": VehicleConfig,
    "http": HttpConfig,
    "mavlink": MavlinkConfig,
    "heading": HeadingConfig,
    "watch": WatchConfig,
    "storage": StorageConfig,
}


def load_config(path: Path) -> ServiceConfig:
    """Read a configuration file. Raises UsageError naming every mistake with its line."""
    try:
        text = path.read_text(encoding="utf-8")
    except OSError as error:
        raise UsageError(
            f"The configuration {path} cannot be read ({error.strerror}).", "Check --config."
        ) from error
    except UnicodeDecodeError as error:
        raise UsageError(f"The configuration {path} is not UTF-8 text.", "Save it as UTF-8.") from error
    return parse_config(text, str(path))


def parse_config(text: str, name: str = "configuration") -> ServiceConfig:
    """Check a configuration's text; see `load_config`."""
    try:
        document = tomllib.loads(text)
    except tomllib.TOMLDecodeError as error:
        raise UsageError(f"{name}: {error}.", "Mend this line; TOML's form is at https://toml.io.") from error
    mistakes: list[tuple[int, str]] = []
    tables: dict[str, Any] = {}
    for table, values in document.items():
        if table not in _TABLES or not isinstance(values, dict):
            known = "known tables" if isinstance(values, dict) else "every key stands in a table; there are"
            line = _line_of(text, table, None) if isinstance(values, dict) else _line_of(text, "", table)
            mistakes.append(
                (line, f"{table!r}{_did_you_mean(table, _TABLES)} ({known}: {', '.join(_TABLES)})")
            )
            continue
        tables[table] = _table(text, table, values, mistakes)
    if mistakes:
        lines = "\n".join(f"  {name}:{line}: {what}" for line, what in sorted(mistakes))
        raise UsageError(
            f"The configuration has {len(mistakes)} mistake{'s' if len(mistakes) > 1 else ''}:\n{lines}\n",
            "Correct it; docs/operating.md lists every key.",
        )
    return ServiceConfig(**tables)


def _table(text: str, table: str, values: Mapping[str, Any], mistakes: list[tuple[int, str]]) -> Any:
    """Check the keys of one table, add what is wrong to `mistakes`, and return what is right."""
    kind = _TABLES[table]
    checks = {f.name: f.metadata["check"] for f in fields(kind)}
    good: dict[str, Any] = {}
    for key, value in values.items():
        if key not in checks:
            wrong: str | None = f"is not known{_did_you_mean(key, checks)}"
        else:
            wrong = checks[key](value)
        if wrong is not None:
            mistakes.append((_line_of(text, table, key), f"{table}.{key} {wrong}"))
        else:
            good[key] = tuple(value) if isinstance(value, list) else value
    return kind(**good)


def _did_you_mean(word: str, known: Mapping[str, Any]) -> str:
    close = get_close_matches(word, known, n=1)
    return f", did you mean {close[0]!r}?" if close else ""


def _line_of(text: str, table: str, key: str | None) -> int:
    """Find the line on which a key is set, else its table's, else the first."""
    current, at_table = "", 1
    for number, line in enumerate(text.splitlines(), 1):
        if header := re.match(r"\s*\[+\s*([^\]]+?)\s*\]+", line):
            current = header[1].strip("\"'")
            if current == table:
                at_table = number
                if key is None:
                    return number
            continue
        name = re.match(r"""\s*(["']?)([\w.-]+)\1\s*=""", line)
        if name is None or key is None:
            continue
        full = f"{current}.{name[2]}" if current else name[2]
        if full == (f"{table}.{key}" if table else key):
            return number
    return at_table
