"""Fixtures that many tests share."""

from __future__ import annotations

import importlib
import os
import signal
import subprocess
import sys
import threading
from collections.abc import Callable, Iterator
from pathlib import Path
from textwrap import dedent
from types import ModuleType
from typing import Any

import pytest
from hypothesis import settings

# As the program sets it for itself, and before anything imports numpy.
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

# A busy machine is no failure, and a suite that is green stays green: the examples follow from the test.
settings.register_profile("mavcompass", deadline=None, derandomize=True)
settings.load_profile("mavcompass")

PROJECT = Path(__file__).resolve().parents[1]


def pytest_addoption(parser: pytest.Parser) -> None:
    parser.addoption(
        "--mav-url",
        metavar="URL",
        default=None,
        help="run the tests that need a vehicle against the one at this address, e.g. udpin:0.0.0.0:14550",
    )
    parser.addoption(
        "--more", type=int, default=1, metavar="N", help="so many times as many cases where they are drawn"
    )
    parser.addoption(
        "--store", action="store_true", help="store the numbers that tests with stored ones compare with"
    )


@pytest.fixture(autouse=True, scope="session")
def _own_state(tmp_path_factory: pytest.TempPathFactory) -> None:
    """Keep what the program keeps for itself out of the home of who runs the tests."""
    os.environ["XDG_STATE_HOME"] = str(tmp_path_factory.mktemp("state"))


@pytest.fixture(scope="session")
def more(request: pytest.FixtureRequest) -> int:
    """Say how many times as many cases as usual are wanted."""
    return int(request.config.getoption("--more"))


@pytest.fixture(scope="module")
def campaigns() -> Iterator[Callable[[str], ModuleType]]:
    """Import a campaign of `scripts/campaigns` by its name."""
    with pytest.MonkeyPatch.context() as patch:
        patch.syspath_prepend(str(PROJECT / "scripts" / "campaigns"))
        yield importlib.import_module


_PROCESS_S = 300.0


@pytest.fixture
def start_process() -> Iterator[Callable[..., subprocess.Popen[str]]]:
    """Start a process that ends with the test or after five minutes, whatever the test waits for.

    It hears Ctrl-C, which a shell without job control has the processes in its background ignore.
    """
    before = signal.signal(signal.SIGINT, signal.default_int_handler)
    started: list[tuple[subprocess.Popen[str], threading.Timer]] = []

    def start(*words: str, **options: Any) -> subprocess.Popen[str]:
        pipes = {"stdout": subprocess.PIPE, "stderr": subprocess.PIPE, "text": True}
        process = subprocess.Popen(words, **{**pipes, **options})
        alarm = threading.Timer(_PROCESS_S, process.kill)
        alarm.start()
        started.append((process, alarm))
        return process

    yield start
    for process, alarm in started:
        alarm.cancel()
        process.kill()
        process.wait()
        for stream in (process.stdout, process.stderr):
            if stream is not None:
                stream.close()
    signal.signal(signal.SIGINT, before)


@pytest.fixture
def add_file(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> Iterator[Callable[[ModuleType, str, str], None]]:
    """Add a file of code to a folder of the package from outside it, until the test ends."""
    added: list[str] = []

    def add(package: ModuleType, name: str, code: str) -> None:
        folder = tmp_path / "from_outside" / package.__name__
        folder.mkdir(parents=True)
        (folder / f"{name}.py").write_text(dedent(code))
        monkeypatch.setattr(package, "__path__", [*package.__path__, str(folder)])
        added.append(f"{package.__name__}.{name}")

    yield add
    for name in added:
        sys.modules.pop(name, None)


@pytest.fixture
def as_stored(request: pytest.FixtureRequest) -> Callable[[Any], None]:
    """Hold what was found against what is stored beside the test, number by number."""
    from stored_numbers import changed, store

    file = request.path.parent / "stored" / f"{request.path.stem.removeprefix('test_')}.json"

    def compare(found: Any) -> None:
        if request.config.getoption("--store"):
            store(file, request.node.name, found)
            return
        told = changed(file, request.node.name, found)
        assert not told, f"if that is meant: pytest {request.path} --store\n{chr(10).join(told[:20])}"

    return compare


@pytest.fixture(scope="session")
def shared_data() -> Path:
    """The folder of recordings, which stands beside the project and not in it."""
    folder = Path(os.environ.get("MAVCOMPASS_SHARED_DATA") or PROJECT.parent / "shared" / "data")
    if not folder.is_dir():
        pytest.skip(f"the recordings are not at {folder}; set MAVCOMPASS_SHARED_DATA to their folder")
    return folder


@pytest.fixture(scope="session")
def mav_url(request: pytest.FixtureRequest) -> str:
    """The address of a real or separately started vehicle."""
    url = request.config.getoption("--mav-url")
    if url is None:
        pytest.skip("needs a vehicle: give its address with --mav-url URL")
    return str(url)
