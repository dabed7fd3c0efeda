"""What a procedure leaves on a person's terminal."""

from __future__ import annotations

import io

import pytest
from rich.console import Console
from rich.progress import Progress

from mavcompass.cli.terminal.show import LiveShow
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
