"""Lets the tests in the folders below import the helper that stands here: bent_vehicles."""

from __future__ import annotations

import random
from collections.abc import Callable
from functools import cache
from types import ModuleType
from typing import Any

import pytest
from wakes import no_script_spins as no_script_spins


@pytest.fixture(scope="module")
def interrupted(campaigns: Callable[[str], ModuleType]) -> Callable[[str, str, str, int], Any]:
    """Let a fault of `fault_matrix.py` happen to a calibration, anywhere from its first turn on."""
    matrix = campaigns("fault_matrix")
    traced = cache(matrix.trace)

    def interrupt(name: str, kind: str, fault: str, seed: int) -> Any:
        work = next(work for work in matrix.WORKS if (work.name, work.kind) == (name, kind))
        steps = traced(work).steps
        turn = next(k for k, step in enumerate(steps) if (step.kind, step.what) == ("state", "turn"))
        number = random.Random(f"{name} {kind} {fault} {seed}").randrange(turn, len(steps)) + 1
        happening = next(one for one in matrix.FAULTS if one.name == fault)
        return matrix.run_cell(matrix.Cell(work, number, steps[number - 1], happening, seed), traced(work))

    return interrupt
