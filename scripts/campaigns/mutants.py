"""Change the code by a little, many times: do the tests notice?

    python scripts/campaigns/mutants.py [--mutants 150] [--seed 1] [--room heading].. [--longest 30]
    python scripts/campaigns/mutants.py --mutant mavcompass/frames.py#17      # one again

Places are drawn evenly over the code of the rooms: an operator, a comparison, a condition, a number, what is
returned. For each the tests of its own room are run, and where these are content, the nearest others,
`--longest` seconds of both; of both those that run its line, the quickest first, if `scripts/coverage` has
found which they are. The mutant is caught when one fails or hangs. Slower tests might notice more: the
share is a lower bound. Works in a copy; nothing here is changed. Exit code 1 below `--least` percent.
"""

from __future__ import annotations

import argparse
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
import traceback
from collections import Counter
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from functools import partial
from pathlib import Path

PROJECT = Path(__file__).resolve().parents[2]
sys.path.insert(0, str(Path(__file__).resolve().parent))

from mutation.covering import Covering, is_measured  # noqa: E402
from mutation.sites import Site, mutated, sites  # noqa: E402

ROOMS: dict[str, tuple[str, ...]] = {
    "calibration": ("calibration",),
    "correction, frames": ("correction.py", "frames.py"),
    "heading": ("heading",),
    "procedure": ("procedure",),
    "service": ("service",),
    "vehicle": ("vehicle",),
    "gap verdicts": ("gap/answer/decision.py", "gap/selection"),
}
# These try the project's folder itself, which a copy is not.
_UNFIT = ("tests/test_", "tests/acceptance/")
_NOTICED, _UNNOTICED = 1, 0
_WAITS_S = 60.0


@dataclass(frozen=True)
class Verdict:
    """Say what became of a mutant: "caught", or "survived"."""

    room: str
    site: Site
    what: str
    told: str


def main() -> int:
    """Draw the mutants, try each, print the table."""
    options = _parsed()
    if not options.copied:
        return _in_a_copy(sys.argv[1:])
    for number in (signal.SIGINT, signal.SIGTERM):
        signal.signal(number, signal.default_int_handler)  # also where a shell has its background ignore them
    root = Path.cwd()
    drawn = _drawn(root, options)
    import_what_does_not_change()
    trial, verdicts = Trial(root, options.copied, options.longest), list[Verdict]()
    random.Random(options.seed).shuffle(drawn)  # who stops it early has a fair sample
    try:
        for number, (room, site) in enumerate(drawn, 1):
            verdicts.append(trial.verdict(room, site, number))
    except KeyboardInterrupt:
        print("stopped")
    share = _table(verdicts)
    return 0 if share >= options.least else 1


def _parsed() -> argparse.Namespace:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--mutants", type=int, default=150)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--room", action="append", choices=list(ROOMS))
    parser.add_argument("--mutant", action="append", help="FILE#NUMBER, as it is printed")
    parser.add_argument("--longest", type=float, default=30.0, help="seconds of tests a mutant")
    parser.add_argument("--least", type=float, default=88.0, help="percent")
    parser.add_argument("--copied", type=Path, help=argparse.SUPPRESS)
    return parser.parse_args()


def _in_a_copy(arguments: Sequence[str]) -> int:
    """Run this program in a copy of the project: the programs that tests start are to be mutants, too."""
    with tempfile.TemporaryDirectory() as folder:
        copy = Path(folder) / "mavcompass"
        shutil.copytree(
            PROJECT,
            copy,
            ignore=shutil.ignore_patterns(".git", ".venv*", "__pycache__", ".*cache", ".coverage*"),
        )
        environment = {**os.environ, "PYTHONPATH": str(copy), "PYTHONPYCACHEPREFIX": f"{folder}/bytecode"}
        environment.pop("PYTHONDONTWRITEBYTECODE", None)
        environment.setdefault("MAVCOMPASS_SHARED_DATA", str(PROJECT.parent / "shared" / "data"))
        command = [sys.executable, str(copy / "scripts" / "campaigns" / "mutants.py")]
        command += ["--copied", str(PROJECT), *arguments]
        return subprocess.run(command, cwd=copy, env=environment).returncode


def _drawn(root: Path, options: argparse.Namespace) -> list[tuple[str, Site]]:
    places = [
        (room, site)
        for room, code in ROOMS.items()
        if not options.room or room in options.room
        for path in _files(root, code)
        for site in sites(root, path)
    ]
    if options.mutant:
        return [(room, site) for room, site in places if str(site) in options.mutant]
    chosen = random.Random(options.seed).sample(range(len(places)), min(options.mutants, len(places)))
    print(f"{len(chosen)} of {len(places)} places, seed {options.seed}", flush=True)
    return [places[k] for k in sorted(chosen)]


def _files(root: Path, code: Sequence[str]) -> list[str]:
    paths = [root / "mavcompass" / name for name in code]
    files = [f for path in paths for f in ([path] if path.is_file() else sorted(path.rglob("*.py")))]
    return [str(f.relative_to(root)) for f in files]


def import_what_does_not_change() -> None:
    """Load what every mutant needs before they are forked."""
    import numpy  # noqa: F401
    import pytest  # noqa: F401
    import scipy.linalg
    import scipy.optimize
    import scipy.signal
    import scipy.stats  # noqa: F401


class Trial:
    """Try mutants in a copy of the project."""

    def __init__(self, root: Path, project: Path, longest_s: float) -> None:
        self.root, self.longest_s = root, longest_s
        self._covering = Covering(project) if is_measured(project) else None
        self._failed = root.parent / "failed"
        self._sound: dict[str, bool] = {}

    def verdict(self, room: str, site: Site, number: int) -> Verdict:
        """Try one."""
        text, what = mutated(self.root, site)
        for tests in self._stages(site):
            if self._is_noticed_by(tests, site, text, number):
                return Verdict(room, site, what, "caught")
        print(f"  {site} line {site.line}: {what}", flush=True)
        return Verdict(room, site, what, "survived")

    def _stages(self, site: Site) -> Iterator[list[str]]:
        """Give the tests of the place's own room, then others."""
        near, others = nearest(self.root, site.path)
        if self._covering is not None:
            # Who reads a table, or was written since, is not seen to run its line.
            changed = {t for t in (*near, *others) if self._covering.is_older_than(t)}
            whole = [t for t in near if not site.in_function or t in changed]
            elsewhere = [t for t in others if t in changed]
            left_out, room = {*whole, *elsewhere}, set(near)
            seen = [t for t in self._covering.tests(site) if not t.startswith(_UNFIT)]
            seen = [t for t in seen if t.partition("::")[0] not in left_out]
            near = [t for t in seen if t.partition("::")[0] in room] + whole
            others = elsewhere + [t for t in seen if t.partition("::")[0] not in room]
        yield near
        yield others

    def _is_noticed_by(self, tests: list[str], site: Site, text: str, number: int) -> bool:
        unsound: list[str] = []
        while tests:
            with _changed(self.root / site.path, text, number):
                noticed = self._status([*tests, *(f"--deselect={test}" for test in unsound)])
            blamed = self._failed.read_text() if self._failed.exists() else ""
            if not noticed or not blamed or self._is_sound(blamed):
                return noticed
            unsound.append(blamed)
        return False

    def _is_sound(self, test: str) -> bool:
        """Tell whether a test passes as it is."""
        if test not in self._sound:
            self._sound[test] = not self._status([test])
            if not self._sound[test]:
                print(f"  left out, fails as it is: {test}", flush=True)
        return self._sound[test]

    def _status(self, arguments: list[str]) -> bool:
        """Run tests in a forked process; True where one fails, or the process has to be ended."""
        self._failed.unlink(missing_ok=True)
        run = partial(_run, arguments, self._failed, self.longest_s)
        return _forked(run, self.longest_s) != _UNNOTICED


def nearest(root: Path, path: str) -> tuple[list[str], list[str]]:
    """Return the tests in the folder that mirrors a file's, and the others of the room above.

    Those with the file's name come first, then those that speak of it, then those that speak of its folder.
    """
    module = path.removesuffix(".py").replace("/", ".")
    package, _, name = module.rpartition(".")
    folders = Path(path).parts[1:-1] or ("ground",)
    depth = max(n for n in range(1, len(folders) + 1) if (root / "tests" / Path(*folders[:n])).is_dir())
    folder = root / "tests" / Path(*folders[:depth])

    def distance(test: Path) -> tuple[bool, bool, bool]:
        text = test.read_text()
        return name not in test.name, module not in text, package not in text

    tests = sorted(sorted((root / "tests" / folders[0]).rglob("test_*.py")), key=distance)
    near = [str(test.relative_to(root)) for test in tests if folder in test.parents]
    others = [str(test.relative_to(root)) for test in tests if folder not in test.parents]
    return near, others


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


def _run(arguments: list[str], failed: Path, longest_s: float) -> int:
    import pytest

    class Watch:
        """Note what fails first; end between two tests when the time is up."""

        session: pytest.Session
        began_s = time.process_time()  # on a busy machine the same tests are run as on an idle one

        def pytest_sessionstart(self, session: pytest.Session) -> None:
            self.session = session

        def pytest_runtest_logreport(self, report: pytest.TestReport) -> None:
            if report.failed:
                failed.write_text(report.nodeid)
            elif time.process_time() - self.began_s > longest_s:
                self.session.shouldstop = "the time is up"

    done = pytest.main(["-x", "-q", "-p", "no:cacheprovider", "-n", "0", *arguments], plugins=[Watch()])
    ended = done == pytest.ExitCode.INTERRUPTED and time.process_time() - Watch.began_s > longest_s
    return _UNNOTICED if not failed.exists() and (done == pytest.ExitCode.OK or ended) else _NOTICED


def _forked(work: Callable[[], int], longest_s: float) -> int:
    """Do work in a forked process, silently; a process that hangs ends by the system."""
    sys.stdout.flush()
    child = os.fork()
    if child == 0:
        status = _NOTICED
        try:
            os.setsid()
            limit_s = int(3.0 * longest_s + 20.0)
            resource.setrlimit(resource.RLIMIT_CPU, (limit_s, limit_s))
            nothing = os.open(os.devnull, os.O_RDWR)
            for descriptor in (0, 1):
                os.dup2(nothing, descriptor)
            status = work()
        except Exception:
            traceback.print_exc()
        finally:
            os._exit(status)
    end_s = time.monotonic() + 40.0 * longest_s + _WAITS_S
    while time.monotonic() < end_s:
        ended, status = os.waitpid(child, os.WNOHANG)
        if ended:
            break
        time.sleep(0.02)
    else:
        status = -1
    # What its tests started ends with it.
    with suppress(ProcessLookupError):
        os.killpg(child, signal.SIGKILL)
    if status == -1:
        os.waitpid(child, 0)
        return _NOTICED
    return os.waitstatus_to_exitcode(status)


def _table(verdicts: Sequence[Verdict]) -> float:
    """Print what was caught by room; return the share in percent."""
    count = Counter((v.room, v.told) for v in verdicts)
    tolds = ("caught", "survived")
    print(f"{'room':20}" + "".join(f"{told:>16}" for told in tolds))
    for room in dict.fromkeys(v.room for v in verdicts):
        print(f"{room:20}" + "".join(f"{count[room, told]:>16}" for told in tolds))
    caught, n = sum(v.told == "caught" for v in verdicts), len(verdicts)
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
