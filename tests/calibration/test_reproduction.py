"""One command regenerates the papers' figures and states their numbers beside ours."""

from __future__ import annotations

import json
import runpy
from pathlib import Path

import pytest

PROJECT = Path(__file__).resolve().parents[2]


def test_the_papers_results_come_out(tmp_path: Path) -> None:
    pytest.importorskip("matplotlib")
    script = runpy.run_path(str(PROJECT / "scripts" / "reproduction" / "papers.py"))
    assert script["main"](["--out", str(tmp_path)]) == 0
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
