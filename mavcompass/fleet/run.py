"""Work through a fleet: find, examine, keep, and write the table."""

from __future__ import annotations

import re
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from pathlib import Path

from mavcompass.errors import UsageError
from mavcompass.fleet.columns import write_parquet
from mavcompass.fleet.engine import Engine
from mavcompass.fleet.examine import Job, Row, error_row, examine
from mavcompass.fleet.journal import Journal
from mavcompass.fleet.recordings import Recording, told_apart
from mavcompass.installation.parts import require
from mavcompass.workers import Answer
from mavcompass.workers.child import Task

Examine = Callable[[Job, str], list[Row]]
_ONE_PROCESS = Engine()


@dataclass(frozen=True, slots=True)
class Progress:
    """Say how far a run is, in recordings: asked for, done (earlier runs included), given errors.

    `under_way`: those that processes of this machine are at, with their seconds, the longest first.
    """

    asked: int
    done: int
    errors: int
    under_way: tuple[tuple[str, float], ...] = ()


@dataclass(frozen=True, slots=True)
class FleetResult:
    """Hold the outcome: rows of everything in the journal, and what this run did of it."""

    rows: list[Row]
    asked: int
    examined: int
    kept: int


def journal_of(out: Path) -> Path:
    """Return where the progress of an output is kept."""
    return out.with_name(f"{out.name}.journal")


def run_fleet(
    job: Job,
    recordings: Sequence[Recording],
    out: Path,
    engine: Engine = _ONE_PROCESS,
    *,
    fresh: bool = False,
    retry_errors: bool = False,
    on_progress: Callable[[Progress], None] = lambda _: None,
    on_rows: Callable[[list[Row], Progress], None] = lambda rows, progress: None,
    rows_every_s: float = 15.0,
    examine_one: Examine = examine,
) -> FleetResult:
    """Examine the recordings that the journal beside `out` does not have yet, and write the table.

    Args:
        fresh: forget the journal. retry_errors: do again what gave an error.
        on_progress: told of every recording, and about once a second. on_rows: given what there is, while the
            work goes on, when there is something new but at most every `rows_every_s`.
        examine_one: what is done with one recording, in another process.

    A recording whose process dies or is over its time gives one row with the error. An interrupt leaves
    the journal, and the same call goes on from there. Raises UsageError for what cannot be begun.
    """
    require("A Parquet table")
    _check_pattern(job)
    with Journal(journal_of(out), _question(job), fresh) as journal:
        done = [r for r in recordings if journal.is_done(r) and not (retry_errors and journal.failed(r))]
        kept = {recording.path for recording in done}
        to_do = {recording.path: recording for recording in recordings if recording.path not in kept}
        errors = sum(journal.failed(recording) for recording in done)
        progress = Progress(len(recordings), len(kept), errors)
        shown, shown_s = progress.done, time.monotonic()

        def wait(under_way: list[tuple[Task, float]]) -> None:
            nonlocal progress
            progress = replace(progress, under_way=tuple((task[1], seconds) for task, seconds in under_way))
            tell()

        def tell() -> None:
            nonlocal shown, shown_s
            on_progress(progress)
            if shown < progress.done < progress.asked and time.monotonic() - shown_s >= rows_every_s:
                on_rows(told_apart(journal.rows()), progress)
                shown, shown_s = progress.done, time.monotonic()

        on_progress(progress)
        for task, answer in engine.run(examine_one, ((job, path) for path in to_do), wait):
            recording = to_do[task[1]]
            journal.add(recording, _rows(job, recording, answer))
            errors += journal.failed(recording)
            progress = replace(progress, done=progress.done + 1, errors=errors)
            tell()
        rows = told_apart(journal.rows())
        write_parquet(rows, job.work, out)
    return FleetResult(rows, len(recordings), len(to_do), len(kept))


def _question(job: Job) -> Mapping[str, object]:
    """Return what makes rows comparable: the job; who does it and how fast does not matter."""
    return {**asdict(job), "instances": list(job.instances)}


def _rows(job: Job, recording: Recording, answer: Answer) -> list[Row]:
    if answer.failure is not None:
        rows = [error_row(job, recording.path, answer.failure.kind, answer.failure.text)]
    else:
        rows = answer.value
    dated = "recorded_unix_s"
    return [
        {
            **row,
            "size_bytes": recording.size_bytes,
            dated: recording.modified_unix_s if row.get(dated) is None else row[dated],
            "recorded_at_is": "file" if row.get(dated) is None else "recording",
        }
        for row in rows
    ]


def _check_pattern(job: Job) -> None:
    if job.vehicle_pattern is None:
        return
    try:
        groups = re.compile(job.vehicle_pattern).groups
    except re.error as error:
        raise UsageError(
            f"{job.vehicle_pattern!r} is no regular expression: {error}.",
            "Example: --vehicle-pattern 'boat-(\\d+)'",
        ) from error
    if groups < 1:
        raise UsageError(
            f"{job.vehicle_pattern!r} has no group that names the vehicle.",
            "Put it in parentheses: --vehicle-pattern 'boat-(\\d+)'",
        )
