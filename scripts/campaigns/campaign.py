"""What every campaign is made of: options, cases in processes, counts with intervals, limits, its end."""

from __future__ import annotations

import argparse
import json
import math
import resource
import signal
import sys
import tempfile
from collections.abc import Callable, Collection, Iterable, Iterator
from concurrent.futures import ProcessPoolExecutor
from contextlib import contextmanager, nullcontext
from dataclasses import asdict, dataclass
from pathlib import Path
from types import FrameType
from typing import Any, TypeVar

import numpy as np

T = TypeVar("T")
Case = TypeVar("Case")
PROJECT = Path(__file__).resolve().parents[2]
# A real disk's fsync is most of the time of a case that writes; what is judged is the same.
IN_MEMORY = "/dev/shm" if Path("/dev/shm").is_dir() else None


def borrow(*rooms: str) -> None:
    """Let what rooms of the tests are made with be imported."""
    sys.path[:0] = [str(PROJECT), *(str(PROJECT / "tests" / room) for room in rooms)]


@dataclass(frozen=True)
class Several:
    """Say that an option may be given more than once, and what for; None: for anything."""

    choices: Collection[str] | None = None


def options(about: str | None, words: list[str] | None = None, **kinds: Any) -> argparse.Namespace:
    """Read a command line; `--json FILE` is everybody's.

    Parameters
    ----------
    about: the campaign's docstring, which --help shows.
    words: the command line; None for the program's own.
    kinds: by name, each with (kind, help) where the docstring does not say all: a number or text is the
        default, False a flag, a list what may be chosen (the first, which may be None, unless told
        otherwise), a class what may be absent; `list` takes the files named without an option.
    """
    parser = argparse.ArgumentParser(description=about, formatter_class=argparse.RawDescriptionHelpFormatter)
    for name, kind in {**kinds, "json": (Path, "write the figures there")}.items():
        kind, said = kind if isinstance(kind, tuple) else (kind, None)
        how: dict[str, Any] = {"type": type(kind), "default": kind}
        if kind is False:
            how = {"action": "store_true"}
        elif isinstance(kind, Several):
            how = {"action": "append", "choices": kind.choices}
        elif isinstance(kind, list):
            how = {"choices": [one for one in kind if one is not None], "default": kind[0]}
        elif isinstance(kind, type):
            how = {"type": kind}
        if kind is list:
            parser.add_argument(name, nargs="*", type=Path, help=said)
        else:
            parser.add_argument("--" + name.replace("_", "-"), help=said, **how)
    return parser.parse_args(words)


def tried(
    judge: Callable[[Case], T],
    cases: Iterable[Case],
    wrong: Callable[[T], Iterable[str]] = lambda outcome: (),
    *,
    workers: int = 1,
    every: int = 0,
) -> Iterator[T]:
    """Judge cases, here or in processes, and yield the outcomes in their order.

    Printed are what is `wrong` with an outcome, beside its case, and after so many how far it is.
    """
    cases, bad = list(cases), 0
    with ProcessPoolExecutor(workers) if workers > 1 else nullcontext() as pool:
        outcomes = map(judge, cases) if pool is None else pool.map(judge, cases)
        for done, (case, outcome) in enumerate(zip(cases, outcomes, strict=True), 1):
            sentences = list(wrong(outcome))
            bad += bool(sentences)
            for sentence in sentences:
                print(f"  {case}: {sentence}", flush=True)
            if every and done % every == 0:
                print(f"  {done} of {len(cases)}, {bad} wrong", file=sys.stderr, flush=True)
            yield outcome


def rms(values: Iterable[Any]) -> float:
    """Return the root mean square of numbers, or of arrays, each counted once; nan of nothing."""
    squares = [np.mean(np.square(one)) for one in values]
    return math.sqrt(float(np.mean(squares))) if squares else math.nan


def share(hits: int, of: int) -> str:
    """Say a count with Wilson's 95 % interval of its share."""
    from mavcompass.chance import wilson

    low, high = wilson(hits, of)
    return f"{hits} of {of} ({100.0 * low:.1f} .. {100.0 * high:.1f} %)"


def ended(path: Path | None, figures: Any, wrong: object) -> int:
    """Write the figures where that is wanted; return the exit code, 1 where something is wrong."""
    if path is not None:
        path.write_text(json.dumps(figures, indent=1, default=asdict) + "\n", encoding="utf-8")
    return 1 if wrong else 0


@contextmanager
def folder() -> Iterator[Path]:
    """Have a folder for a while, in memory where that can be."""
    with tempfile.TemporaryDirectory(dir=IN_MEMORY) as name:
        yield Path(name)


@contextmanager
def limit(seconds: float, error: BaseException, processor: bool = False) -> Iterator[None]:
    """End what takes too long by an error; by processor time where the machine may be busy otherwise."""
    number, timer = (
        (signal.SIGPROF, signal.ITIMER_PROF) if processor else (signal.SIGALRM, signal.ITIMER_REAL)
    )

    def over(number: int, frame: FrameType | None) -> None:
        raise error

    before = signal.signal(number, over)
    signal.setitimer(timer, seconds)
    try:
        yield
    finally:
        signal.setitimer(timer, 0.0)
        signal.signal(number, before)


def resident_mb(process: int | str = "self") -> float:
    """Return a process's resident memory."""
    pages = int(Path(f"/proc/{process}/statm").read_text().split()[1])
    return pages * resource.getpagesize() / 1e6
