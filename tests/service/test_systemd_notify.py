"""What the service manager hears."""

from __future__ import annotations

import math
import os
import socket
import time
from itertools import pairwise
from pathlib import Path

import pytest
from running_service import StartService

from mavcompass.service.run import Notifier


def test_the_manager_is_told_three_times_in_the_watchdogs_time(
    manager: socket.socket, monkeypatch: pytest.MonkeyPatch, start_service: StartService
) -> None:
    monkeypatch.setenv("NOTIFY_SOCKET", manager.getsockname())
    monkeypatch.setenv("WATCHDOG_USEC", "900000")
    start_service()
    heard = [(manager.recv(1000), time.monotonic()) for _ in range(12)]
    alive_s = [at_s for words, at_s in heard if words == b"WATCHDOG=1"]
    assert len(alive_s) > 6 and min(b - a for a, b in pairwise(alive_s[4:])) < 0.4


def test_the_manager_hears_ready_alive_and_stopping(manager: socket.socket) -> None:
    notifier = Notifier({"NOTIFY_SOCKET": manager.getsockname()})
    assert notifier.active
    notifier.ready("serving")
    notifier.alive()
    notifier.status("no vehicle heard")
    notifier.stopping()
    heard = [manager.recv(1000) for _ in range(4)]
    assert heard == [b"READY=1\nSTATUS=serving", b"WATCHDOG=1", b"STATUS=no vehicle heard", b"STOPPING=1"]


def test_an_abstract_name_is_understood() -> None:
    with socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM) as receiver:
        receiver.bind(f"\0mavcompass-test-{os.getpid()}")
        receiver.settimeout(5.0)
        Notifier({"NOTIFY_SOCKET": f"@mavcompass-test-{os.getpid()}"}).alive()
        assert receiver.recv(100) == b"WATCHDOG=1"


def test_without_a_manager_nothing_happens(tmp_path: Path) -> None:
    notifier = Notifier({})
    notifier.ready("x")
    assert not notifier.active
    assert notifier.watchdog_s == math.inf
    Notifier({"NOTIFY_SOCKET": str(tmp_path / "gone")}).alive()


@pytest.mark.parametrize(
    ("environment", "watchdog_s"),
    [
        ({"WATCHDOG_USEC": "30000000"}, 30.0),
        ({"WATCHDOG_USEC": "30000000", "WATCHDOG_PID": str(os.getpid())}, 30.0),
        ({"WATCHDOG_USEC": "30000000", "WATCHDOG_PID": "1"}, math.inf),
        ({"WATCHDOG_USEC": "soon"}, math.inf),
    ],
)
def test_the_watchdog_is_taken_from_the_environment(environment: dict[str, str], watchdog_s: float) -> None:
    assert Notifier(environment).watchdog_s == watchdog_s
