"""Score the gap diagnosis on sealed cases, tier by tier; print counts with their intervals.

    nice -n 5 .venv/bin/python scripts/campaigns/gap_blind.py --tier none --cases 200 --seed 9001

Seeds below 5000 are for tuning, seeds from 9000 on for scoring: a scoring seed is used once, after the
thresholds of the code under test were committed.
"""

from __future__ import annotations

import sys
import time

from campaign import ended, options

from mavcompass.gap.trial.cases import GENERATORS, TIERS
from mavcompass.gap.trial.trial import run_trial


def main() -> int:
    wanted = options(
        __doc__,
        generator=["bench", *(name for name in GENERATORS if name != "bench")],
        tier=([None, *TIERS], "'outside' is one of the vehicles alone"),
        cases=100,
        seed=7,
    )
    started = time.perf_counter()

    def progress(done: int) -> None:
        if done % 20 == 0:
            print(f"{done} of {wanted.cases}, {time.perf_counter() - started:.0f} s", file=sys.stderr)

    trial = run_trial(wanted.cases, wanted.seed, wanted.tier, progress, wanted.generator)
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
    return ended(wanted.json, trial.to_json(), wrong=False)


if __name__ == "__main__":
    sys.exit(main())
