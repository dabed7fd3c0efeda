"""One program at a time works on a vehicle: a lock between the processes of this computer.

It is a listening socket in Linux's abstract namespace, which belongs to the computer and not to a user or a
folder: a service of its own user with its own /tmp meets it, and it ends with its process, however that ends.
"""

from __future__ import annotations

import errno
import hashlib
import logging
import socket
import struct
from pathlib import Path

from mavcompass.errors import Refused
from mavcompass.procedure.nameplate import Nameplate

_log = logging.getLogger(__name__)
_ANSWERS_WITHIN_S = 0.5
_PEER = struct.Struct("3i")  # struct ucred: process, user, group


class VehicleLock:
    """Hold at most one vehicle, as a context manager; `where` it is met tells apart what has no unique id."""

    def __init__(self, where: str) -> None:
        self._where = where
        self._held: tuple[bytes, socket.socket] | None = None

    def __enter__(self) -> VehicleLock:
        return self

    def __exit__(self, *_: object) -> None:
        self.release()

    def hold(self, plate: Nameplate) -> None:
        """Hold a vehicle until `release`, where it is not held already. Raises Refused where another does."""
        who = f"{plate.key} {plate.system if plate.uid else self._where}"
        name = b"\0mavcompass-" + hashlib.sha256(who.encode()).digest()
        if self._held is not None and self._held[0] == name:
            return
        self.release()
        door = socket.socket(socket.AF_UNIX, socket.SOCK_STREAM)
        try:
            door.bind(name)
            door.listen()
        except OSError as error:
            door.close()
            if error.errno == errno.EADDRINUSE:
                raise Refused(
                    f"Another program works on this vehicle ({plate}): {_holder(name)}.",
                    "Wait until it has ended, or stop it; then run again.",
                ) from None
            _log.warning("other programs cannot be kept off the vehicle here (%s)", error)
            return
        self._held = name, door

    def release(self) -> None:
        """Let the vehicle go."""
        if self._held is not None:
            self._held[1].close()
            self._held = None


def _holder(name: bytes) -> str:
    """Name the process behind a lock."""
    try:
        with socket.socket(socket.AF_UNIX, socket.SOCK_STREAM) as door:
            door.settimeout(_ANSWERS_WITHIN_S)
            door.connect(name)
            process = _PEER.unpack(door.getsockopt(socket.SOL_SOCKET, socket.SO_PEERCRED, _PEER.size))[0]
        words = Path(f"/proc/{process}/cmdline").read_bytes().rstrip(b"\0").replace(b"\0", b" ").decode()
        return f"process {process}, {words}"
    except (OSError, ValueError):
        return "which one cannot be told"
