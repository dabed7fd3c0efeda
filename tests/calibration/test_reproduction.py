"""One command regenerates the papers' figures and states their numbers beside ours."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from pathlib import Path

import pytest

PROJECT = Path(__file__).resolve().parents[2]


def test_the_papers_results_come_out(tmp_path: Path) -> None:
    pytest.importorskip("matplotlib")
    script = PROJECT / "scripts" / "reproduction" / "papers.py"
    done = subprocess.run(
        [sys.executable, "-W", "error", str(script), "--out", str(tmp_path)],
        capture_output=True,
        text=True,
        env={**os.environ, "MPLBACKEND": "Agg"},
        timeout=120,
    )
    assert done.returncode == 0, done.stderr
    results = json.loads((tmp_path / "reproduce.json").read_text())
    figures, tables = results["figures"], results["tables"]
    four = figures["four-positions-fig2-simulated"]["ours"]
    assert four["four positions, average, deg"] <= four["min-max, deg"]
    for name in ("two-axis-fig4", "two-axis-fig5"):
        ours = figures[name]["ours"]
        assert 20.0 < ours["largest error without compensation, deg"] < 25.0
        assert ours["largest error with compensation, deg"] < 1.0
        assert (tmp_path / f"{name}.png").stat().st_size > 10_000
    assert round(tables["two-axis-z-error-bound"]["ours"]["bound, deg"], 1) == 0.8
    assert tables["bicycle"]["ours"] == tables["bicycle"]["paper"]
