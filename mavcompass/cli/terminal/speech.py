"""Prompts spoken aloud, for a person whose hands and eyes are on the vehicle."""

from __future__ import annotations

import contextlib
import math
import re
import shutil
import subprocess
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager

from mavcompass.errors import UsageError
from mavcompass.procedure.script import Show

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
