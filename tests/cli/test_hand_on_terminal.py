"""A whole session on a terminal: a script reads the prompts off a tmux screen and turns the vehicle."""

from __future__ import annotations

import json
import math
import re
import shutil
import subprocess
import sys
import time
from pathlib import Path

import pytest

from mavcompass.simulation.heading_error import heading_error_rms_deg
from mavcompass.simulation.physics.hand import HandMove
from mavcompass.simulation.vehicle import SimulatedAutopilot
from mavcompass.vehicle.links.server import VehicleServer
from mavcompass.vehicle.transport import TcpIn, open_transport

SPEED = 3.0
LONGEST_S = 300.0  # what hangs ends by it


class Screen:
    """Run a command in a tmux session of its own and look at its screen."""

    def __init__(self, folder: Path, command: str) -> None:
        self._tmux = ["tmux", "-S", str(folder / "tmux.socket")]
        start = ["new-session", "-d", "-x", "120", "-y", "40", command]
        subprocess.run([*self._tmux, "-f", "/dev/null", *start], check=True, timeout=300)

    def text(self) -> str:
        shown = subprocess.run(
            [*self._tmux, "capture-pane", "-p"], capture_output=True, text=True, timeout=300, check=False
        )
        return shown.stdout

    def close(self) -> None:
        subprocess.run([*self._tmux, "kill-server"], capture_output=True, timeout=300, check=False)


class Person:
    """Do what the screen says."""

    def __init__(self, vehicle: SimulatedAutopilot) -> None:
        self._vehicle = vehicle
        self._busy_until_s = 0.0
        self.told: list[str] = []

    def look(self, screen: str) -> None:
        prompts = re.findall(r"(Turn (?:right|left) \d+ deg more\.|Hold still \d s\.|Tilted by .*)", screen)
        if not prompts:
            return
        self.told.append(prompts[-1])
        turn = re.match(r"Turn (right|left) (\d+)", prompts[-1])
        if turn is not None and self._vehicle.time_s > self._busy_until_s:
            degrees = float(turn[2]) if turn[1] == "right" else -float(turn[2])
            self._vehicle.turn_by_hand([HandMove(math.radians(degrees), lasts_s=2.0, rests_s=0.5)])
            self._busy_until_s = self._vehicle.time_s + 3.5


@pytest.mark.skipif(shutil.which("tmux") is None, reason="needs tmux")
def test_a_person_who_follows_the_screen_calibrates_the_vehicle(tmp_path: Path) -> None:
    vehicle = SimulatedAutopilot("rover", seed=4, armed=False)
    vehicle.advance(10.0)
    transport = open_transport(TcpIn("127.0.0.1", 0))
    server = VehicleServer(vehicle, transport, speed=SPEED)
    result, ended = tmp_path / "result.json", tmp_path / "ended"
    command = (
        f"{sys.executable} -m mavcompass calibrate tcp:127.0.0.1:{transport.name.rpartition(':')[2]}"
        f" --yes --json {result}; echo $? > {ended}; sleep 30"
    )
    person = Person(vehicle)
    screen = Screen(tmp_path, f"env XDG_STATE_HOME={tmp_path} sh -c '{command}'")
    try:
        end_s, look_s = time.monotonic() + LONGEST_S, 0.0
        while not ended.exists() and time.monotonic() < end_s:
            server.turn()
            transport.wait(0.004)
            if time.monotonic() >= look_s:
                person.look(screen.text())
                look_s = time.monotonic() + 0.15
        last = screen.text()
    finally:
        screen.close()
        transport.close()
    assert ended.exists() and ended.read_text().strip() == "0", last
    assert json.loads(result.read_text())["verified"]
    assert heading_error_rms_deg(vehicle) < 0.5
    assert any(text.startswith("Turn right 9") for text in person.told)
    assert any(re.fullmatch(r"Hold still [12] s\.", text) for text in person.told)
