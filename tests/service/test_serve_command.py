"""`mavcompass serve` as a process: what it prints, tells the service manager, weighs, and how it ends."""

from __future__ import annotations

import json
import os
import re
import signal
import socket
import subprocess
import sys
import time
import urllib.request
from collections.abc import Callable
from pathlib import Path

import pytest
from click.testing import CliRunner

from mavcompass.cli.serve import command
from mavcompass.errors import UsageError
from mavcompass.service import addresses


def test_it_serves_tells_the_manager_stays_small_and_ends_on_sigterm(
    tmp_path: Path, manager: socket.socket, start_process: Callable[..., subprocess.Popen[str]]
) -> None:
    (tmp_path / "data" / "recordings").mkdir(parents=True)  # of a version that let others read
    words = [sys.executable, "-m", "mavcompass", "serve", "sim:rover,seed=3", "--http", "127.0.0.1:0"]
    environment = {**os.environ, "NOTIFY_SOCKET": manager.getsockname(), "WATCHDOG_USEC": "300000"}
    process = start_process(*words, "--storage", str(tmp_path / "data"), env=environment)
    heard = [manager.recv(1000).decode()]
    assert heard[0].startswith("READY=1\n")
    assert process.stdout is not None
    printed = [process.stdout.readline() for _ in range(3)]
    page = re.search(r"(http://\S+/)#token=(\S+)", printed[1])
    assert page is not None, printed
    while not any(line.endswith(": vehicle heard") for line in heard):
        heard.append(manager.recv(1000).decode())
    began_s = time.monotonic()
    beats = [manager.recv(1000).decode() for _ in range(10)]
    assert set(beats) == {"WATCHDOG=1"} and time.monotonic() - began_s < 5.0  # three within what it waits
    with urllib.request.urlopen(f"{page[1]}api/state", timeout=300) as answer:
        assert json.load(answer)["vehicle"]["kind"] == "rover"
    pages = int(Path(f"/proc/{process.pid}/statm").read_text().split()[1])
    assert pages * os.sysconf("SC_PAGE_SIZE") < 90e6
    maps = Path(f"/proc/{process.pid}/maps").read_text()
    assert "/scipy/" not in maps and "/matplotlib/" not in maps
    for name in ("recordings", "history.db", "history.db-wal", "token"):
        assert (tmp_path / "data" / name).stat().st_mode & 0o077 == 0, name
    process.send_signal(signal.SIGTERM)
    assert process.wait(20.0) == 0
    while heard[-1] != "STOPPING=1":
        heard.append(manager.recv(1000).decode())
    assert [line for line in heard if line.startswith("STATUS=")][-1].endswith(": vehicle heard")
    _, complaints = process.communicate()
    assert "Traceback" not in complaints


def test_every_way_to_the_page_is_told_and_a_phone_can_read_it(monkeypatch: pytest.MonkeyPatch) -> None:
    two = {"10.0.0.3": "eth0", "172.16.0.9": "wlan0"}
    monkeypatch.setattr(addresses, "addresses_of_this_computer", lambda: two)
    urls = addresses.page_urls("0.0.0.0", 8808)
    assert urls == {"http://10.0.0.3:8808/": "eth0", "http://172.16.0.9:8808/": "wlan0"}
    assert list(addresses.page_urls("fd00::2", 1)) == ["http://[fd00::2]:1/"]
    drawn = addresses.qr_code(f"{next(iter(urls))}#token={'x' * 32}")
    assert all(len(re.sub(r"\x1b\[[\d;]*m", "", line)) <= 40 for line in drawn), "a phone's terminal"
    monkeypatch.setattr(addresses, "addresses_of_this_computer", dict)
    assert addresses.page_urls("0.0.0.0", 8808) == {"http://127.0.0.1:8808/": ""}


def test_loopback_is_none_of_the_addresses_for_others() -> None:
    assert not any(address.startswith(("127.", "0.")) for address in addresses.addresses_of_this_computer())


def test_the_command_line_goes_before_the_configuration(tmp_path: Path) -> None:
    """A port that is taken shows which address was meant."""
    (tmp_path / "boat.toml").write_text('[vehicle]\nsource = "sim:boat"\n[http]\nlisten = "127.0.0.1:1"\n')
    with socket.create_server(("127.0.0.1", 0)) as taken:
        address = f"127.0.0.1:{taken.getsockname()[1]}"
        arguments = ["--config", str(tmp_path / "boat.toml"), "--http", address, "--storage", str(tmp_path)]
        result = CliRunner().invoke(command, arguments, standalone_mode=False)
    assert isinstance(result.exception, UsageError)
    assert address in result.exception.what


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        ([], "No vehicle was named"),
        (["nowhere"], "SOURCE 'nowhere' is not an address"),
        (["flight.tlog"], "not a recording"),
        (["sim:rover", "--http", "8808"], "--http '8808' must be HOST:PORT"),
        (["--config", "/nowhere.toml"], "cannot be read"),
    ],
)
def test_wrong_usage_is_told(arguments: list[str], words: str) -> None:
    result = CliRunner().invoke(command, arguments, standalone_mode=False)
    assert isinstance(result.exception, UsageError), result.exception
    assert words in result.exception.what
