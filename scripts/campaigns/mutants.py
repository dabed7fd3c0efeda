"""Change the code by a little, many times: do the tests notice?

    ./scripts/coverage tests/vehicle tests/service tests/gap/fly     # first: which test runs what, how long
    python scripts/campaigns/mutants.py --under vehicle --under service [--mutants 120]
    python scripts/campaigns/mutants.py --mutant mavcompass/frames.py#17      # one again

Places are drawn evenly over the code: an operator, a comparison, a condition, a number, what is returned. For
each the tests that run its line are run, or a line that names what it sets where it runs as a file is loaded:
one case of each test first, those of its own folder and the cheapest before others, `--budget` seconds as
measured, ten times what they take now. The mutant is caught when one fails or hangs. More tests might notice
more: the share is a lower bound. Works in a copy; nothing here is changed. Exit 1 below `--least` percent.
"""

from __future__ import annotations

import argparse
import ast
import gc
import json
import os
import random
import re
import shutil
import signal
import subprocess
import sys
import tempfile
from collections import Counter
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager, suppress
from pathlib import Path
from types import FunctionType

import pytest
from campaign import PROJECT, Several, ended, options, share
from coverage import CoverageData
from mutation.sites import Site, mutated, sites, swap
from mutation.test_contexts import LOADING, SECONDS, SOURCES

# These try the project's folder itself, which a copy is not.
_UNFIT = ("tests/test_launcher", "tests/test_package", "tests/test_project_files")
_QUIET = ("-q", "-s", "-p", "no:cacheprovider", "-n", "0")


def main() -> int:
    """Draw the mutants, try each, print the table."""
    wanted = options(
        __doc__,
        under=(Several(), "a room or file of the package"),
        mutants=120,
        seed=1,
        mutant=(Several(), "FILE#NUMBER, as it is printed"),
        budget=(300.0, "seconds of tests a mutant"),
        least=(90.0, "percent"),
        copied=(Path, "the project whose copy this is; made by this program itself"),
    )
    if not wanted.copied:
        return _in_a_copy(sys.argv[1:])
    campaign = Campaign(Path.cwd(), wanted)
    rooms = {"/".join(name.split("::")[0].split("/")[:2]) for name in campaign.measured}
    with open(os.devnull) as nothing:
        os.dup2(nothing.fileno(), 0)
    pytest.main([*_QUIET, *sorted(r for r in rooms if not r.startswith(_UNFIT))], plugins=[campaign])
    caught_by = {str(site): test for site, test in campaign.caught_by.items()}
    return ended(wanted.json, caught_by, _table(campaign.caught_by) < wanted.least)


def _in_a_copy(arguments: Sequence[str]) -> int:
    """Run this program in a copy of the project: the programs that tests start are to be mutants, too."""
    with tempfile.TemporaryDirectory() as folder:
        copy = Path(folder) / "mavcompass"
        unused = shutil.ignore_patterns(".git", ".venv*", "__pycache__", ".*cache", ".coverage*")
        shutil.copytree(PROJECT, copy, ignore=unused)
        environment = {**os.environ, "PYTHONPATH": str(copy), "PYTHONPYCACHEPREFIX": f"{folder}/bytecode"}
        environment.pop("PYTHONDONTWRITEBYTECODE", None)
        environment.setdefault("MAVCOMPASS_SHARED_DATA", str(PROJECT.parent / "shared" / "data"))
        command = [sys.executable, "scripts/campaigns/mutants.py", "--copied", str(PROJECT), *arguments]
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

    def __init__(self, project: Path, measured: dict[str, float], there: Sequence[str]) -> None:
        self._project = project
        self._data = CoverageData(str(project / ".coverage"))
        self._data.read()
        # What a test runs that was written since is unknown; those of its room may be meant for a mutant.
        since_s = (project / ".coverage").stat().st_mtime
        of = {name: project / name.partition("::")[0] for name in there}
        self._changed = {name for name, file in of.items() if file.stat().st_mtime > since_s}
        self._seconds = {n: measured.get(n, 0.0) for n in there if n in measured or n in self._changed}

    def tests(self, site: Site, budget_s: float) -> list[str]:
        """Return the tests that run a place, as many as the budget allows.

        Those of the folder that mirrors the file's are about it; further cases say less than a test's first.
        """
        contexts = self._contexts(site)
        files = {context.partition(" ")[2] for context in contexts if context.startswith(("file ", LOADING))}
        room, folder = (str(Path("tests", *Path(site.path).parts[1:end])) + "/" for end in (2, -1))
        cases, order = Counter[str](), list[tuple[float, str]]()
        for name in sorted(self._seconds, key=self._seconds.__getitem__):
            file, test = name.partition("::")[0], name.partition("[")[0]  # a fixture is all its file's
            runs = f"test {name}" in contexts or file in files
            if runs or (name in self._changed and name.startswith(room)):
                cases[test] += 1
                strange = cases[test] if name.startswith(folder) else 4 * cases[test]
                order.append((strange * self._seconds[name], name))
        chosen = dict[str, list[str]]()  # by file: its fixtures are made once
        for _, name in sorted(order):
            if self._seconds[name] <= budget_s:
                budget_s -= self._seconds[name]
                chosen.setdefault(name.partition("::")[0], []).append(name)
        return [name for names in chosen.values() for name in names]

    def is_loaded(self, site: Site) -> bool:
        """Tell whether a place did its work as the tests were loaded: they are to be loaded again."""
        return site.names is not None or any(one.startswith(LOADING) for one in self._contexts(site))

    def _contexts(self, site: Site) -> set[str]:
        """Return what ran the line of a place; of what is set as a file is loaded, what names it."""
        sources, named = self._project / SOURCES, re.compile(rf"\b({'|'.join(site.names or ())})\b")
        tests = {name.partition("::")[0] for name in self._seconds if site.names}
        found = {f"file {test}" for test in tests if named.search(Path(test).read_text())}
        for file in sources.rglob(site.path if site.names is None else "*.py"):
            texts = file.read_text().splitlines()
            lines = [number for number, text in enumerate(texts, 1) if named.search(text)]
            if lines := [self._line_then(site, texts)] if site.names is None else lines:
                ran = self._data.contexts_by_lineno(str(self._project / file.relative_to(sources)))
                found.update(context for line in lines for context in ran.get(line, ()))
        return found

    def _line_then(self, site: Site, then: Sequence[str]) -> int:
        """Return the number that a line had when it was measured: that of the nearest with its text."""
        text = Path(site.path).read_text().splitlines()[site.line - 1]
        alike = (number for number, other in enumerate(then, 1) if other == text)
        return min(alike, key=lambda number: abs(number - site.line), default=site.line)


class _First:
    """End a fork with the first test that fails, and note which it was."""

    def __init__(self, told: Path) -> None:
        self.told = told

    def pytest_runtest_logstart(self, nodeid: str, location: object) -> None:
        self.told.write_text(nodeid)

    def pytest_runtest_logreport(self, report: pytest.TestReport) -> None:
        if report.failed:
            os._exit(1)


class Campaign(_First):
    """Try mutants in a copy: a plug-in of pytest, in whose forks the tests are loaded already."""

    def __init__(self, root: Path, options: argparse.Namespace) -> None:
        """Read what was found. Raises FileNotFoundError before `scripts/coverage` has run."""
        self._root, self._options = root, options
        self.measured: dict[str, float] = json.loads((options.copied / SECONDS).read_text())
        # The test that caught it: "" where none began, None where it survived.
        self.caught_by: dict[Site, str | None] = {}
        self._items: dict[str, pytest.Item] = {}
        self._unsound: set[str] = set()
        super().__init__(root.parent / "failed")

    def pytest_runtestloop(self, session: pytest.Session) -> bool:
        """Try the drawn ones in place of running the tests."""
        self._items = {item.nodeid: item for item in session.items}
        covering = Covering(self._options.copied, self.measured, list(self._items))
        drawn = _drawn(self._root, self._options)
        # Once, here: a fork would copy all that it looks at.
        self._functions = [thing for thing in gc.get_objects() if type(thing) is FunctionType]
        gc.freeze()
        with suppress(KeyboardInterrupt):
            while drawn:
                for number, site in enumerate(drawn, 1):
                    chosen = covering.tests(site, self._options.budget)
                    self._try(site, number, chosen, covering.is_loaded(site))
                unsound = self._fail_anyway({test for test in self.caught_by.values() if test})
                drawn = [site for site, test in self.caught_by.items() if test in unsound]
        return True

    def _try(self, site: Site, number: int, chosen: Sequence[str], loaded: bool) -> None:
        tree, what = mutated(self._root, site)
        path, tests = self._root / site.path, [test for test in chosen if test not in self._unsound]

        def run() -> bool:
            at_hand = not loaded and swap(tree, path, self._functions)
            return self._passes(tests) if at_hand else self._pass_anew(tests)

        with _changed(path, ast.unparse(tree), number):
            failed = self._failing(run, site) if tests else None
        told = "survived" if failed is None else f"caught by {failed}" if failed else "did not load"
        print(f"  {site} line {site.line}, {len(tests)} tests, {told}: {what}", flush=True)
        self.caught_by[site] = failed

    def _fail_anyway(self, tests: set[str]) -> set[str]:
        """Find those among tests that fail as it is, which are not asked again."""
        found: set[str] = set()
        while failed := self._failing(lambda: self._passes(sorted(tests - found)), "no mutant"):
            print(f"  left out, fails as it is: {failed}", flush=True)
            found.add(failed)
        self._unsound |= found
        return found

    def _failing(self, run: Callable[[], bool], about: object) -> str | None:
        """Run tests in a forked process; return the first that fails or hangs, "" where none began."""
        self.told.write_text("")
        if (status := _forked(run)) == 0:
            return None
        if os.WIFSIGNALED(status):
            print(f"  {about}: hung in {self.told.read_text()}", flush=True)
        return self.told.read_text()

    def _passes(self, tests: Sequence[str]) -> bool:
        items = [self._items[test] for test in tests]
        for item, following in zip(items, [*items[1:], None], strict=True):
            signal.alarm(_hangs_s(self.measured.get(item.nodeid, 0.0)))
            item.ihook.pytest_runtest_protocol(item=item, nextitem=following)
        return True

    def _pass_anew(self, tests: Sequence[str]) -> bool:
        """Load all of the project again: what a file does when it is loaded was changed."""
        own = str(self._root)
        for name, module in list(sys.modules.items()):
            if str(getattr(module, "__file__", "")).startswith(own) and name != "__main__":
                del sys.modules[name]
        signal.alarm(_hangs_s(self._options.budget))
        return pytest.main([*_QUIET, *tests], plugins=[_First(self.told)]) == pytest.ExitCode.OK


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


def _hangs_s(usual_s: float) -> int:
    """Say after how long tests hang: the first of a file makes what all of it use, on a busy machine."""
    return 30 + round(5.0 * usual_s)


def _forked(run: Callable[[], bool]) -> int:
    """Run tests in a forked process and return its status; what they started ends with it."""
    sys.stdout.flush()
    child = os.fork()
    if child == 0:
        status = 1
        try:
            os.setsid()
            nothing = os.open(os.devnull, os.O_RDWR)
            for descriptor in (1, 2):
                os.dup2(nothing, descriptor)
            status = 0 if run() else 1
        finally:
            os._exit(status)
    _, status = os.waitpid(child, 0)
    with suppress(ProcessLookupError):
        os.killpg(child, signal.SIGKILL)
    return status


def _table(caught_by: dict[Site, str | None]) -> float:
    """Print what was caught by room; return the share in percent."""
    count = Counter((site.path.split("/")[1], test is not None) for site, test in caught_by.items())
    for room in sorted({room for room, _ in count}):
        print(f"{room:20}{count[room, True]:>6} caught{count[room, False]:>6} survived")
    caught, n = sum(test is not None for test in caught_by.values()), len(caught_by)
    print(f"{share(caught, n)} caught = {100.0 * caught / max(n, 1):.1f} %")
    return 100.0 * caught / max(n, 1)


if __name__ == "__main__":
    sys.exit(main())
