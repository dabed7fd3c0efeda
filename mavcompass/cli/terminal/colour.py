"""What a terminal can: colours, lines that are drawn again; plain text elsewhere."""

from __future__ import annotations

import os
import shutil
import sys
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
