"""Read tens of thousands of damaged recordings: no traceback, no hang, bounded memory, no wrong number.

    python scripts/campaigns/mutated_recordings.py [--files 20000] [--seed 1] [--json FILE]

Each file is one of five small recordings (.tlog, .bin, .log, .csv, .ulg) with bits flipped, stretches
overwritten, cut out or spliced in. A telemetry log's messages have a checksum of 16 bits: a message that
was never sent passes it once in 65 536 damaged ones, so a few in a long campaign are the checksum's and
not the reader's; they are counted and shown.
"""

from __future__ import annotations

import argparse
import json
import resource
import signal
import sys
import tempfile
import time
import traceback
from collections import Counter
from pathlib import Path
from typing import Any

import numpy as np

PROJECT = Path(__file__).resolve().parents[2]
sys.path[:0] = [str(PROJECT), str(PROJECT / "tests" / "logs")]

from mutations import checked_rows, mutate, originals, read_or_refuse  # noqa: E402

LONGEST_S = 20


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--files", type=int, default=20_000)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--json", type=Path, help="write the figures there")
    options = parser.parse_args()
    signal.signal(signal.SIGALRM, _hangs)
    with tempfile.TemporaryDirectory() as folder:
        figures = campaign(Path(folder), options.files, options.seed)
    print(json.dumps(figures, indent=1))
    if options.json:
        options.json.write_text(json.dumps(figures, indent=1) + "\n")
    if figures["defects"] or figures["memory_factor"] > 2.0:
        sys.exit(1)


def campaign(folder: Path, files: int, seed: int) -> dict[str, Any]:
    """Read so many damaged files; return the figures."""
    contents = originals(folder / "originals")
    sent = checked_rows(folder / "originals" / "original.tlog")
    for suffix in contents:
        read_or_refuse(folder / "originals" / f"original{suffix}")
    memory_before = _peak_mb()
    outcomes: Counter[str] = Counter()
    defects: list[str] = []
    slowest, never_sent = (0.0, ""), 0
    started = time.monotonic()
    for number in range(files):
        suffix = list(contents)[number % len(contents)]
        rng = np.random.default_rng([seed, number])
        path = folder / f"damaged{suffix}"
        path.write_bytes(mutate(contents[suffix], rng))
        signal.alarm(LONGEST_S)
        begun = time.process_time()
        try:
            outcomes[f"{suffix} {'refused' if read_or_refuse(path) is None else 'read'}"] += 1
            if suffix == ".tlog":
                never_sent += len(checked_rows(path) - sent)
        except BaseException:
            defects.append(f"{suffix} {number}: {traceback.format_exc(limit=-2)}")
            if len(defects) >= 20:
                break
        finally:
            signal.alarm(0)
        slowest = max(slowest, (round(time.process_time() - begun, 3), f"{suffix} {number}"))
    return {
        "files": sum(outcomes.values()) + len(defects),
        "outcomes": dict(sorted(outcomes.items())),
        "defects": defects,
        "messages_never_sent": never_sent,
        "slowest_s": slowest,
        "memory_factor": round(_peak_mb() / memory_before, 3),
        "seconds": round(time.monotonic() - started, 1),
    }


def _peak_mb() -> float:
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024


def _hangs(*_: object) -> None:
    raise TimeoutError(f"reading one small file took more than {LONGEST_S} s")


if __name__ == "__main__":
    main()
