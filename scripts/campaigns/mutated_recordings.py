"""Read tens of thousands of damaged recordings: no traceback, no hang, bounded memory, no wrong number.

    python scripts/campaigns/mutated_recordings.py [--files 20000] [--seed 1] [--json FILE]

Each file is one of five small recordings (.tlog, .bin, .log, .csv, .ulg) with bits flipped, stretches
overwritten, cut out or spliced in. A telemetry log's messages have a checksum of 16 bits: a message that
was never sent passes it once in 65 536 damaged ones, so a few in a long campaign are the checksum's and
not the reader's; they are counted and shown.
"""

from __future__ import annotations

import json
import resource
import sys
import time
import traceback
from collections import Counter
from functools import cache

import numpy as np
from campaign import borrow, ended, folder, limit, options, tried

borrow("logs")
from mutations import checked_rows, mutate, originals, read_or_refuse  # noqa: E402

LONGEST_S, MOST_MEMORY_FACTOR = 20.0, 2.0
SUFFIXES = (".bin", ".csv", ".log", ".tlog", ".ulg")
Outcome = tuple[str, int, float, str]  # how it ended, messages never sent, seconds, the defect
Contents = tuple[dict[str, bytes], set[tuple[str, bytes]]]


@cache
def recordings() -> Contents:
    """Make the recordings, and read each; return them and what the telemetry log's messages are."""
    with folder() as place:
        contents = originals(place)
        for suffix in contents:
            read_or_refuse(place / f"original{suffix}")
        return contents, checked_rows(place / "original.tlog")


def read(case: tuple[int, int]) -> Outcome:
    """Damage the recording of a number by seed and number, and read it."""
    (seed, number), (contents, sent) = case, recordings()
    suffix, begun, never_sent = SUFFIXES[number % len(SUFFIXES)], time.process_time(), 0
    with folder() as place:
        path = place / f"damaged{suffix}"
        path.write_bytes(mutate(contents[suffix], np.random.default_rng([seed, number])))
        try:
            with limit(LONGEST_S, TimeoutError(f"one small file took more than {LONGEST_S:g} s")):
                ending = f"{suffix} {'refused' if read_or_refuse(path) is None else 'read'}"
                if suffix == ".tlog":
                    never_sent = len(checked_rows(path) - sent)
        except BaseException:
            return f"{suffix} broke", 0, time.process_time() - begun, traceback.format_exc(limit=-2)
    return ending, never_sent, time.process_time() - begun, ""


def main() -> int:
    """Read so many damaged files; print the figures."""
    wanted = options(__doc__, files=20_000, seed=1)
    assert tuple(recordings()[0]) == SUFFIXES
    before_mb, started = _peak_mb(), time.monotonic()
    cases = [(wanted.seed, number) for number in range(wanted.files)]
    outcomes = [*tried(read, cases, lambda outcome: [outcome[3]] if outcome[3] else [], every=2000)]
    figures = {
        "files": len(outcomes),
        "outcomes": dict(sorted(Counter(ending for ending, *_ in outcomes).items())),
        "messages_never_sent": sum(never_sent for _, never_sent, *_ in outcomes),
        "slowest_s": max(
            (round(seconds, 3), *case) for (_, _, seconds, _), case in zip(outcomes, cases, strict=True)
        ),
        "memory_factor": round(_peak_mb() / before_mb, 3),
        "seconds": round(time.monotonic() - started, 1),
    }
    print(json.dumps(figures, indent=1))
    broke = any(defect for *_, defect in outcomes)
    return ended(wanted.json, figures, broke or figures["memory_factor"] > MOST_MEMORY_FACTOR)


def _peak_mb() -> float:
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024


if __name__ == "__main__":
    sys.exit(main())
