"""Measure a fleet: two processes beside one, on recordings made here, with a recording that kills.

    scripts/bench fleet [-- --recordings 200 --dask]

The recordings are Track CSVs of vehicles that turn in four steps, each with its own iron and noise. One
process and two work through them in turns and the best of each counts, the start of the processes
included. What else this machine does at the time weighs on two more than on one, so the load is told, and
the processor time that two need beside one, which it touches less.
"""

from __future__ import annotations

import argparse
import os
import resource
import signal
import sys
import tempfile
import time
from collections import Counter
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from mavcompass.fleet.engine import Engine
from mavcompass.fleet.examine import Job, Row, examine
from mavcompass.fleet.recordings import find_recordings
from mavcompass.fleet.run import run_fleet

PROJECT = Path(__file__).resolve().parents[2]
DEADLY = "deadly"
RATE_HZ = 200.0  # the files are then a megabyte, as a telemetry log of two minutes
QUICK = ("--recordings", "60", "--rounds", "1")


def main(argv: Sequence[str] | None = None) -> dict[str, Any]:
    """Measure; return seconds, the ratio and what a deadly recording costs."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--recordings", type=int, default=200)
    parser.add_argument("--rounds", type=int, default=2)
    parser.add_argument("--dask", action="store_true", help="also on a local Dask cluster (slow to start)")
    options = parser.parse_args(argv)
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        make_recordings(folder / "flights", options.recordings)
        seconds = measure(folder, options.rounds)
        ratio = min(seconds["1"]["wall"]) / min(seconds["2"]["wall"])
        work = min(seconds["2"]["processor"]) / min(seconds["1"]["processor"])
        for workers, taken in seconds.items():
            print(
                f"  {workers} workers: {min(taken['wall']):.2f} s; processor {min(taken['processor']):.2f} s"
            )
        print(f"  two are {ratio:.2f} x as fast as one, and need {work:.2f} x the processor time")
        print(f"  load of the machine: {os.getloadavg()[0]:.1f} on {len(os.sched_getaffinity(0))} processors")
        deaths = {"processes": with_a_deadly_one(folder, Engine(2))}
        if options.dask:
            deaths["dask"] = on_dask(folder)
    wanted = {"ok": options.recordings - 1, "error": 1}
    checks: list[dict[str, Any]] = [{"what": "two processes, times one", "value": ratio, "at_least": 1.85}]
    for engine, statuses in deaths.items():
        print(f"  {engine}, one recording kills its process: {statuses}")
        lost = sum((Counter(wanted) - Counter(statuses)).values())
        checks.append({"what": f"lost beside the deadly one, {engine}", "value": lost, "at_most": 0})
    return {"recordings": options.recordings, "seconds": seconds, "deaths": deaths, "checks": checks}


def measure(folder: Path, rounds: int) -> dict[str, dict[str, list[float]]]:
    """Work through the fleet with one process and with two, in turns; seconds by the clocks."""
    seconds: dict[str, dict[str, list[float]]] = {
        workers: {"wall": [], "processor": []} for workers in ("1", "2")
    }
    recordings = find_recordings([str(folder / "flights")])
    for _ in range(rounds):
        for workers, taken in seconds.items():
            wall, processor = time.perf_counter(), processor_s()
            out = folder / "out.parquet"
            result = run_fleet(Job("calibrate"), recordings, out, Engine(int(workers)), fresh=True)
            taken["wall"].append(time.perf_counter() - wall)
            taken["processor"].append(processor_s() - processor)
            assert result.examined == len(recordings)
    return seconds


def processor_s() -> float:
    """Return the processor time of this process and its ended children."""
    usages = [resource.getrusage(who) for who in (resource.RUSAGE_SELF, resource.RUSAGE_CHILDREN)]
    return sum(usage.ru_utime + usage.ru_stime for usage in usages)


def with_a_deadly_one(folder: Path, engine: Engine) -> dict[str, int]:
    """Work through a fleet in which one recording kills its process; count how the others end."""
    recordings = find_recordings([str(folder / "flights")])
    target = Path(recordings[len(recordings) // 2].path)
    deadly = target.rename(target.with_stem(DEADLY))
    try:
        again = find_recordings([str(folder / "flights")])
        out = folder / "deaths.parquet"
        result = run_fleet(Job("calibrate"), again, out, engine, fresh=True, examine_one=examine_or_die)
    finally:
        deadly.rename(target)
    return dict(Counter(row["status"] for row in result.rows))


def on_dask(folder: Path) -> dict[str, int]:
    """Do the same on a cluster of two workers."""
    from distributed import LocalCluster

    search = os.pathsep.join(path for path in sys.path if path)
    options = {"n_workers": 2, "threads_per_worker": 1, "dashboard_address": None}
    with LocalCluster(**options, env={"PYTHONPATH": search}) as cluster:
        return with_a_deadly_one(folder, Engine(scheduler=cluster.scheduler_address))


def examine_or_die(job: Job, path: str) -> list[Row]:
    """Examine a recording; die of a deadly one."""
    if DEADLY in path:
        os.kill(os.getpid(), signal.SIGKILL)
    return examine(job, path)


def make_recordings(folder: Path, count: int) -> None:
    """Write Track CSVs of vehicles that turn in four steps, each with its own iron and noise."""
    sys.path.insert(0, str(PROJECT / "tests" / "fleet"))
    from fleet_samples import write_recording

    folder.mkdir()
    for number in range(count):
        write_recording(folder / f"flight{number:03d}.csv", (number % 50 - 25.0, 10.0, 5.0), number, RATE_HZ)
