"""A bar of what is done, with words beside it."""

from __future__ import annotations

import os
from collections.abc import Callable, Iterator
from contextlib import contextmanager

from mavcompass.cli.terminal.colour import is_live

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
