"""Let one rival solve cases in this process: python -m compassbench.work RIVAL, the cases on standard input.

Prints a line of JSON a case, so that a rival which takes its process down loses only the case it was at.
"""

from __future__ import annotations

import json
import signal
import sys
import time
import warnings
from importlib import import_module
from typing import Any

import numpy as np

from compassbench.cases import case_of
from compassbench.judge import judged
from compassbench.rivals import RIVALS, Refusal

LIMIT_S = 20.0


def over(number: int, frame: object) -> None:
    """End a case that takes too long."""
    raise TimeoutError(f"ran into the limit of {LIMIT_S:g} s")


def solved(name: str, kind: str, index: int) -> dict[str, Any]:
    """Solve one case; what goes wrong is the rival's answer."""
    rival = RIVALS[name]
    solve = import_module(f"compassbench.rivals.{rival.module}").solve
    case = case_of(kind, index)
    answer: dict[str, Any] = {"rival": name, "kind": kind, "index": index, "answerable": case.answerable}
    signal.setitimer(signal.ITIMER_PROF, LIMIT_S)
    start = time.process_time()
    try:
        found = solve(case, rival.argument)
        answer |= judged(case, found)
    except Refusal as why:
        answer["refused"] = str(why)
    except Exception as error:
        answer["crashed"] = f"{type(error).__name__}: {error}"[:200]
    finally:
        signal.setitimer(signal.ITIMER_PROF, 0.0)
    return {**answer, "seconds": time.process_time() - start}


def main(name: str) -> None:
    """Solve the cases (pairs of kind and index) that standard input lists as JSON, and print."""
    signal.signal(signal.SIGPROF, over)
    warnings.simplefilter("ignore")
    np.seterr(all="ignore")
    for kind, index in json.load(sys.stdin):
        print("\n#", json.dumps(solved(name, kind, index)), flush=True)


if __name__ == "__main__":
    main(*sys.argv[1:])
