"""Prompts said aloud: by a program that only writes down what it is given, as machines have no speaker."""

from __future__ import annotations

import os
import time
from pathlib import Path

import pytest

from mavcompass.cli.main import main
from mavcompass.cli.terminal.speech import Speaker, find_speaker, speaking, spoken
from mavcompass.errors import UsageError
from mavcompass.procedure.script import Show

ALWAYS, LIVE = (("cue", 1.0),), (("live", 1.0),)


@pytest.fixture
def heard(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """Put a program that speaks first on the PATH; the file holds what it was given to say."""
    said = tmp_path / "said.txt"
    program = tmp_path / "espeak-ng"
    program.write_text(f'#!/bin/sh\nprintf "%s\\n" "$*" >> "{said}"\n')
    program.chmod(0o755)
    monkeypatch.setenv("PATH", f"{tmp_path}{os.pathsep}/usr/bin{os.pathsep}/bin")
    monkeypatch.setattr("mavcompass.cli.terminal.speech.SPEAKERS", (("espeak-ng",),))
    return said


def wait_for(said: Path, lines: int) -> list[str]:
    end_s = time.monotonic() + 20.0
    while time.monotonic() < end_s:
        words = said.read_text().splitlines() if said.exists() else []
        if len(words) >= lines:
            return words
        time.sleep(0.01)
    raise AssertionError(f"only {words} was said")


def test_a_prompt_is_said_in_words(heard: Path) -> None:
    with speaking(lambda _: None, aloud=True) as show:
        show(Show("turn", "Turn right 34 deg more.", data=LIVE))
        assert wait_for(heard, 1) == ["Turn right 34 degrees more."]


def test_a_running_number_is_not_said_again_at_once_but_what_counts_is(heard: Path) -> None:
    now_s = 0.0
    speaker = Speaker(find_speaker(), clock=lambda: now_s)
    speaker(Show("turn", "Turn right 34 deg more.", data=LIVE))
    wait_for(heard, 1)
    now_s = 1.0
    speaker(Show("turn", "Turn right 30 deg more.", data=LIVE))
    speaker(Show("turn", "Here.", data=ALWAYS))
    wait_for(heard, 2)
    speaker(Show("turn", "Here.", data=ALWAYS))
    speaker(Show("solve", "Compass 1: accepted."))
    speaker.close()
    now_s = 4.0
    speaker(Show("turn", "Hold still 2 s.", data=LIVE))
    speaker.close()
    assert wait_for(heard, 3) == ["Turn right 34 degrees more.", "Here.", "Hold still 2 seconds."]


def test_silence_is_the_rule(heard: Path) -> None:
    shown: list[Show] = []
    with speaking(shown.append, aloud=False) as show:
        show(Show("turn", "Here.", data=ALWAYS))
    assert len(shown) == 1 and not heard.exists()


def test_units_are_words() -> None:
    assert spoken("Tilted by 12 deg: level it.") == "Tilted by 12 degrees: level it."
    assert spoken("Hold still 2 s.") == "Hold still 2 seconds."


def test_without_a_program_that_speaks_the_option_is_refused(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    monkeypatch.setenv("PATH", str(tmp_path))
    with pytest.raises(UsageError, match="no program here that speaks"):
        find_speaker()


def test_the_command_speaks(heard: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("MAVCOMPASS_UNDO_DIR", str(tmp_path))
    assert main(["calibrate", "sim:rover", "--yes", "--speak"]) == 0
    assert "Turning once more to check the new values." in wait_for(heard, 1)[0]
