"""What a terminal can: colours, and lines that are drawn anew; plain text elsewhere.

Drawn anew are a compass whose card slides past a mark, a bar of what is done, and what is being done.
"""

from __future__ import annotations

import os
import shutil
import sys
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from typing import TextIO

import click

from mavcompass.installation.invocation import program

_COLOURS = {"pass": "green", "warn": "yellow", "fail": "red"}


def styled(text: str, *, fg: str | None = None, bold: bool = False, err: bool = False) -> str:
    """Colour a text for standard output (or `err`: standard error) where that is a terminal with colours."""
    stream = sys.stderr if err else sys.stdout
    if not stream.isatty() or os.environ.get("NO_COLOR") or os.environ.get("TERM", "dumb") == "dumb":
        return text
    return click.style(text, fg=fg, bold=bold)


def wrapped(line: str, stream: TextIO) -> str:
    """Break a line at its words where a terminal would amid one; a command stays whole, to be copied."""
    width = shutil.get_terminal_size().columns - 1
    if not stream.isatty() or f"{program()} " in line or len(click.unstyle(line)) <= width:
        return line
    first, *words = line.split(" ")
    hang = " " * (len(line) - len(line.lstrip(" ")) + 2)
    lines = [first]
    for word in words:
        if len(click.unstyle(f"{lines[-1]} {word}")) <= width:
            lines[-1] += f" {word}"
        else:
            lines.append(hang + word)
    return "\n".join(lines)


def is_live(stream: TextIO | None = None) -> bool:
    """Tell whether a person looks at a stream (standard error) in a terminal that can redraw a line."""
    return (stream or sys.stderr).isatty() and os.environ.get("TERM", "dumb") != "dumb"


def mark(verdict: str) -> str:
    """Return PASS, WARN or FAIL, coloured on a terminal that has colours."""
    word = verdict.upper()
    return styled(word, fg=_COLOURS[verdict], bold=True)


_POINTS = {0: "N", 45: "NE", 90: "E", 135: "SE", 180: "S", 225: "SW", 270: "W", 315: "NW"}
_DEG_PER_COLUMN = 5
_COLUMNS = 31
_AROUND = 6  # the mark, the gap, and the last column, in which some terminals break the line
_REST_OF_LINE = "\x1b[K"
_BOLD, _PLAIN = "\x1b[1m", "\x1b[0m"


def card(heading_deg: float, columns: int = _COLUMNS) -> str:
    """Draw the part of the compass card around a heading; the middle column is where the nose points."""
    middle = columns // 2
    first_deg = round(heading_deg / _DEG_PER_COLUMN) * _DEG_PER_COLUMN - middle * _DEG_PER_COLUMN
    drawn = list(" " * columns)
    for column in range(columns):
        deg = (first_deg + column * _DEG_PER_COLUMN) % 360
        if deg in _POINTS:
            for place, letter in enumerate(_POINTS[deg], start=column):
                if place < columns:
                    drawn[place] = letter
        elif drawn[column] == " ":
            drawn[column] = "·" if deg % 15 == 0 else " "
    return "".join(drawn)


@contextmanager
def dial(wanted: bool = True) -> Iterator[Callable[[float, Sequence[str]], None] | None]:
    """Give a function that redraws the line with a heading and its figures, what matters first.

    What has no room is left out whole; the card is as wide as there is room beside the first.

    None where it is not wanted, or standard output is no terminal that can redraw a line.
    """
    if not wanted or not is_live(sys.stdout):
        yield None
        return
    bold, plain = ("", "") if os.environ.get("NO_COLOR") else (_BOLD, _PLAIN)

    def draw(heading_deg: float, figures: Sequence[str]) -> None:
        width = shutil.get_terminal_size().columns - _AROUND
        columns = min(_COLUMNS, max(width - len(figures[0]), 1))
        columns -= 1 - columns % 2
        drawn, middle = card(heading_deg, columns), columns // 2
        nose = drawn[middle].replace(" ", "|")
        fitting = [n for n in range(1, len(figures) + 1) if columns + len("  ".join(figures[:n])) <= width]
        told = "  ".join(figures[: max(fitting, default=1)])
        card_line = f" {drawn[:middle]}[{bold}{nose}{plain}]{drawn[middle + 1 :]}"
        sys.stdout.write(f"\r{card_line}  {told}{_REST_OF_LINE}")
        sys.stdout.flush()

    try:
        yield draw
    finally:
        sys.stdout.write("\n")
        sys.stdout.flush()


# What is done, of how much, and words.
Bar = Callable[[int, int, str], None]


@contextmanager
def bar() -> Iterator[Bar]:
    """Show a bar on a terminal, nothing in a pipe; transient."""
    if not is_live():
        yield lambda done, of, words: None
        return
    from rich.console import Console
    from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeRemainingColumn

    console = Console(stderr=True, no_color=bool(os.environ.get("NO_COLOR")))
    words = TextColumn("{task.description}")
    columns = (BarColumn(bar_width=24), MofNCompleteColumn(), words, TimeRemainingColumn())
    with Progress(*columns, console=console, transient=True) as progress:
        task = progress.add_task("", total=None)
        yield lambda done, of, words: progress.update(task, total=of, completed=done, description=words)


@contextmanager
def showing_progress(name: str) -> Iterator[Callable[[str], None]]:
    """Show what is being done on a terminal, from the first moment; stay quiet in a pipe."""
    if not sys.stderr.isatty():
        yield lambda doing: None
        return
    from rich.console import Console

    with Console(stderr=True).status(f"{name}: reading") as status:
        yield lambda doing: status.update(f"{name}: {doing}")
