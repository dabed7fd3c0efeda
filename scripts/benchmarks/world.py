"""CompassBench: one benchmark for the field, mavcompass and its rivals on sealed cases, in one table.

    scripts/bench world [-- --count 10 --rivals mavcompass VQF --docs]

Cases, truth, scoring and rivals are described in scripts/benchmarks/compassbench/README.md. Takes about
half an hour on two cores. Rivals that need other releases of numpy get an environment of their own
(build/peers/world, made once). `--docs` puts the tables into docs/compassbench.md.
"""

from __future__ import annotations

import argparse
import json
import os
import subprocess
import sys
import threading
import venv
from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any

from compassbench import table
from compassbench.cases import KINDS
from compassbench.recordings import are_there
from compassbench.rivals import RIVALS

HERE = Path(__file__).resolve().parent
PROJECT = HERE.parents[1]
PEERS = ("magyc==1.0.0", "vqf==2.1.2", "ahrs==0.4.0", "pymavlink")
CHUNK = 120
QUICK = ("--count", "4")


def main(argv: Sequence[str] | None = None) -> dict[str, Any]:
    """Run everybody on everything, print the tables and return the figures."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--count", type=int, default=None, help="only the first cases of each kind")
    parser.add_argument("--rivals", nargs="*", choices=list(RIVALS), default=list(RIVALS), metavar="RIVAL")
    parser.add_argument("--workers", type=int, default=2)
    parser.add_argument("--docs", action="store_true", help="put the tables into docs/compassbench.md")
    parser.add_argument("--seals", action="store_true", help="only check that the cases are those sealed")
    parser.add_argument(
        "--answers", type=Path, default=PROJECT / "build" / "compassbench.json", help="keep them there"
    )
    options = parser.parse_args(argv)
    with ThreadPoolExecutor(options.workers) as pool:
        broken = [kind for kind, same in zip(KINDS, pool.map(as_sealed, KINDS), strict=True) if not same]
    print(
        f"{sum(kind.count for kind in KINDS.values())} cases, as sealed"
        if not broken
        else f"CHANGED: {broken}"
    )
    if options.seals or broken:
        return {
            "checks": [{"what": "kinds of cases that are not as sealed", "value": len(broken), "at_most": 0}]
        }
    others = python_of_peers() if any(RIVALS[name].own for name in options.rivals) else None
    jobs = [job for name in options.rivals for job in jobs_of(name, options.count)]
    options.answers.parent.mkdir(parents=True, exist_ok=True)
    answers: list[dict[str, Any]] = []
    with ThreadPoolExecutor(options.workers) as pool:
        for some in pool.map(lambda job: answered(*job, others), jobs):
            answers += some
            options.answers.write_text(json.dumps(answers, indent=0) + "\n")
    words = table.of(answers)
    print(words)
    if options.docs:
        table.put_into(PROJECT / "docs" / "compassbench.md", words)
    return {"checks": table.checks(answers)}


def as_sealed(kind: str) -> bool:
    """Tell whether the cases of a kind are those that were sealed; made in a process of its own."""
    words = [sys.executable, "-c", f"from compassbench.cases import seal; print(seal({kind!r}))"]
    made = subprocess.run(words, cwd=HERE, capture_output=True, text=True, check=True).stdout.strip()
    return bool(made == json.loads((HERE / "compassbench" / "seals.json").read_text())[kind])


def jobs_of(name: str, count: int | None) -> list[tuple[str, list[tuple[str, int]]]]:
    """List a rival's cases in parts, each with cases of all kinds."""
    rival = RIVALS[name]
    cases = [
        (kind, index)
        for index in range(0, max(made.count for made in KINDS.values()), rival.every)
        for kind, made in KINDS.items()
        if made.task == rival.task and index < min(made.count, count or made.count) and are_there(kind)
    ]
    return [(name, cases[first : first + CHUNK]) for first in range(0, len(cases), CHUNK)]


def answered(name: str, cases: list[tuple[str, int]], others: Path | None) -> list[dict[str, Any]]:
    """Let a rival answer in a process; where that dies, the case it was at has crashed."""
    python = others if RIVALS[name].own else Path(sys.executable)
    if python is None:
        return []
    single = {"OMP_NUM_THREADS": "1", "OPENBLAS_NUM_THREADS": "1", "PYTHONPATH": str(PROJECT)}
    answers: list[dict[str, Any]] = []
    while len(answers) < len(cases):
        done = subprocess.run(
            [python, "-m", "compassbench.work", name],
            input=json.dumps(cases[len(answers) :]),
            capture_output=True,
            text=True,
            cwd=HERE,
            env={**os.environ, **single},
        )
        answers += [json.loads(line[1:]) for line in done.stdout.splitlines() if line.startswith("# {")]
        if len(answers) < len(cases):
            kind, index = cases[len(answers)]
            why = f"its process ended with {done.returncode}: {done.stderr.strip()[-150:]}"
            fallen = {"rival": name, "kind": kind, "index": index, "crashed": why, "seconds": 0.0}
            answers.append({**fallen, "answerable": KINDS[kind].answerable})
    print(f"  {name}: {len(answers)} ({threading.active_count() - 1} at work)", file=sys.stderr, flush=True)
    return answers


def python_of_peers() -> Path | None:
    """Return the Python of the rivals' environment, made on first use; None where it cannot be made."""
    folder = PROJECT / "build" / "peers" / "world"
    python = folder / "bin" / "python"
    if not python.exists():
        print("Installing rivals into an environment of their own, once.", flush=True)
        venv.create(folder, with_pip=True)
    if (
        subprocess.run([python, "-c", "import magyc, vqf, ahrs, pymavlink"], capture_output=True).returncode
        == 0
    ):
        return python
    done = subprocess.run([python, "-m", "pip", "install", "-q", *PEERS], capture_output=True, text=True)
    if done.returncode != 0:
        print(f"Left out, they cannot be installed: {', '.join(PEERS)}: {done.stderr.strip()[-200:]}")
        return None
    return python


if __name__ == "__main__":
    main()
