"""The module inside the real MAVProxy, on the simulated vehicle's TCP port."""

from __future__ import annotations

import subprocess
import sys
import threading
from collections.abc import Iterator
from importlib.util import find_spec
from pathlib import Path

import pytest
from serving import serving

from mavcompass.simulation.vehicle import SimulatedAutopilot

MAVPROXY = Path(sys.executable).with_name("mavproxy.py")

pytestmark = pytest.mark.skipif(
    find_spec("MAVProxy") is None or not MAVPROXY.exists(), reason="MAVProxy is not installed"
)


@pytest.fixture
def port() -> Iterator[int]:
    with serving(SimulatedAutopilot("rover", seed=3), speed=5.0) as (_, port):
        yield port


def mavproxy(port: int, folder: Path, command: str, until: str, timeout_s: float = 120.0) -> str:
    """Run MAVProxy with a command until it says something; return all it said."""
    process = subprocess.Popen(
        [
            sys.executable,
            str(MAVPROXY),
            f"--master=tcp:127.0.0.1:{port}",
            "--non-interactive",
            "--default-modules=",
            f"--state-basedir={folder}",
            f"--cmd=module load mavcompass; {command}",
        ],
        cwd=folder,
        stdin=subprocess.DEVNULL,
        stdout=subprocess.PIPE,
        stderr=subprocess.STDOUT,
        text=True,
    )
    alarm = threading.Timer(timeout_s, process.kill)
    alarm.start()
    told: list[str] = []
    assert process.stdout is not None
    try:
        for line in process.stdout:
            told.append(line)
            if until in line:
                break
    finally:
        alarm.cancel()
        process.kill()
        process.stdout.close()
        process.wait()
    return "".join(told)


# What its commands do is asked in virtual time, in test_mavproxy_dialogue.py.
def test_mavproxy_loads_the_module_which_checks_the_vehicle_on_its_link(port: int, tmp_path: Path) -> None:
    told = mavproxy(port, tmp_path, "mavcompass check", "mavcompass: Not fit to ")
    assert "Loaded module mavcompass" in told
    assert "mavcompass: FAIL  Compass 1: the field's dip is" in told, told


def test_the_module_states_its_licence_and_no_other_file_imports_mavproxy() -> None:
    package = Path(__file__).parents[3] / "mavcompass"
    importing = [
        path.relative_to(package).as_posix()
        for path in package.rglob("*.py")
        if "from MAVProxy" in path.read_text() or "import MAVProxy" in path.read_text()
    ]
    assert importing == ["service/mavproxy.py"]
    head = (package / importing[0]).read_text()[:1200]
    assert "SPDX-License-Identifier: GPL-3.0-or-later" in head
