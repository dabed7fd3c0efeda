"""Have coverage note which test runs what, in this process and in the programs that the test starts.

A pytest plug-in; `scripts/coverage` loads it, `scripts/campaigns/mutants.py` reads what comes of it.
"""

from __future__ import annotations

import json
import os
import shutil
import subprocess
from collections import Counter
from collections.abc import Iterator
from pathlib import Path

import coverage
import pytest

from mavcompass.workers import child

SECONDS = ".coverage-seconds"
SOURCES = ".coverage-sources"
LOADING = "loading "
_seconds: Counter[str] = Counter()


def _enter(context: str) -> None:
    os.environ["MAVCOMPASS_TEST"] = context
    measured = coverage.Coverage.current()
    if measured is not None:
        measured.switch_context(context)


def _end_and_tell(process: subprocess.Popen[bytes]) -> None:
    """End a worker process as `child` does, but let it write down what it ran."""
    process.terminate()
    try:
        process.wait(10.0)
    except subprocess.TimeoutExpired:
        process.kill()
        process.wait()


def pytest_configure() -> None:
    """Have worker processes counted, which are killed otherwise."""
    child._end = _end_and_tell


@pytest.hookimpl(tryfirst=True)
def pytest_make_collect_report(collector: pytest.Collector) -> None:
    """Enter the loading of a file: what is tested may make the rows of a table there."""
    if isinstance(collector, pytest.Module):
        _enter(f"{LOADING}{collector.nodeid}")


@pytest.hookimpl(hookwrapper=True)
def pytest_runtest_setup(item: pytest.Item) -> Iterator[None]:
    """Enter a file: a fixture may serve all of its tests, and is made in the setting up of the first."""
    _enter(f"file {item.nodeid.partition('::')[0]}")
    yield


@pytest.hookimpl(hookwrapper=True)
def pytest_runtest_call(item: pytest.Item) -> Iterator[None]:
    """Enter a test."""
    _enter(f"test {item.nodeid}")
    yield
    os.environ.pop("MAVCOMPASS_TEST", None)


def pytest_runtest_logreport(report: pytest.TestReport) -> None:
    """Note how long it took."""
    _seconds[report.nodeid] += report.duration


def pytest_sessionfinish(session: pytest.Session) -> None:
    """Write how long the tests took, once for all workers, and keep the text whose lines were counted."""
    if not hasattr(session.config, "workerinput"):
        Path(SECONDS).write_text(json.dumps(_seconds))
        shutil.copytree("mavcompass", f"{SOURCES}/mavcompass", ignore=shutil.ignore_patterns("__pycache__"))
