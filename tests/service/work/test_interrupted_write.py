"""The service was killed while it wrote: at the next start its history offers the way back."""

from __future__ import annotations

import os
from collections.abc import Iterator
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest

from mavcompass.procedure.vehicle_state import VehicleIdentity
from mavcompass.service.work.history import History
from mavcompass.service.work.interrupted import note_interrupted_write
from mavcompass.vehicle.parameters.undo import UndoRecord, save_record

OLD = {"COMPASS_OFS_X": 5.0, "COMPASS_OFS_Y": 13.0}
NEW = {"COMPASS_OFS_X": 60.0, "COMPASS_OFS_Y": -40.0}


@pytest.fixture
def history(tmp_path: Path) -> Iterator[History]:
    history = History(tmp_path / "history.db")
    yield history
    history.close()


def view(parameters: dict[str, float], autopilot: str = "ardupilot") -> Any:
    identity = VehicleIdentity(1, 1, autopilot, "rover")
    return SimpleNamespace(identity=identity, key="rover-7", parameters=parameters)


def undo_file(tmp_path: Path) -> Path:
    record = UndoRecord("2026-05-01T00:00:00+00:00", "ardupilot", "sim:rover", OLD, NEW, OLD)
    return save_record(record, tmp_path / "undo")


@pytest.mark.parametrize("held", [{**OLD, "COMPASS_OFS_X": 60.0}, NEW])
def test_new_values_on_the_vehicle_are_offered_once(
    tmp_path: Path, history: History, held: dict[str, float]
) -> None:
    path = undo_file(tmp_path)
    for _ in range(2):
        note_interrupted_write(history, view(held), tmp_path / "undo")
    (entry,) = history.entries()
    assert entry.undo_file == str(path) and not entry.ok
    assert "cut short" in entry.summary
    assert f"params restore sim:rover {path}" in entry.document["remedy"]


@pytest.mark.parametrize(
    "seen",
    [
        view(OLD),  # killed before the first value, or put back
        view({"COMPASS_OFS_X": 7.0, "COMPASS_OFS_Y": 13.0}),  # somebody else's
        view({"COMPASS_OFS_X": 60.0, "COMPASS_OFS_Y": 7.0}),  # written long ago, and one of them again since
        view(NEW, autopilot="px4"),
        view({}),
    ],
)
def test_anything_else_is_left_alone(tmp_path: Path, history: History, seen: Any) -> None:
    note_interrupted_write(history, seen, tmp_path / "undo")  # there is none yet
    path = undo_file(tmp_path)
    note_interrupted_write(history, seen, tmp_path / "undo")
    assert history.entries() == []
    path.write_text("{")
    note_interrupted_write(history, view(NEW), tmp_path / "undo")
    assert history.entries() == []


def test_a_write_in_the_history_is_known(tmp_path: Path, history: History) -> None:
    path = undo_file(tmp_path)
    history.add("calibration", "2026-05-01", "rover-7", True, "fine", {}, undo_file=str(path))
    note_interrupted_write(history, view(NEW), tmp_path / "undo")
    assert len(history.entries()) == 1


def test_a_clock_that_was_set_back_hides_no_write_that_was_cut_short(
    tmp_path: Path, history: History
) -> None:
    earlier = undo_file(tmp_path)
    history.add("calibration", "2026-05-01", "rover-7", True, "fine", {}, undo_file=str(earlier))
    cut_short = undo_file(tmp_path)
    os.utime(cut_short, (0.0, 0.0))
    note_interrupted_write(history, view(NEW), tmp_path / "undo")
    assert [entry.undo_file for entry in history.entries()] == [str(cut_short), str(earlier)]
