"""Feed hostile bytes to everything that reads them: no traceback, no hang, bounded memory.

    python scripts/campaigns/fuzz.py [--minutes 8] [--target toml].. [--seed 1]

Every target runs in a process of its own for its share of the time, coverage-guided by atheris where that is
installed (`pip install atheris`), by plain mutation where it is not. An input may take 20 s and the process
2 GB. What broke something is kept in scripts/campaigns/fuzz_corpus/TARGET and tried again by the tests. Exit
code 1 if anything broke.
"""

from __future__ import annotations

import resource
import subprocess
import sys
import tempfile
import time
from pathlib import Path

import numpy as np
from campaign import Several, ended, limit, options

CORPUS = Path(__file__).with_name("fuzz_corpus")
_START_UP_S = 600.0  # on a busy machine: the time of a share begins after all is loaded and instrumented
LONGEST_INPUT_S, MOST_MEMORY_MB, MOST_BYTES = 20, 2048, 8192
NAMES = (
    "framing codec listeners tlog dataflash dataflash-text ulog csv"
    " param params undo diagnosis preset toml address effect body guard"
).split()


def main() -> int:
    """Run every target for its share and tell what broke."""
    wanted = options(
        __doc__,
        minutes=(8.0, "over all targets in sum"),
        target=Several(NAMES),
        seed=1,
        one=(False, "in this process"),
    )
    targets = wanted.target or NAMES
    if wanted.one:
        return fuzz(targets[0], 60.0 * wanted.minutes, wanted.seed)
    share, broken = wanted.minutes / len(targets), []
    for name in targets:
        command = [sys.executable, __file__, "--one", "--target", name]
        command += ["--minutes", str(share), "--seed", str(wanted.seed)]
        said, status = ran(command, 60.0 * share + _START_UP_S)
        last = [line for line in said if line.startswith(("#", "Done"))][-1:]
        print(f"{name:15} {'broke' if status else 'right'}  {' '.join(last)}", flush=True)
        if status:
            broken.append(name)
            print("\n".join(said[-40:]), flush=True)
    return ended(wanted.json, {"broken": broken}, broken)


def ran(command: list[str], longest_s: float) -> tuple[list[str], int]:
    """Run a command; return what it said and its exit code. One that hangs is killed, which counts as 1."""
    try:
        done = subprocess.run(command, stdout=subprocess.DEVNULL, stderr=subprocess.PIPE, timeout=longest_s)
    except subprocess.TimeoutExpired as hung:
        late = f"killed: not over after {longest_s:.0f} s; it hangs, or the machine is too busy"
        return [*(hung.stderr or b"").decode(errors="replace").splitlines(), late], 1
    return done.stderr.decode(errors="replace").splitlines(), done.returncode


def fuzz(name: str, seconds: float, seed: int) -> int:
    """Fuzz one target in this process."""
    with tempfile.TemporaryDirectory() as work:
        try:
            import atheris
        except ImportError:
            return mutate_for(name, seconds, seed)
        with atheris.instrument_imports(include=["mavcompass"], enable_loader_override=False):
            from fuzz_targets import TARGETS, seeds

            begun_with = [*seeds(name), *kept(name)]
            for content in begun_with:
                TARGETS[name](content)  # what is loaded only when it is needed is to guide, too
        begun_with += [mutated(begun_with, seed, number) for number in range(50)]
        for k, content in enumerate(begun_with):
            (Path(work) / f"seed-{k}").write_bytes(content)
        (CORPUS / name).mkdir(parents=True, exist_ok=True)
        limits = [f"-timeout={LONGEST_INPUT_S}", f"-rss_limit_mb={MOST_MEMORY_MB}", f"-max_len={MOST_BYTES}"]
        kept_in = f"-artifact_prefix={CORPUS / name}/"
        time_limit = f"-max_total_time={max(1, round(seconds))}"
        atheris.Setup([sys.argv[0], work, *limits, kept_in, time_limit, f"-seed={seed}"], TARGETS[name])
        atheris.Fuzz()  # ends the process
        return 0


def mutate_for(name: str, seconds: float, seed: int) -> int:
    """Fuzz by mutation alone."""
    from fuzz_targets import TARGETS, seeds

    resource.setrlimit(resource.RLIMIT_DATA, (MOST_MEMORY_MB * 2**20, MOST_MEMORY_MB * 2**20))
    too_long = TimeoutError(f"an input took more than {LONGEST_INPUT_S} s")
    corpus, count = [*seeds(name), *kept(name)], 0
    end_s = time.monotonic() + seconds
    while time.monotonic() < end_s:
        content, count = mutated(corpus, seed, count), count + 1
        try:
            with limit(LONGEST_INPUT_S, too_long):
                TARGETS[name](content)
        except BaseException:
            (CORPUS / name).mkdir(parents=True, exist_ok=True)
            (CORPUS / name / f"crash-{seed}-{count}").write_bytes(content)
            raise
    print(f"Done {count} runs", file=sys.stderr)
    return 0


def mutated(corpus: list[bytes], seed: int, number: int) -> bytes:
    """Draw a damaged input; the same numbers give the same."""
    from mutations import mutate  # not before what it imports is instrumented

    chance = np.random.default_rng([seed, number])
    return mutate(corpus[chance.integers(len(corpus))], chance)[:MOST_BYTES]


def kept(name: str) -> list[bytes]:
    """Return what broke a target once."""
    return [path.read_bytes() for path in sorted((CORPUS / name).glob("*")) if path.is_file()]


if __name__ == "__main__":
    sys.exit(main())
