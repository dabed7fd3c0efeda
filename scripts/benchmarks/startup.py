"""Measure start-up beside `python -c 'import numpy'`: scripts/bench startup"""

from __future__ import annotations

import subprocess
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

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
CHECKS = tuple(
    {"what": f"{name}, times import numpy", "of": name, "over": BASE, "at_most": 2.5}
    for name in ("mavcompass --version", "import mavcompass")
)


@pytest.mark.parametrize("name", COMMANDS)
def test_start(benchmark: Callable[..., Any], name: str) -> None:
    quiet = {"check": True, "stdout": subprocess.DEVNULL}
    benchmark.pedantic(subprocess.run, (COMMANDS[name],), quiet, rounds=15, warmup_rounds=1)  # type: ignore[attr-defined]
