"""The options of `mavcompass calibrate` that are about motion."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from mavcompass.cli.main import main


@pytest.fixture(autouse=True)
def own_state(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("XDG_STATE_HOME", str(tmp_path))


def test_the_pilots_controls_in_another_mode_are_refused(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["calibrate", "sim:rover", "--yes", "--turn-by", "rc-override"]) == 7
    said = capsys.readouterr().err
    assert "it turns itself in MANUAL only" in said and "--set-mode" in said


def test_by_hand_a_person_of_the_simulation_turns_it(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["calibrate", "sim:rover", "--yes", "--motion", "hand"]) == 0
    assert "Here." in capsys.readouterr().err


def test_the_pilots_controls_turn_it_when_the_mode_may_be_set(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    result = tmp_path / "result.json"
    words = ["calibrate", "sim:rover", "--yes", "--turn-by", "manual-control", "--set-mode"]
    code = main([*words, "--json", str(result)])
    told = capsys.readouterr().err
    assert code == 0, told
    assert "Changing the flight mode to MANUAL." in told
    assert json.loads(result.read_text())["true_heading_error_deg"]["after"] < 0.5
