"""Tell systemd how the service is: READY, WATCHDOG, STOPPING (sd_notify's protocol, a datagram)."""

from __future__ import annotations

import os
import socket
from collections.abc import Mapping


class Notifier:
    """Send notifications to the service manager; without one (NOTIFY_SOCKET unset) do nothing."""

    def __init__(self, environment: Mapping[str, str] = os.environ) -> None:
        address = environment.get("NOTIFY_SOCKET", "")
        # "@" stands for the null byte of Linux's abstract names.
        self._address = "\0" + address[1:] if address.startswith("@") else address
        self.watchdog_s = _watchdog_s(environment)

    @property
    def active(self) -> bool:
        """Tell whether a service manager listens."""
        return bool(self._address)

    def ready(self, status: str) -> None:
        """Say that the service does its work."""
        self._send(f"READY=1\nSTATUS={status}")

    def status(self, text: str) -> None:
        """Set the line that `systemctl status` shows."""
        self._send(f"STATUS={text}")

    def alive(self) -> None:
        """Keep the watchdog from restarting us."""
        self._send("WATCHDOG=1")

    def stopping(self) -> None:
        """Say that the service is ending as it should."""
        self._send("STOPPING=1")

    def _send(self, text: str) -> None:
        if not self._address:
            return
        with socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM | socket.SOCK_CLOEXEC) as sender:
            try:
                sender.sendto(text.encode(), self._address)
            except OSError:
                pass  # the manager went away; it will restart us if it wants


def _watchdog_s(environment: Mapping[str, str]) -> float | None:
    """Return the watchdog's time, None where there is none or it is meant for another process."""
    if environment.get("WATCHDOG_PID", str(os.getpid())) != str(os.getpid()):
        return None
    try:
        return int(environment["WATCHDOG_USEC"]) * 1e-6
    except (KeyError, ValueError):
        return None
