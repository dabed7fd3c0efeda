"""Measure the inner parts one by one: solvers, diagnosis, undoing corrections.

scripts/bench inner [-- -k four_positions]
"""

from __future__ import annotations

import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

PROJECT = Path(__file__).resolve().parents[2]
METHODS = ("four-positions", "min-max", "world-field")  # those that a level turn suffices for


@pytest.fixture(scope="module")
def track(tmp_path_factory: pytest.TempPathFactory) -> Any:
    """Read a vehicle's four turns, 32 s at 100 Hz."""
    sys.path.insert(0, str(PROJECT / "tests" / "fleet"))
    from fleet_samples import write_recording

    from mavcompass.logs import read_track

    path = tmp_path_factory.mktemp("inner") / "turns.csv"
    return read_track(write_recording(path, (40.0, -20.0, 10.0), rate_hz=100.0))


@pytest.mark.parametrize("method", METHODS)
def test_calibrate(benchmark: Callable[..., Any], track: Any, method: str) -> None:
    from mavcompass import api

    assert benchmark(api.calibrate, track, method).method == method


def test_diagnose_gap(benchmark: Callable[..., Any], track: Any) -> None:
    from mavcompass import api

    assert "hard_iron" in benchmark(api.diagnose_gap, track).effects


def test_undo_corrections(benchmark: Callable[..., Any], track: Any) -> None:
    assert benchmark(track.raw_field, 1).shape[1] == 3
