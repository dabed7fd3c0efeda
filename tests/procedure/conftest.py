"""Lets the tests in the folders below import the helper that stands here: bent_vehicles."""

from __future__ import annotations

import itertools
import random
from collections.abc import Callable
from functools import cache
from types import ModuleType
from typing import Any

import pytest
from wakes import no_script_spins as no_script_spins


@pytest.fixture(scope="module")
def interrupted(campaigns: Callable[[str], ModuleType]) -> Callable[..., Any]:
    """Let a fault of `fault_matrix.py` happen to a calibration, anywhere from its first turn on.

    Or where its n-th command after the write is sent: which takes the sources of yaw off, and on again.
    """
    matrix = campaigns("fault_matrix")
    traced = cache(matrix.trace)

    def interrupt(name: str, kind: str, fault: str, seed: int = 0, command: int = 0) -> Any:
        work = next(work for work in matrix.WORKS if (work.name, work.kind) == (name, kind))
        steps = traced(work).steps
        places = [(step.kind, step.what) for step in steps]
        chance = random.Random(f"{name} {kind} {fault} {seed}")
        number = chance.randrange(places.index(("state", "turn")), len(steps)) + 1
        if command:
            written = places.index(("state", "written"))
            sent = (k for k in range(written, len(steps)) if places[k] == ("send", "CommandLong"))
            number = next(itertools.islice(sent, command - 1, None)) + 1
        happening = next(one for one in matrix.FAULTS if one.name == fault)
        return matrix.run_cell(matrix.Cell(work, number, steps[number - 1], happening, seed), traced(work))

    return interrupt
