"""The service's configuration: TOML, checked as a whole at the start, each error with its line."""

from __future__ import annotations

import ipaddress
import os
import re
import tomllib
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any, get_type_hints

from msgspec import Meta

from mavcompass.errors import MavCompassError, UsageError
from mavcompass.files import read_text
from mavcompass.installation.private_files import state_directory
from mavcompass.printable import did_you_mean
from mavcompass.service.models import Compass, Mistakes, Text, checked, read


def _source(value: str) -> str | None:
    from mavcompass.vehicle.transport import Recording, parse_address

    try:
        address = parse_address(value)
    except MavCompassError as error:
        return f"is not an address: {error}"
    return "must be a vehicle, not a recording" if isinstance(address, Recording) else None


def _host_and_port(value: str) -> str | None:
    try:
        split_host_port(value)
    except ValueError as error:
        return str(error)
    return None


def _publish_address(value: str) -> str | None:
    if value and not value.startswith("udp:"):
        return 'must be "udp:HOST:PORT", or "" for none'
    return _host_and_port(value.removeprefix("udp:")) if value else None


def _origins(values: tuple[str, ...]) -> str | None:
    good = all(re.fullmatch(r"https?://[^/\s;,'\"]+", value) for value in values)
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
    return state_directory()


@dataclass(frozen=True, slots=True)
class VehicleConfig:
    """Say which vehicle to serve.

    Attributes:
        source: its address. system: its MAVLink id where several share the link, 0 where there is one only.
        compasses: those to calibrate, counted from 1; empty means all that it has.
        rate_hz: at which IMU messages are asked for. speed: of a simulated vehicle's time.
        sign_key_file: holds the key that frames are signed and checked with ("": they are not).
    """

    source: Annotated[Text, checked(_source)] = "udpin:127.0.0.1:14571"
    system: Annotated[int, Meta(ge=0, le=255)] = 0
    compasses: tuple[Compass, ...] = ()
    rate_hz: Annotated[float, Meta(ge=1.0, le=1000.0)] = 40.0
    speed: Annotated[float, Meta(ge=0.01, le=1000.0)] = 1.0
    sign_key_file: str = ""


@dataclass(frozen=True, slots=True)
class HttpConfig:
    """Say who may talk to the web page and its interface.

    Attributes:
        listen: HOST:PORT; loopback unless told. token_file: where the secret lies that writing and moving
            need ("": `token` in the storage folder; made at the first start).
        allowed_origins, allowed_hosts: pages of other places, and names of this machine, to accept.
        framed_by: origins whose pages may show ours in a frame; "http://{host}" is port 80 of this machine,
            by whatever name it was called. Programs of this machine are then handed the token, as BlueOS
            needs for its menu.
    """

    listen: Annotated[Text, checked(_host_and_port)] = "127.0.0.1:8808"
    token_file: str = ""
    allowed_origins: Annotated[tuple[str, ...], checked(_origins)] = ()
    allowed_hosts: tuple[Text, ...] = ()
    framed_by: Annotated[tuple[str, ...], checked(_origins)] = ()


@dataclass(frozen=True, slots=True)
class MavlinkConfig:
    """Say what ground stations see of the service.

    Attributes:
        accept_commands: let them start calibrations. heading_hz: of NAMED_VALUE_FLOAT; 0 sends none.
        statustext: tell the pilot what the watch finds.
    """

    accept_commands: bool = True
    heading_hz: Annotated[float, Meta(ge=0.0, le=50.0)] = 5.0
    statustext: bool = True


@dataclass(frozen=True, slots=True)
class HeadingConfig:
    """Say where each heading goes as a JSON datagram: `publish` is "udp:HOST:PORT" or empty."""

    publish: Annotated[str, checked(_publish_address)] = ""


@dataclass(frozen=True, slots=True)
class WatchConfig:
    """Say what the watch over the compass in service calls worth a word.

    Attributes:
        field_percent, dip_deg: difference of the field's strength and dip from the world model.
        agreement_deg: between two compasses. gyro_deg: heading's change against the gyro's, rms.
        course_deg: heading against the GPS course of a vehicle that drives ahead.
        current_deg: swing of the heading that goes with the battery's current.
        step_deg: what a change of the field, while the vehicle stands disarmed, may make of the heading.
        age_days: from which a calibration is called old.
    """

    field_percent: Annotated[float, Meta(ge=0.5, le=100.0)] = 8.0
    dip_deg: Annotated[float, Meta(ge=0.2, le=90.0)] = 4.0
    agreement_deg: Annotated[float, Meta(ge=0.2, le=180.0)] = 8.0
    gyro_deg: Annotated[float, Meta(ge=0.2, le=180.0)] = 6.0
    course_deg: Annotated[float, Meta(ge=0.2, le=180.0)] = 12.0
    current_deg: Annotated[float, Meta(ge=0.2, le=180.0)] = 4.0
    step_deg: Annotated[float, Meta(ge=0.2, le=180.0)] = 1.5
    age_days: Annotated[float, Meta(ge=0.01, le=36500.0)] = 365.0


@dataclass(frozen=True, slots=True)
class LearningConfig:
    """Say whether the service learns while the vehicle works, and what it offers to write.

    Attributes:
        enabled: learn. margin_deg: by so much an offer lowers the heading error in force, at three sigmas.
        limit_deg: the largest heading error, 1 sigma, that is offered: of what more motion would lower.
    """

    enabled: bool = True
    margin_deg: Annotated[float, Meta(ge=0.5, le=90.0)] = 2.0
    limit_deg: Annotated[float, Meta(ge=0.1, le=5.0)] = 0.5


@dataclass(frozen=True, slots=True)
class StorageConfig:
    """Say where history, undo files and reports lie ("": systemd's or the user's state folder)."""

    folder: str = ""


@dataclass(frozen=True, slots=True)
class ServiceConfig:
    """Hold the whole configuration; every table may be left out."""

    vehicle: VehicleConfig = VehicleConfig()
    http: HttpConfig = HttpConfig()
    mavlink: MavlinkConfig = MavlinkConfig()
    heading: HeadingConfig = HeadingConfig()
    watch: WatchConfig = WatchConfig()
    learning: LearningConfig = LearningConfig()
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


_TABLES = get_type_hints(ServiceConfig)


def load_config(path: Path) -> ServiceConfig:
    """Read a configuration file. Raises UsageError naming every mistake with its line."""
    try:
        text = read_text(path)
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
    except RecursionError as error:
        raise UsageError(
            f"{name}: its brackets stand too deep.", "No key here needs a list of lists."
        ) from error
    mistakes: list[tuple[int, str]] = []
    tables: dict[str, Any] = {}
    for table, values in document.items():
        if not isinstance(values, dict):
            what = f"{table!r} stands alone; every key stands in a table (there are: {', '.join(_TABLES)})"
            mistakes.append((_line_of(text, table), what))
        elif table not in _TABLES:
            what = f"is not known{did_you_mean(table, _TABLES)} (there are: {', '.join(_TABLES)})"
            mistakes.append((_line_of(text, table), f"table {table!r} {what}"))
        else:
            try:
                tables[table] = read(_TABLES[table], values)
            except Mistakes as wrong:
                told = ((f"{table}.{key}", what) for key, what in wrong.found)
                mistakes += [(_line_of(text, name), f"{name} {what}") for name, what in told]
    if mistakes:
        raise UsageError(
            f"The configuration has {len(mistakes)} mistake{'s' if len(mistakes) > 1 else ''}:",
            "Correct it; `mavcompass serve --print-config` lists every key with its default.",
            tuple(f"{name}:{line}: {what}" for line, what in sorted(mistakes)),
        )
    return ServiceConfig(**tables)


def _line_of(text: str, name: str) -> int:
    """Find the line on which a table, or a key of one, is set; else the key's table's, else the first."""
    table, lines = "", dict[str, int]()
    for number, line in enumerate(text.splitlines(), 1):
        if header := re.match(r"\s*\[+\s*([^\]]+?)\s*\]+", line):
            table = header[1].strip("\"'")
            lines.setdefault(table, number)
        elif key := re.match(r"""\s*(["']?)([\w.-]+)\1\s*=""", line):
            lines[f"{table}.{key[2]}".lstrip(".")] = number
    return lines.get(name) or lines.get(name.partition(".")[0], 1)
