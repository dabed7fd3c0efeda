"""`mavcompass simulate` as a person starts it: a process of its own."""

from __future__ import annotations

import json
import re
import signal
import socket
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path

import pytest
from click.testing import CliRunner
from pymavlink import mavutil
from serving import hear

from mavcompass.cli.simulate import command
from mavcompass.errors import UsageError
from mavcompass.messages import Attitude, Heartbeat
from mavcompass.vehicle.opening import open_link
from mavcompass.vehicle.transport import Tcp

SIMULATE = [sys.executable, "-m", "mavcompass", "simulate", "--listen", "tcp:127.0.0.1:0"]
Start = Callable[..., subprocess.Popen[str]]


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_it_says_where_it_is_and_ends_cleanly_on_a_signal(
    number: int, tmp_path: Path, start_process: Start
) -> None:
    tlog, result = tmp_path / "a.tlog", tmp_path / "a.json"
    process = start_process(*SIMULATE, "--speed", "5", "--tlog", str(tlog), "--json", str(result))
    assert process.stdout is not None
    line = process.stdout.readline()
    found = re.search(r"tcpin:127\.0\.0\.1:(\d+)", line)
    assert found, line
    with open_link(Tcp("127.0.0.1", int(found[1]))) as link:
        hear(link, Heartbeat)
        hear(link, Attitude)
    process.send_signal(number)
    _, complaints = process.communicate()
    assert process.returncode == 0 and not complaints
    assert json.loads(result.read_text())["vehicle"] == "rover"
    recording = mavutil.mavlink_connection(str(tlog))
    first = recording.recv_match(type="HEARTBEAT", blocking=False)
    assert first is not None and recording.recv_match(type="ATTITUDE") is not None
    assert 1.7e9 < first._timestamp < 1.9e9
    recording.close()


def test_quiet_is_quiet(start_process: Start) -> None:
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as listener:
        listener.bind(("127.0.0.1", 0))
        listener.settimeout(300.0)
        process = start_process(*SIMULATE[:-1], f"udpout:127.0.0.1:{listener.getsockname()[1]}", "--quiet")
        assert listener.recv(1000)
        process.terminate()
        assert (*process.communicate(), process.returncode) == ("", "", 0)


@pytest.mark.parametrize(
    ("arguments", "hint"),
    [
        (["--listen", "sim:rover"], "listen"),
        (["--listen", "tcp:127.0.0.1:0", "--effect", "hard_irn"], "hard_irn"),
        (["--listen", "tcp:127.0.0.1:0", "--tlog", "/nowhere/a.tlog"], "tlog"),
        (["--listen", "tcp:203.0.113.1:5760"], "cannot be listened on"),
    ],
)
def test_wrong_usage_is_told_before_anything_runs(arguments: list[str], hint: str) -> None:
    result = CliRunner().invoke(command, arguments)
    assert isinstance(result.exception, UsageError) and hint in str(result.exception)
