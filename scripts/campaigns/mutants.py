"""Change the code by a little, many times: do the tests notice?

    ./scripts/coverage tests/vehicle tests/service     # first: which test runs what, and how long it takes
    python scripts/campaigns/mutants.py --under vehicle --under service [--mutants 120] [--budget 30]
    python scripts/campaigns/mutants.py --mutant mavcompass/frames.py#17      # one again

Places are drawn evenly over the code: an operator, a comparison, a condition, a number, what is returned. For
each the tests that run its line are run, the cheapest first, `--budget` seconds of them as measured: one that
waits in real time is dear and comes last or not at all. The mutant is caught when one fails or hangs. More
tests might notice more: the share is a lower bound. Works in a copy; nothing here is changed. Exit code 1
below `--least` percent.
"""

from __future__ import annotations

import argparse
import difflib
import json
import math
import os
import random
import resource
import shutil
import signal
import subprocess
import sys
import tempfile
import time
from collections import Counter
from collections.abc import Iterator, Sequence
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from itertools import accumulate, takewhile
from pathlib import Path

import pytest
from coverage import CoverageData

PROJECT = Path(__file__).resolve().parents[2]
sys.path.insert(0, str(Path(__file__).resolve().parent))

from mutation.sites import Site, mutated, sites  # noqa: E402
from mutation.test_contexts import SECONDS, SOURCES  # noqa: E402

# These try the project's folder itself, which a copy is not.
_UNFIT = ("tests/test_", "tests/acceptance")
_QUIET = ("-x", "-q", "-p", "no:cacheprovider", "-n", "0")


def main() -> int:
    """Draw the mutants, try each, print the table."""
    options = _parsed()
    if not options.copied:
        return _in_a_copy(sys.argv[1:])
    drawn = _drawn(Path.cwd(), options)
    trial = Trial(Path.cwd(), Covering(options.copied), options.budget)
    verdicts: dict[Site, Verdict] = {}
    try:
        while drawn:
            verdicts.update((site, trial.verdict(site, number)) for number, site in enumerate(drawn, 1))
            unsound = trial.unsound({v.caught_by for v in verdicts.values()} - {""})
            drawn = [site for site, verdict in verdicts.items() if verdict.caught_by in unsound]
    except KeyboardInterrupt:
        print("stopped")
    return 0 if _table(verdicts) >= options.least else 1


def _parsed() -> argparse.Namespace:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--under", action="append", help="a room or file of the package")
    parser.add_argument("--mutants", type=int, default=120)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--mutant", action="append", help="FILE#NUMBER, as it is printed")
    parser.add_argument("--budget", type=float, default=30.0, help="seconds of tests a mutant")
    parser.add_argument("--least", type=float, default=90.0, help="percent")
    parser.add_argument("--copied", type=Path, help=argparse.SUPPRESS)
    return parser.parse_args()


def _in_a_copy(arguments: Sequence[str]) -> int:
    """Run this program in a copy of the project: the programs that tests start are to be mutants, too."""
    with tempfile.TemporaryDirectory() as folder:
        copy = Path(folder) / "mavcompass"
        unused = shutil.ignore_patterns(".git", ".venv*", "__pycache__", ".*cache", ".coverage*")
        shutil.copytree(PROJECT, copy, ignore=unused)
        environment = {**os.environ, "PYTHONPATH": str(copy), "PYTHONPYCACHEPREFIX": f"{folder}/bytecode"}
        environment.pop("PYTHONDONTWRITEBYTECODE", None)
        environment.setdefault("MAVCOMPASS_SHARED_DATA", str(PROJECT.parent / "shared" / "data"))
        command = [sys.executable, str(copy / "scripts" / "campaigns" / "mutants.py")]
        command += ["--copied", str(PROJECT), *arguments]
        return subprocess.run(command, cwd=copy, env=environment).returncode


def _drawn(root: Path, options: argparse.Namespace) -> list[Site]:
    """Draw places evenly, in an order that leaves who stops early with a fair sample."""
    parts = [root / "mavcompass" / part for part in options.under or [""]]
    files = [f for part in parts for f in ([part] if part.is_file() else sorted(part.rglob("*.py")))]
    places = [site for file in files for site in sites(root, str(file.relative_to(root)))]
    if options.mutant:
        return [site for site in places if str(site) in options.mutant]
    drawn = random.Random(options.seed).sample(places, min(options.mutants, len(places)))
    print(f"{len(drawn)} of {len(places)} places, seed {options.seed}", flush=True)
    return drawn


class Covering:
    """Know which tests run a line and what they cost, as `scripts/coverage` has found."""

    def __init__(self, project: Path) -> None:
        """Read what was found. Raises FileNotFoundError before `scripts/coverage` has run."""
        self._project = project
        measured: dict[str, float] = json.loads((project / SECONDS).read_text())
        rooms = {"/".join(name.split("::")[0].split("/")[:2]) for name in measured}
        there = _collected([room for room in sorted(rooms) if not room.startswith(_UNFIT)])
        self._seconds = {name: measured.get(name, 0.0) for name in there}
        self._data = CoverageData(str(project / ".coverage"))
        self._data.read()
        # What a test runs that was written since is unknown; those of its room may be meant for a mutant.
        self._since = (project / ".coverage").stat().st_mtime
        self._changed = {name for name in there if self._is_newer(project / name.partition("::")[0])}

    def tests(self, site: Site, budget_s: float) -> list[str]:
        """Return the tests that run a place, the cheapest first, as many as the budget allows."""
        lines = self._data.contexts_by_lineno(str(self._project / site.path))
        # What a file does when it is loaded matters to whoever runs anything of it.
        wanted = [self._line_then(site)] if site.in_function else list(lines)
        contexts = {context for line in wanted for context in lines.get(line, ())}
        files = {context.partition(" ")[2] for context in contexts if context.startswith("file ")}
        room = "tests/" + site.path.split("/")[1] + "/"
        found = [
            name
            for name in self._seconds
            if f"test {name}" in contexts
            or name.partition("::")[0] in files  # a fixture of all its tests
            or (name in self._changed and name.startswith(room))
        ]
        found.sort(key=self._seconds.__getitem__)
        spent = accumulate(self._seconds[name] for name in found)
        return [
            name for name, _ in takewhile(lambda pair: pair[1] <= budget_s, zip(found, spent, strict=True))
        ]

    def _is_newer(self, file: Path) -> bool:
        return file.stat().st_mtime > self._since

    def _line_then(self, site: Site) -> int:
        """Return the number that a line had when it was measured; a new one has that of the one before."""
        then, now = self._project / SOURCES / site.path, self._project / site.path
        if not then.exists() or not self._is_newer(now):
            return site.line
        texts = then.read_text().splitlines(), now.read_text().splitlines()
        blocks = difflib.SequenceMatcher(None, *texts, autojunk=False).get_matching_blocks()
        block = [block for block in blocks if block.size and block.b < site.line][-1]
        return block.a + min(site.line - block.b, block.size)


def _collected(rooms: Sequence[str]) -> list[str]:
    """List the tests that there are; what they load from elsewhere stays loaded for all mutants."""

    class Collected:
        names: tuple[str, ...] = ()

        def pytest_collection_finish(self, session: pytest.Session) -> None:
            self.names = tuple(item.nodeid for item in session.items)

    collected = Collected()
    with open(os.devnull, "w") as nothing, _stdout(nothing.fileno()):
        pytest.main([*_QUIET, "--collect-only", *rooms], plugins=[collected])
    own = str(Path.cwd())
    for name, module in list(sys.modules.items()):
        if str(getattr(module, "__file__", "")).startswith(own) and name != "__main__":
            del sys.modules[name]
    return list(collected.names)


@contextmanager
def _stdout(descriptor: int) -> Iterator[None]:
    sys.stdout.flush()
    kept = os.dup(1)
    os.dup2(descriptor, 1)
    try:
        yield
    finally:
        os.dup2(kept, 1)
        os.close(kept)


@dataclass(frozen=True)
class Verdict:
    """Say whether a mutant was caught, and by which test, where one has failed."""

    caught: bool
    caught_by: str


class Trial:
    """Try mutants in a copy of the project."""

    def __init__(self, root: Path, covering: Covering, budget_s: float) -> None:
        self._root, self._covering, self._budget_s = root, covering, budget_s
        self._unsound: set[str] = set()
        self._failed = root.parent / "failed"

    def verdict(self, site: Site, number: int) -> Verdict:
        """Try one."""
        text, what = mutated(self._root, site)
        tests = [t for t in self._covering.tests(site, self._budget_s) if t not in self._unsound]
        with _changed(self._root / site.path, text, number):
            failed = self._failing(tests)
        told = "survived" if failed is None else "hung or did not load" if not failed else ""
        if told:
            print(f"  {site} line {site.line}, {len(tests)} tests, {told}: {what}", flush=True)
        return Verdict(failed is not None, failed or "")

    def unsound(self, tests: set[str]) -> set[str]:
        """Find those among tests that fail as it is, which are not asked again."""
        found: set[str] = set()
        while failed := self._failing(sorted(tests - found)):
            print(f"  left out, fails as it is: {failed}", flush=True)
            found.add(failed)
        self._unsound |= found
        return found

    def _failing(self, tests: Sequence[str]) -> str | None:
        """Run tests in a forked process; return the first that fails, "" where none can be named."""
        self._failed.unlink(missing_ok=True)
        if not tests or _forked(tests, self._failed, self._budget_s):
            return None
        return self._failed.read_text() if self._failed.exists() else ""


@contextmanager
def _changed(path: Path, text: str, number: int) -> Iterator[None]:
    """Have a file be another while it lasts, with a time that no bytecode of it has."""
    original = path.read_bytes()
    try:
        path.write_text(text)
        os.utime(path, (1e9 + number, 1e9 + number))
        yield
    finally:
        path.write_bytes(original)


def _forked(tests: Sequence[str], failed: Path, budget_s: float) -> bool:
    """Tell whether tests pass in a forked process, which is ended by force where it hangs."""
    sys.stdout.flush()
    child = os.fork()
    if child == 0:
        status = 1
        try:
            os.setsid()
            limit_s = int(3.0 * budget_s + 20.0)
            resource.setrlimit(resource.RLIMIT_CPU, (limit_s, limit_s))
            nothing = os.open(os.devnull, os.O_RDWR)
            for descriptor in (0, 1, 2):
                os.dup2(nothing, descriptor)

            class Watch:
                def pytest_runtest_logreport(self, report: pytest.TestReport) -> None:
                    if report.failed:
                        failed.write_text(report.nodeid)

            status = int(pytest.main([*_QUIET, *tests], plugins=[Watch()]))
        finally:
            os._exit(status)
    status, end_s = -1, time.monotonic() + 10.0 * budget_s + 60.0
    while time.monotonic() < end_s and status == -1:
        time.sleep(0.02)
        ended, told = os.waitpid(child, os.WNOHANG)
        status = told if ended else -1
    with suppress(ProcessLookupError):
        os.killpg(child, signal.SIGKILL)  # what its tests started ends with it
    if status == -1:
        os.waitpid(child, 0)
    return status == 0


def _table(verdicts: dict[Site, Verdict]) -> float:
    """Print what was caught by room; return the share in percent."""
    count = Counter((site.path.split("/")[1], verdict.caught) for site, verdict in verdicts.items())
    for room in sorted({room for room, _ in count}):
        print(f"{room:20}{count[room, True]:>6} caught{count[room, False]:>6} survived")
    caught, n = sum(verdict.caught for verdict in verdicts.values()), len(verdicts)
    low, high = _interval(caught, n)
    print(f"{caught} of {n} caught = {100.0 * caught / max(n, 1):.1f} % ({low:.1f} .. {high:.1f})")
    return 100.0 * caught / max(n, 1)


def _interval(caught: int, n: int) -> tuple[float, float]:
    """Return Wilson's 95 % interval, in percent."""
    if n == 0:
        return 0.0, 100.0
    z, share = 1.96, caught / n
    middle, half = share + z * z / (2 * n), z * math.sqrt(share * (1 - share) / n + z * z / (4 * n * n))
    return 100.0 * (middle - half) / (1 + z * z / n), 100.0 * (middle + half) / (1 + z * z / n)


if __name__ == "__main__":
    sys.exit(main())
