"""Measure the inner parts one by one with pytest-benchmark: solvers, diagnosis, undoing corrections.

    scripts/bench inner [-- -k four_positions]

The options are pytest's. The functions below are no tests: the suite never times anything.
"""

from __future__ import annotations

import json
import sys
import tempfile
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import pytest

PROJECT = Path(__file__).resolve().parents[2]
QUICK = ("--benchmark-max-time=0.2", "--benchmark-min-rounds=3")
METHODS = ("four-positions", "min-max", "world-field")  # those that a level turn suffices for


def main(argv: Sequence[str] | None = None) -> dict[str, Any]:
    """Run pytest-benchmark on this file; return the median of each part, seconds."""
    with tempfile.TemporaryDirectory() as folder:
        result = Path(folder) / "inner.json"
        code = pytest.main(
            [
                __file__,
                f"--rootdir={PROJECT}",
                "-q",
                "-p",
                "no:cacheprovider",
                "--benchmark-enable",
                "--benchmark-only",
                "--benchmark-columns=min,median,rounds",
                f"--benchmark-json={result}",
                *(argv or ()),
            ]
        )
        if code != 0:
            raise RuntimeError(f"pytest ended with {code!r}")
        found = json.loads(result.read_text())["benchmarks"]
    return {"median_s": {one["name"]: one["stats"]["median"] for one in found}}


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
