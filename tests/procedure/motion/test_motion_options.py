"""The options of `mavcompass calibrate` that are about motion."""

from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path

import pytest


@pytest.fixture(autouse=True)
def own_state(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("XDG_STATE_HOME", str(tmp_path))


def exit_code(*arguments: str) -> tuple[int, str]:
    """Run the program as a person does and return its exit code and what it told."""
    done = subprocess.run(
        [sys.executable, "-m", "mavcompass", "calibrate", *arguments],
        capture_output=True,
        text=True,
        timeout=60,
        check=False,
    )
    return done.returncode, done.stderr


def test_turning_an_armed_vehicle_by_hand_is_refused() -> None:
    code, told = exit_code("sim:rover", "--yes", "--motion", "hand")
    assert code == 7
    assert "armed: turning it by hand is not safe" in told


def test_the_pilots_controls_want_manual() -> None:
    code, told = exit_code("sim:rover", "--yes", "--turn-by", "rc-override")
    assert code == 7
    assert "it turns itself in MANUAL only" in told and "--set-mode" in told


def test_the_pilots_controls_turn_it_when_the_mode_may_be_set(
    tmp_path: Path,
) -> None:
    result = tmp_path / "result.json"
    code, told = exit_code(
        "sim:rover", "--yes", "--turn-by", "manual-control", "--set-mode", "--json", str(result)
    )
    assert code == 0, told
    assert "Changing the flight mode to MANUAL." in told
    assert json.loads(result.read_text())["true_heading_error_deg"]["after"] < 0.5
