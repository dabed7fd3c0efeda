"""MavsdkLink: a vehicle reached through MAVSDK (mavsdk >= 4), for stacks that already are MAVSDK.

MAVSDK's own Telemetry drops the sensor's id and the second compass and labels milligauss as gauss, so all
messages go through its `mavlink_direct`, whose fields are JSON: numbers that are not finite arrive and
leave as null, which becomes NaN. MAVSDK knows no clock of ours, hides sequence numbers, reconnects by
itself, and sends a heartbeat of its own beside the one we send.
"""

from __future__ import annotations

import json
import logging
import math
import queue
import time
from dataclasses import fields
from functools import cache
from typing import Any

from mavcompass.errors import LinkLost, NoVehicle
from mavcompass.messages import Incoming, Message
from mavcompass.vehicle.link import ONBOARD_COMPUTER, Identity, Link
from mavcompass.vehicle.wire import decode, encode, kind_named

_log = logging.getLogger(__name__)

# MAVSDK's queues know no limit; a program that does not listen must not fill the memory.
_MOST_WAITING = 20_000
# After a change of who we are MAVSDK starts anew; the vehicle is known again with its next heartbeat.
_REDISCOVERY_S = 2.5


class MavsdkLink(Link):
    """Speak through MAVSDK. `url` is in its spelling, such as udpin://0.0.0.0:14550."""

    def __init__(self, url: str, identity: Identity = ONBOARD_COMPUTER) -> None:
        super().__init__(f"mavsdk+{url}", identity)
        self._url = url
        self._inbox: queue.SimpleQueue[Any] = queue.SimpleQueue()
        self._mavsdk: Any = None
        self._directs: dict[int, Any] = {}
        self._systems: list[Any] = []
        self._speaking_as = (0, 0)
        self._closed = False
        self._start()

    def now(self) -> float:
        """Return the monotonic clock."""
        return time.monotonic()

    def send(self, message: Message) -> None:
        """Send a message; before MAVSDK knows a system it is dropped."""
        if not self._closed and self._speaking_as != self._own_address():
            self._start_anew()
        target = getattr(message, "target_system", 0)
        # Any system's door will do for a message to all: MAVSDK sends it on all its connections.
        way = self._directs.get(target) or next(iter(self._directs.values()), None)
        if way is None or not _send(way, message):
            self.statistics.dropped += 1

    def receive(self, timeout_s: float) -> Incoming | None:
        """Return the next message; see Link."""
        deadline_s = self.now() + timeout_s
        while not self._closed:
            try:
                item = self._inbox.get(timeout=max(deadline_s - self.now(), 0.0))
            except queue.Empty:
                return None
            if item is None:
                self._listen_to_new_systems()
            elif (incoming := self._read(*item)) is not None:
                return incoming
        raise LinkLost(f"{self.name} is closed.")

    def close(self) -> None:
        """Leave MAVSDK and let go of its port."""
        self._closed = True
        self._stop()

    def _own_address(self) -> tuple[int, int]:
        return self.identity.spoken_system, self.identity.component

    def _start(self) -> None:
        from mavsdk.connection_result import ConnectionResult
        from mavsdk.mavsdk import Configuration, Mavsdk

        _log_through_python()
        self._speaking_as = self._own_address()
        # Always with heartbeats: a router answers only to those it has heard.
        self._mavsdk = Mavsdk(Configuration.create_manual(*self._speaking_as, True))
        self._mavsdk.subscribe_on_new_system(lambda _: self._inbox.put(None))
        result = self._mavsdk.add_any_connection(self._url)
        if result != ConnectionResult.SUCCESS:
            self._stop()
            reason = result.name.lower().replace("_", " ")
            raise NoVehicle(
                f"MAVSDK could not open {self._url}: {reason}.",
                "Check the address, and that no other program uses this port.",
            )

    def _stop(self) -> None:
        for direct in self._directs.values():
            direct.destroy()
        self._directs.clear()
        self._systems.clear()
        if self._mavsdk is not None:
            self._mavsdk.destroy()
            self._mavsdk = None

    def _start_anew(self) -> None:
        """Speak under another address, which MAVSDK only takes when it starts."""
        known = set(self._directs)
        self._stop()
        self._start()
        give_up_s = self.now() + _REDISCOVERY_S
        while not known <= set(self._directs) and self.now() < give_up_s:
            time.sleep(0.01)
            self._listen_to_new_systems()

    def _listen_to_new_systems(self) -> None:
        from mavsdk.plugins.mavlink_direct import MavlinkDirect

        for system in self._mavsdk.get_systems():
            number = system.get_system_id()
            if number not in self._directs:
                self._systems.append(system)  # MAVSDK destroys what nobody holds
                self._directs[number] = MavlinkDirect(system)
                self._directs[number].subscribe_message("", self._take)

    def _take(self, heard: Any, _: object) -> None:
        """Run in MAVSDK's thread, which only prints what goes wrong here."""
        if self._inbox.qsize() < _MOST_WAITING:
            self._inbox.put((time.monotonic(), heard))
        else:
            self.statistics.dropped += 1

    def _read(self, time_s: float, heard: Any) -> Incoming | None:
        kind = kind_named(heard.message_name)
        if kind is None:
            self.statistics.unknown += 1
            return None
        message = from_json(kind, heard.fields_json)
        if message is None:
            self.statistics.malformed += 1
            return None
        self.statistics.received += 1
        return Incoming(time_s, heard.system_id, heard.component_id, message)


def to_json(message: Message) -> str:
    """Write a message's fields as MAVSDK wants them: texts cut to their length, not finite as null."""
    form, payload = encode(message)
    rounded = decode(form.id, payload)
    assert rounded is not None
    values = {field.name: _finite(getattr(rounded, field.name)) for field in fields(rounded)}
    return json.dumps(values, allow_nan=False)


def from_json(kind: type[Message], text: str) -> Message | None:
    """Read a message from MAVSDK's JSON; None where that is not one."""
    try:
        given = json.loads(text)
        if not isinstance(given, dict):
            return None
        return kind(
            **{name: _read(given[name], default) for name, default in _defaults(kind) if name in given}
        )
    except (ValueError, TypeError):
        return None


_DEFAULTS: dict[type[Message], tuple[tuple[str, Any], ...]] = {}


def _defaults(kind: type[Message]) -> tuple[tuple[str, Any], ...]:
    if kind not in _DEFAULTS:
        empty = kind()
        _DEFAULTS[kind] = tuple((field.name, getattr(empty, field.name)) for field in fields(kind))
    return _DEFAULTS[kind]


def _read(value: Any, default: Any) -> Any:
    """Read a value of the same type as `default`; raises ValueError or TypeError where it is none."""
    match default:
        case str():
            return str(value)
        case float():
            return math.nan if value is None else float(value)
        case tuple():
            return tuple(_read(item, default[0]) for item in value)
    return int(value)


def _finite(value: Any) -> Any:
    match value:
        case float():
            return value if math.isfinite(value) else None
        case tuple():
            return [_finite(item) for item in value]
    return value


def _send(direct: Any, message: Message) -> bool:
    from mavsdk.plugins.mavlink_direct import MavlinkDirectError, MavlinkMessage

    try:
        direct.send_message(MavlinkMessage(message.wire_name(), fields_json=to_json(message)))
    except MavlinkDirectError as error:
        _log.info("not sent: %s", error)
        return False
    return True


@cache
def _log_through_python() -> None:
    """Keep MAVSDK's log off the standard output, which may be carrying JSON."""
    from mavsdk.logging import log_subscribe

    def log(level: Any, text: str, file: str | None, line: int) -> bool:
        _log.debug("MAVSDK: %s", text)
        return True

    log_subscribe(log)
