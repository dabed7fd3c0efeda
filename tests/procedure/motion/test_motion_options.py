"""The options of `mavcompass calibrate` that are about motion."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from mavcompass.cli.main import main


@pytest.fixture(autouse=True)
def own_state(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("XDG_STATE_HOME", str(tmp_path))


@pytest.mark.parametrize(
    ("options", "told"),
    [
        (["--motion", "hand"], ["armed: turning it by hand is not safe"]),
        (["--turn-by", "rc-override"], ["it turns itself in MANUAL only", "--set-mode"]),
    ],
    ids=["by hand, armed", "by the pilot's controls, another mode"],
)
def test_what_is_not_safe_or_not_allowed_is_refused(
    options: list[str], told: list[str], capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["calibrate", "sim:rover", "--yes", *options]) == 7
    said = capsys.readouterr().err
    assert all(words in said for words in told)


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
