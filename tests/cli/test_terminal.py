"""What a procedure leaves on a person's terminal."""

from __future__ import annotations

import io

import pytest
from rich.console import Console
from rich.progress import Progress

from mavcompass.cli.calibration.vehicle import _told_later
from mavcompass.cli.options import Output
from mavcompass.cli.terminal.show import LiveShow, PlainShow
from mavcompass.procedure.script import Show


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


def test_who_is_asked_whether_to_write_sees_first_what_was_found() -> None:
    assert "solve" in _told_later(Output(), "yes")
    assert "solve" not in _told_later(Output(), "ask")
    assert _told_later(Output("-"), "yes") == ()
