"""Measure start-up beside `python -c 'import numpy'`, each the best of several, taken in turns.

scripts/bench startup [-- --runs 15]
"""

from __future__ import annotations

import argparse
import subprocess
import sys
import time
from collections.abc import Sequence
from pathlib import Path
from typing import Any

PROGRAM = Path(sys.executable).with_name("mavcompass")
COMMANDS = {
    "python -c 'import numpy'": [sys.executable, "-c", "import numpy"],
    "python -c ''": [sys.executable, "-c", ""],
    "mavcompass --version": [str(PROGRAM), "--version"],
    "import mavcompass": [sys.executable, "-c", "import mavcompass"],
    "import mavcompass; read_track": [sys.executable, "-c", "import mavcompass; mavcompass.read_track"],
    "from pymavlink import mavutil": [sys.executable, "-c", "from pymavlink import mavutil"],
}
BASE = next(iter(COMMANDS))
QUICK = ("--runs", "5")


def main(argv: Sequence[str] | None = None) -> dict[str, Any]:
    """Start every command in turns; return the shortest times, seconds."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--runs", type=int, default=15)
    runs = parser.parse_args(argv).runs
    best = dict.fromkeys(COMMANDS, float("inf"))
    for _ in range(runs + 1):  # the first round fills the file cache; a slow one does no harm to a minimum
        for name, command in COMMANDS.items():
            began = time.perf_counter()
            subprocess.run(command, check=True, stdout=subprocess.DEVNULL)
            best[name] = min(best[name], time.perf_counter() - began)
    for name, seconds in best.items():
        print(f"  {name:34s} {1e3 * seconds:7.1f} ms  {seconds / best[BASE]:5.2f} x numpy")
    checks = [
        {"what": f"{name}, times import numpy", "value": best[name] / best[BASE], "at_most": 2.5}
        for name in ("mavcompass --version", "import mavcompass")
    ]
    return {"seconds": best, "checks": checks}


if __name__ == "__main__":
    main()
