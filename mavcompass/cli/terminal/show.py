"""How a procedure shows itself: a live line with a bar, or plain lines in a pipe; prompts spoken aloud."""

from __future__ import annotations

import contextlib
import math
import os
import re
import shutil
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Container, Iterator, Sequence
from contextlib import contextmanager
from typing import Any

from mavcompass.cli.terminal.lines import is_live, wrapped
from mavcompass.errors import UsageError
from mavcompass.printable import printable
from mavcompass.procedure.script import Ask, Show

_PROMPT_EVERY_S = 1.0
_ROOM_FOR_A_BAR = 60
_YES, _NO = ("y", "yes"), ("", "n", "no")
_MARKS = {
    "connect": "·",
    "turn": "↻",
    "dwell": "■",
    "solve": "=",
    "write": ">",
    "written": "✓",
    "prove": "✓",
    "undo": "!",
    "taken": "✓",
}


def _has(show: Show, name: str) -> bool:
    return any(key == name and value for key, value in show.data)


class PlainShow:
    """Print one line per step on standard error; the same step twice in a row only once.

    Prompts that change all the time ("Turn right 34 deg more.") are printed once a second, the first of a
    step at once.
    """

    def __init__(self, told_later: Container[str] = (), quiet: bool = False) -> None:
        self._told_later = told_later
        self._quiet = quiet
        self._last: Show | None = None
        self._prompted_s = -math.inf

    def ask(self, question: Ask) -> Callable[[], bool | None]:
        """Put a question."""
        return ask_on_terminal(question)

    def __call__(self, show: Show) -> None:
        """Print a line."""
        later = show.step in self._told_later and show.fraction is not None
        last, self._last = self._last, show
        if self._quiet or later or (last is not None and show.text == last.text):
            return
        if _has(show, "live"):
            now_s = time.monotonic()
            if last is not None and show.step == last.step and now_s - self._prompted_s < _PROMPT_EVERY_S:
                return
            self._prompted_s = now_s
        print(printable(show.text), file=sys.stderr, flush=True)


class LiveShow:
    """Keep one live line with a bar; finished steps scroll up above it, but for those that are told later.

    A question takes its place until it is answered.
    """

    def __init__(self, progress: Any, told_later: Container[str] = ()) -> None:
        self._told_later = told_later
        self._progress = progress
        self._task = progress.add_task("", total=1.0)
        self._last: Show | None = None

    def ask(self, question: Ask) -> Callable[[], bool | None]:
        """Put a question; the next step brings the live line back."""
        self._progress.stop()
        return ask_on_terminal(question)

    def __call__(self, show: Show) -> None:
        """Show a step; ring the terminal's bell where a person who turns the vehicle should look up."""
        if _has(show, "cue"):
            self._progress.console.bell()
        if (
            self._last is not None
            and self._last.step != show.step
            and self._last.step not in self._told_later
        ):
            self._progress.console.print(
                f"[dim]{_MARKS.get(self._last.step, '·')} {printable(self._last.text)}[/dim]", highlight=False
            )
        self._last = show
        self._progress.start()
        update = {"description": f"{_MARKS.get(show.step, '·')} {printable(show.text)}"}
        if show.fraction is not None:
            self._progress.update(self._task, completed=show.fraction, **update)
        else:
            self._progress.update(self._task, **update)


@contextmanager
def showing(quiet: bool = False, told_later: Container[str] = ()) -> Iterator[PlainShow | LiveShow]:
    """Show a procedure's progress on standard error while the block runs.

    Args:
        told_later: steps whose outcome is shown again in the same place, as the result.
    """
    if quiet or not is_live():
        yield PlainShow(told_later, quiet)
        return
    from rich.console import Console
    from rich.progress import BarColumn, Progress, TextColumn, TimeElapsedColumn

    console = Console(stderr=True, no_color=bool(os.environ.get("NO_COLOR")))
    # The text has the room: what is no prompt may be cut, and a phone's terminal is too narrow for a bar.
    wide = console.width >= _ROOM_FOR_A_BAR
    columns = (BarColumn(bar_width=24), TextColumn("{task.description}"), TimeElapsedColumn())[not wide :]
    with Progress(*columns, console=console, transient=True) as progress:
        yield LiveShow(progress, told_later)


def ask_on_terminal(question: Ask) -> Callable[[], bool | None]:
    """Put a yes-or-no question on the terminal; the answer is read beside the running procedure.

    What is neither is asked again; an end of the input, and an empty line, are no.
    """
    answers: list[bool] = []
    choices = "[y/N, d: details]" if question.details else "[y/N]"

    def say(*lines: str) -> None:
        told = (wrapped(printable(line), sys.stderr) for line in lines)
        print(*told, sep="\n", end=" ", file=sys.stderr, flush=True)

    def read() -> None:
        say(*question.about, f"{question.question} {choices}")
        while not answers:
            try:
                word = sys.stdin.readline().strip().lower()
            except (OSError, ValueError):
                word = ""
            if word in _YES or word in _NO:
                answers.append(word in _YES)
            elif question.details and word in ("d", "details"):
                say(*question.details, f"{question.question} {choices}")
            else:
                say(f"Please answer y or n. {question.question} {choices}")

    threading.Thread(target=read, name="answer", daemon=True).start()
    return lambda: answers[0] if answers else None


# Programs that say their last argument and end when it is said; the first one found speaks.
SPEAKERS: tuple[tuple[str, ...], ...] = (("spd-say", "--wait"), ("espeak-ng",), ("espeak",), ("say",))
# A running number ("Turn right 34 deg more.") is not said anew before the last one can be acted upon.
_PAUSE_S = 2.0
_LAST_WORDS_S = 5.0
_SPOKEN_STEPS = frozenset({"prove", "undo"})
_WORDS = ((r"\bdeg\b", "degrees"), (r"(\d) s\b", r"\1 seconds"), (r"\bmG\b", "milligauss"))


class Speaker:
    """Say what a procedure shows: prompts as there is time for them, what counts at once."""

    def __init__(self, command: Sequence[str], clock: Callable[[], float] = time.monotonic) -> None:
        self._command = tuple(command)
        self._clock = clock
        self._speaking: subprocess.Popen[bytes] | None = None
        self._said, self._said_s = "", -math.inf

    def __call__(self, show: Show) -> None:
        """Say a step, or let it pass."""
        kinds = {name for name, value in show.data if value}
        urgent = "cue" in kinds or show.step in _SPOKEN_STEPS
        if show.text == self._said or not (urgent or "live" in kinds):
            return
        if not urgent and (self._is_speaking() or self._clock() - self._said_s < _PAUSE_S):
            return
        self._be_quiet()
        with contextlib.suppress(OSError):  # what cannot be said is on the screen
            self._speaking = subprocess.Popen(
                [*self._command, spoken(show.text)],
                stdin=subprocess.DEVNULL,
                stdout=subprocess.DEVNULL,
                stderr=subprocess.DEVNULL,
            )
        self._said, self._said_s = show.text, self._clock()

    def close(self) -> None:
        """Let the last words be said, and end."""
        if self._speaking is not None:
            with contextlib.suppress(subprocess.TimeoutExpired):
                self._speaking.wait(_LAST_WORDS_S)
            self._be_quiet()

    def _is_speaking(self) -> bool:
        return self._speaking is not None and self._speaking.poll() is None

    def _be_quiet(self) -> None:
        if self._speaking is None:
            return
        if self._speaking.poll() is None:
            self._speaking.terminate()
        try:
            self._speaking.wait(1.0)
        except subprocess.TimeoutExpired:
            self._speaking.kill()
            self._speaking.wait()
        self._speaking = None


def spoken(text: str) -> str:
    """Spell a prompt as it is to be said."""
    for short, long in _WORDS:
        text = re.sub(short, long, text)
    return text


def find_speaker() -> tuple[str, ...]:
    """Find a program that speaks. Raises UsageError where there is none."""
    for command in SPEAKERS:
        if shutil.which(command[0]) is not None:
            return command
    names = ", ".join(command[0] for command in SPEAKERS)
    raise UsageError(
        f"There is no program here that speaks ({names}).",
        "Install one of them, or leave --speak out: the terminal's bell calls for attention too.",
    )


@contextmanager
def speaking(show: Callable[[Show], None], aloud: bool) -> Iterator[Callable[[Show], None]]:
    """Say beside showing while the block runs, where that is wanted."""
    if not aloud:
        yield show
        return
    speaker = Speaker(find_speaker())

    def both(what: Show) -> None:
        show(what)
        speaker(what)

    try:
        yield both
    finally:
        speaker.close()
