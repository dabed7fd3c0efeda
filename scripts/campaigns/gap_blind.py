"""Score the gap diagnosis on sealed cases, tier by tier; print counts with their intervals.

    nice -n 5 .venv/bin/python scripts/campaigns/gap_blind.py --tier none --cases 200 --seed 9001

Seeds below 5000 are for tuning, seeds from 9000 on for scoring: a scoring seed is used once, after the
thresholds of the code under test were committed.
"""

from __future__ import annotations

import argparse
import json
import sys
import time
from pathlib import Path

from mavcompass.gap.trial.cases import GENERATORS, TIERS
from mavcompass.gap.trial.trial import run_trial


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--generator", choices=GENERATORS, default="bench")
    parser.add_argument("--tier", choices=TIERS, help="'outside' is one of the vehicles alone")
    parser.add_argument("--cases", type=int, default=100)
    parser.add_argument("--seed", type=int, default=7)
    parser.add_argument("--out", type=Path)
    arguments = parser.parse_args()
    started = time.perf_counter()

    def progress(done: int) -> None:
        if done % 20 == 0:
            print(f"{done} of {arguments.cases}, {time.perf_counter() - started:.0f} s", file=sys.stderr)

    trial = run_trial(arguments.cases, arguments.seed, arguments.tier, progress, arguments.generator)
    print("\n".join(trial.lines()))
    for case in trial.cases:
        right = case.exact or (case.label.tier == "outside" and case.flagged)
        wrong = not right or (case.withheld is not None and case.withheld.verdict == "named")
        if wrong and not (case.label.tier != "none" and case.separation < 5.0):
            print(
                f"  {case.label.motion} seed {case.label.seed} d {case.label.size_sigma:.1f}"
                f" d_sep {case.separation:.1f}: {' + '.join(case.label.effects) or 'nothing'}"
                f" -> {case.answer.verdict} {case.answer.effects}"
                f" withheld {case.withheld.verdict if case.withheld else '-'}"
            )
    if arguments.out is not None:
        arguments.out.write_text(json.dumps(trial.to_json(), indent=1), encoding="utf-8")


if __name__ == "__main__":
    main()
