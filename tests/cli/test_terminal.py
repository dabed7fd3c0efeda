"""What a procedure leaves on a person's terminal."""

from __future__ import annotations

import io
import os
import re
import time
from pathlib import Path

import click
import pytest
from click.testing import CliRunner
from rich.console import Console
from rich.progress import Progress

from mavcompass.cli import calibrate, doctor
from mavcompass.cli.calibration import _told_later
from mavcompass.cli.heading import Row
from mavcompass.cli.main import main
from mavcompass.cli.options import Output
from mavcompass.cli.terminal.lines import dial, wrapped
from mavcompass.cli.terminal.show import (
    LiveShow,
    PlainShow,
    Speaker,
    ask_on_terminal,
    find_speaker,
    speaking,
    spoken,
)
from mavcompass.errors import UsageError
from mavcompass.installation.invocation import program
from mavcompass.procedure.script import Ask, Show
from mavcompass.procedure.vehicle_state import VehicleIdentity


@pytest.mark.parametrize(("told_later", "times"), [((), 1), (("solve",), 0)])
def test_a_step_that_the_result_tells_again_does_not_stay(told_later: tuple[str, ...], times: int) -> None:
    console = Console(file=io.StringIO(), width=100)
    with Progress(console=console, disable=True) as progress:
        show = LiveShow(progress, told_later)
        for step, text in (("turn", "Turning."), ("solve", "Compass 1: accepted."), ("write", "Writing.")):
            show(Show(step, text))
    assert isinstance(console.file, io.StringIO)
    assert console.file.getvalue().count("Turning.") == 1
    assert console.file.getvalue().count("Compass 1: accepted.") == times


@pytest.mark.parametrize(("told_later", "times"), [((), 1), (("solve", "prove"), 0)])
def test_a_pipe_is_told_an_outcome_once(
    told_later: tuple[str, ...], times: int, capsys: pytest.CaptureFixture[str]
) -> None:
    show = PlainShow(told_later)
    show(Show("solve", "Compass 1: accepted.", 0.8))
    show(Show("prove", "One more turn proves the new values."))
    show(Show("prove", "Proven.", 1.0))
    said = capsys.readouterr().err
    assert said.count("accepted") == said.count("Proven.") == times
    assert said.count("One more turn") == 1


def test_what_the_same_eyes_see_again_is_told_once() -> None:
    assert "solve" in _told_later(Output())
    assert _told_later(Output("-")) == ()


@pytest.mark.parametrize(
    ("typed", "yes", "asked"),
    [("y\n", True, 1), ("\n", False, 1), ("", False, 1), ("maybe\nYES\n", True, 2), ("d\nn\n", False, 2)],
)
def test_what_is_neither_yes_nor_no_is_asked_again(
    typed: str, yes: bool, asked: int, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr("sys.stdin", io.StringIO(typed))
    poll = ask_on_terminal(Ask("Write it?", ("Compass 1: 24.9 -> 0.2 deg off.",), ("COMPASS_OFS_X 5 -> 60",)))
    while (answer := poll()) is None:
        time.sleep(0.01)
    said = capsys.readouterr().err
    assert answer is yes and said.count("Write it?") == asked
    assert said.index("24.9") < said.index("Write it?") and said.endswith("details] ")
    assert ("COMPASS_OFS_X" in said) is typed.startswith("d")


@pytest.mark.parametrize(
    ("columns", "told"),
    [(40, "247.2 true ±23.0"), (80, "247.2 true ±23.0  234.6 magnetic  65 s"),
     (200, "247.2 true ±23.0  234.6 magnetic  65 s")],
)  # fmt: skip
def test_a_dial_leaves_out_whole_what_has_no_room(
    columns: int, told: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    screen = io.StringIO()
    monkeypatch.setattr("sys.stdout", screen)
    monkeypatch.setattr(screen, "isatty", lambda: True, raising=False)
    monkeypatch.setenv("TERM", "xterm")
    monkeypatch.setenv("NO_COLOR", "1")
    monkeypatch.setenv("COLUMNS", str(columns))
    with dial() as draw:
        assert draw is not None
        draw(247.2, Row(65.0, 234.6, 23.0, 247.2, None).figures())
    (line,) = (part for part in re.split(r"\r|\x1b\[K|\n", screen.getvalue()) if part)
    assert line.endswith(f"  {told}") and len(line) < columns and "[" in line


def test_a_line_breaks_at_its_words_and_a_command_stays_whole(monkeypatch: pytest.MonkeyPatch) -> None:
    screen = io.StringIO()
    monkeypatch.setattr(screen, "isatty", lambda: True, raising=False)
    monkeypatch.setenv("COLUMNS", "40")
    sentence = "Stopped by Ctrl-C. It no longer turns; it is armed. Nothing was written."
    lines = wrapped(sentence, screen).splitlines()
    assert all(len(line) < 40 for line in lines) and " ".join(map(str.strip, lines)) == sentence
    command = f"To undo: {program()} params restore sim:rover /a/long/way/to/an/undo/file.json --yes"
    assert wrapped(command, screen) == command
    assert wrapped(sentence, io.StringIO()) == sentence, "a pipe gets lines as they are"


@pytest.mark.parametrize(
    ("arguments", "guess"),
    [
        (["calibrat", "sim:rover"], "Did you mean 'calibrate'?"),
        (["gap", "diagnos"], "Did you mean 'diagnose'?"),
        (["sim:rover"], "mavcompass calibrate sim:rover"),
        (["calibrate", "192.168.1.1:5760", "--dry-run"], "Did you mean tcp:192.168.1.1:5760"),
        (["calibrate", "sim:rovr", "--dry-run"], "Did you mean sim:rover"),
    ],
)
def test_a_near_miss_gets_a_guess(
    arguments: list[str], guess: str, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(arguments) == 2
    assert guess in capsys.readouterr().err


def test_every_option_of_a_long_help_stands_in_one_group(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["calibrate", "--help"]) == 0
    said = capsys.readouterr().out
    for parameter in calibrate.command.params:
        for name in parameter.opts if isinstance(parameter, click.Option) else ():
            assert len(re.findall(rf"^  (-\w, )?{name}(?![\w-])", said, re.MULTILINE)) == 1, name
    assert said.count("e.g. mavcompass calibrate") == len(calibrate.command.groups) == 5
    assert "<=" not in said, "a range is spelt as people write it"


@pytest.mark.parametrize(
    ("heard", "answers", "command"),
    [
        ({}, "", []),
        ({"tcp:127.0.0.1:5760": [1]}, "1\n", ["check", "tcp:127.0.0.1:5760", "--turn", "none"]),
        ({"tcp:127.0.0.1:5760": [1]}, "3\nn\n", []),
        ({"tcp:127.0.0.1:5760": [1, 2]}, "2\n3\ny\n", ["calibrate", "tcp:127.0.0.1:5760", "--system", "2"]),
    ],
)
def test_alone_it_finds_vehicles_and_asks_at_most_three_questions(
    heard: dict[str, list[int]], answers: str, command: list[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    def at(place: str) -> list[tuple[str, VehicleIdentity]]:
        return [(place, VehicleIdentity(n, 1, "ardupilot", "rover")) for n in heard.get(place, ())]

    monkeypatch.setattr(doctor, "vehicles_at", at)
    found: list[str] = []

    @click.command()
    def look() -> None:
        found.extend(doctor.look_around())

    result = CliRunner().invoke(look, input=answers, catch_exceptions=False)
    assert found == command, result.output
    assert answers.count("\n") <= 3 and ("doctor" in result.output) is not bool(heard)


def test_a_vehicle_is_heard_where_one_is_and_nobody_elsewhere() -> None:
    assert [v.kind for _, v in doctor.vehicles_at("sim:rover")] == ["rover"]
    assert doctor.vehicles_at("tcp:127.0.0.1:1") == []


# --- Prompts said aloud: by a program that only writes down what it is given, as machines have no speaker


ALWAYS, LIVE = (("cue", 1.0),), (("live", 1.0),)


@pytest.fixture
def heard(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """Put a program that speaks first on the PATH; the file holds what it was given to say."""
    said = tmp_path / "said.txt"
    program = tmp_path / "espeak-ng"
    program.write_text(f'#!/bin/sh\nprintf "%s\\n" "$*" >> "{said}"\n')
    program.chmod(0o755)
    monkeypatch.setenv("PATH", f"{tmp_path}{os.pathsep}/usr/bin{os.pathsep}/bin")
    monkeypatch.setattr("mavcompass.cli.terminal.show.SPEAKERS", (("espeak-ng",),))
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
