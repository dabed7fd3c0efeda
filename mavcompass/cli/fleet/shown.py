"""How the work on a fleet shows itself: a bar while it lasts, then what it found."""

from __future__ import annotations

import os
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING

from mavcompass.cli.options import Output
from mavcompass.cli.terminal.colour import is_live

if TYPE_CHECKING:
    from mavcompass.fleet.run import FleetResult, Progress
    from mavcompass.fleet.summary import Summary

_SHOWN = 5
LONG_S = 20.0  # from here on a recording is named


@contextmanager
def showing() -> Iterator[Callable[[Progress], None]]:
    """Show a bar on a terminal, nothing in a pipe."""
    if not is_live():
        yield lambda _: None
        return
    from rich.console import Console
    from rich.progress import BarColumn, MofNCompleteColumn, TextColumn, TimeRemainingColumn
    from rich.progress import Progress as Bar

    from mavcompass.printable import counted

    console = Console(stderr=True, no_color=bool(os.environ.get("NO_COLOR")))
    columns = (
        BarColumn(bar_width=24),
        MofNCompleteColumn(),
        TextColumn("{task.description}"),
        TimeRemainingColumn(),
    )
    with Bar(*columns, console=console, transient=True) as bar:
        task = bar.add_task("", total=None)

        def show(progress: Progress) -> None:
            words = [counted(progress.errors, "error")] if progress.errors else []
            if progress.under_way and progress.under_way[0][1] >= LONG_S:
                path, seconds = progress.under_way[0]
                words.append(f"{short(path)} takes {seconds:.0f} s so far")
            bar.update(task, total=progress.asked, completed=progress.done, description=", ".join(words))

        yield show


def short(path: str) -> str:
    """Name a recording by its file and folder."""
    return "/".join(Path(path).parts[-2:])


def say(output: Output, result: FleetResult, summary: Summary, out: Path, page: Path) -> None:
    from mavcompass.fleet.summary import LEAST_MGAUSS
    from mavcompass.printable import counted

    kept = f", {result.kept} were done before" if result.kept else ""
    fruitless = ""
    if summary.not_accepted:
        fruitless = f", {len(summary.not_accepted)} without a calibration (mostly: too little turning)"
    output.say(
        f"{result.examined} of {counted(result.asked, 'recording')} examined{kept};"
        f" {counted(len(summary.errors), 'error')}{fruitless}."
    )
    for recording, sentence in summary.errors[:_SHOWN]:
        output.say(f"  {short(recording)}: {sentence}")
    if summary.slowest and summary.slowest[0][1] >= LONG_S:
        output.say("Slowest: {} ({:.0f} s).".format(*summary.slowest[0]))
    for effect in [effect for effect in summary.effects if effect.largest_mgauss >= LEAST_MGAUSS][:_SHOWN]:
        output.say(
            f"  {effect.effect}: in {counted(effect.recordings, 'recording')} of"
            f" {counted(effect.vehicles, 'vehicle')}, median {effect.median_mgauss:.1f} mG,"
            f" largest {effect.largest_mgauss:.1f} mG"
        )
    for vehicle in summary.look_first[:_SHOWN]:
        where = f" ({vehicle.kind}; last: {short(vehicle.last_recording)})" if vehicle.last_recording else ""
        output.say(f"Look at {vehicle.name}{where}: {'; '.join(vehicle.why)}.")
    output.say(f"Table: {out}")
    output.say(f"Summary: {page}")
