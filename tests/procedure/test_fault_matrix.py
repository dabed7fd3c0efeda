"""A drawn sample of `scripts/campaigns/fault_matrix.py`, and that it would notice."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from types import ModuleType
from typing import Any

import pytest

SAMPLED = {"write": 8, "restore": 5, "calibrate": 3}


@pytest.fixture(scope="module")
def matrix(campaigns: Callable[[str], ModuleType]) -> ModuleType:
    return campaigns("fault_matrix")


@pytest.fixture(scope="module")
def traces(matrix: ModuleType) -> dict[Any, Any]:
    works = [w for w in matrix.WORKS if w.name in SAMPLED and w.kind == "rover"]
    return {work: matrix.trace(work) for work in works}


def test_a_drawn_sample_leaves_no_torn_set_and_no_motion(matrix: ModuleType, traces: dict[Any, Any]) -> None:
    wrong = []
    for work, traced in traces.items():
        for cell in matrix.draw({work: traced}, matrix.FAULTS, SAMPLED[work.name], 16):
            wrong += [(str(cell), sentence) for sentence in matrix.run_cell(cell, traced).wrong]
    assert wrong == []


def test_steps_of_every_kind_are_traced(traces: dict[Any, Any]) -> None:
    for work, traced in traces.items():
        kinds = {step.kind for step in traced.steps}
        assert kinds == {"send", "hear", "file", "state"}, work.name
        files = [step.what for step in traced.steps if step.kind == "file"]
        assert {"fsync", "reserve .part", "write .json.part", "rename .json"} <= set(files), work.name


def test_the_judgement_notices_a_write_without_a_way_back(
    matrix: ModuleType, traces: dict[Any, Any], monkeypatch: pytest.MonkeyPatch
) -> None:
    work, traced = next((w, t) for w, t in traces.items() if w.name == "write")
    last = max(k for k, step in enumerate(traced.steps, 1) if step.what == "ParamSet")
    (killed,) = (fault for fault in matrix.FAULTS if fault.name == "killed")
    cell = matrix.Cell(work, last, traced.steps[last - 1], killed, 0)
    assert matrix.run_cell(cell, traced).wrong == []
    saver = lambda *_: lambda plan, values, vehicle: Path("nowhere.json")  # noqa: E731
    monkeypatch.setattr("fault_cells.works.undo_saver", saver)
    (sentence,) = matrix.run_cell(cell, traced).wrong
    assert sentence.startswith("changed ") and sentence.endswith(" without an undo file")


def test_a_table_tells_cells_and_failures(matrix: ModuleType, capsys: pytest.CaptureFixture[str]) -> None:
    options = ["--cells", "2", "--work", "write", "--fault", "lost", "--seed", "4"]
    assert matrix.main(options) == 0
    assert "0 of 2 (0.0 .. 65.8 %) cells failed" in capsys.readouterr().out


def test_a_program_that_the_system_killed_has_told_the_way_back(matrix: ModuleType) -> None:
    assert matrix.killed_process(4) == []
