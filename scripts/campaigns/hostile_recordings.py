"""Make hostile recordings, and let every command that reads one have each: a sentence or a sound result.

    python scripts/campaigns/hostile_recordings.py [--only WORD] [--share 1.0] [--command NAME] [--json FILE]

One small flight is written in each format, with what a clock, a parameter, a sensor, a writer or an attacker
may put there: times that leap, stand still or go back, parameters that no compass has, numbers that are none,
lengths and counts that lie, lines and tables without end, holes of gigabytes, pipes and devices. Each command
runs in a process of its own under a budget. Exit code 1 where one did not hold.
"""

from __future__ import annotations

import contextlib
import itertools
import json
import os
import resource
import signal
import sys
import tempfile
import time
import traceback
from collections import Counter
from collections.abc import Collection, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from campaign import Several, ended, folder, options
from hostile_files import WRITERS, Flight, inputs

# A command that reads a hostile recording, of three gigabytes or of none: processor time, and memory in all.
HOSTILE_S, HOSTILE_MB = 10.0, 300.0


def commands(path: Path, good: Path, work: Path) -> dict[str, list[str]]:
    """Return the commands that read a recording, each as its words."""
    one = str(path)
    return {
        "calibrate": ["calibrate", one, "--json", "-"],
        "heading": ["heading", one, "--json-lines"],
        "params show": ["params", "show", one],
        "gap diagnose": ["gap", "diagnose", one],
        "gap diagnose beside it": ["gap", "diagnose", str(good), "--baseline", one],
        "replay": ["replay", one, "--listen", "udpout:127.0.0.1:9", "--speed", "1000"],
        "fleet calibrate": ["fleet examine", one, "calibrate"],
        "fleet diagnose": ["fleet examine", one, "diagnose"],
        "sphere": ["calibrate", one, "--method", "sphere"],
    }


ALLOWED = {0, 2, 4, 5, 8}


@dataclass(frozen=True)
class Outcome:
    """Say how one command fared with one input."""

    hostile: str
    command: str
    code: int
    seconds: float
    megabytes: float
    said: str

    @property
    def wrong(self) -> bool:
        """Tell whether a budget or a promise did not hold."""
        over = self.seconds > HOSTILE_S or self.megabytes > HOSTILE_MB
        silent = self.code in (2, 4) and not self.said
        return over or silent or self.code not in ALLOWED or "Traceback" in self.said


def run(words: list[str], name: str, command: str) -> Outcome:
    """Run one command in a process forked from this one, which has loaded all already."""
    with tempfile.TemporaryFile("w+b") as said:
        began = time.monotonic()
        child = os.fork()
        if not child:
            ended = 1
            try:
                ended = _in_child(words, said.fileno())
            except BaseException:
                traceback.print_exc()
            sys.stderr.flush()
            os._exit(ended)
        done, status, used = os.wait4(child, 0)
        assert done == child
        said.seek(0)
        spoken = said.read(200_000).decode("utf-8", "replace")
    code = os.waitstatus_to_exitcode(status)
    spent = min(used.ru_utime + used.ru_stime, time.monotonic() - began)
    return Outcome(
        name, command, code, round(spent, 2), round(used.ru_maxrss / 1024, 1), spoken.strip()[-1500:]
    )


def _in_child(words: list[str], said: int) -> int:
    from mavcompass.cli.main import main

    quiet = os.open(os.devnull, os.O_RDWR)
    os.dup2(quiet, 0), os.dup2(quiet, 1), os.dup2(said, 2)
    resource.setrlimit(resource.RLIMIT_AS, (8 << 30, 8 << 30))
    resource.setrlimit(resource.RLIMIT_CPU, (20, 21))
    signal.alarm(240)
    if words[0] == "replay":
        return _replayed(Path(words[1]))
    if words[0] == "fleet examine":
        from mavcompass.fleet.examine import Job, examine

        examine(Job(words[2]), words[1])  # type: ignore[arg-type]
        return 0
    try:
        return main(words)
    except SystemExit as end:
        return end.code if isinstance(end.code, int) else 1


def _replayed(path: Path) -> int:
    """Do what `replay` does until its first hundred thousand messages are handed out."""
    from mavcompass.errors import MavCompassError
    from mavcompass.vehicle.replay import replayed_autopilot

    try:
        played = replayed_autopilot(path)
        for _ in itertools.islice(_messages(played), 100_000):
            pass
    except MavCompassError as error:
        print(error, file=sys.stderr)
        return error.exit_code
    return 0


def _messages(played: Any) -> Iterator[Any]:
    while not played.ended:
        yield from played.advance(played.time_s + 100.0)


def load_all() -> None:
    """Import what the commands use, so that each child has it already."""
    import scipy.interpolate
    import scipy.linalg
    import scipy.optimize
    import scipy.signal
    import scipy.sparse.linalg  # noqa: F401

    import mavcompass.cli.calibrate
    import mavcompass.cli.fleet
    import mavcompass.cli.gap
    import mavcompass.cli.heading
    import mavcompass.cli.params
    import mavcompass.cli.replay
    import mavcompass.fleet.examine
    import mavcompass.gap
    import mavcompass.logs.reading

    mavcompass.logs.reading.known_formats()


def campaign(share: float, only: str, folder: Path, chosen: Collection[str] | None) -> list[Outcome]:
    """Try a share of the inputs with the commands that are chosen."""
    load_all()
    good = folder / "good.tlog"
    good.write_bytes(WRITERS[".tlog"](Flight()))
    rng = np.random.default_rng(1)
    outcomes = []
    for number, one in enumerate(inputs()):
        if rng.random() >= share or (only and only not in f"{one.name}{one.suffix}"):
            continue
        path = folder / f"{number}{one.suffix}"
        one.make(path)
        for command, words in commands(path, good, folder).items():
            if not chosen or command in chosen:
                outcome = run(words, f"{one.name} {one.suffix}", command)
                outcomes.append(outcome)
                if outcome.wrong:
                    print(json.dumps(outcome.__dict__), flush=True)
        with contextlib.suppress(OSError):
            path.rmdir() if path.is_dir() and not path.is_symlink() else path.unlink()
    return outcomes


def main() -> int:
    """Run the campaign and judge it."""
    wanted = options(
        __doc__,
        share=(1.0, "of the inputs, drawn"),
        only=("", "inputs whose name or suffix holds this"),
        command=(Several(), "only this one; may be repeated"),
    )
    with folder() as place:
        outcomes = campaign(wanted.share, wanted.only, place, wanted.command)
    figures = {
        "inputs": len({one.hostile for one in outcomes}),
        "runs": len(outcomes),
        "codes": dict(Counter(one.code for one in outcomes)),
        "wrong": sum(one.wrong for one in outcomes),
        "slowest": max(((one.seconds, one.hostile, one.command) for one in outcomes), default=None),
        "largest": max(((one.megabytes, one.hostile, one.command) for one in outcomes), default=None),
    }
    print(json.dumps(figures, indent=1))
    return ended(wanted.json, figures | {"each": outcomes}, figures["wrong"])


if __name__ == "__main__":
    sys.exit(main())
