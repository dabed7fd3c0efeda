"""The service was killed while it wrote: at the next start its history offers the way back."""

from __future__ import annotations

import os
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

from mavcompass.procedure.nameplate import Nameplate
from mavcompass.service.work.history import History
from mavcompass.service.work.jobs import note_interrupted_write
from mavcompass.vehicle.parameters.undo import UndoRecord, save_record

OLD = {"COMPASS_OFS_X": 5.0, "COMPASS_OFS_Y": 13.0}
NEW = {"COMPASS_OFS_X": 60.0, "COMPASS_OFS_Y": -40.0}


@pytest.fixture
def history(tmp_path: Path) -> Iterator[History]:
    history = History(tmp_path / "history.db")
    yield history
    history.close()


ROVER = Nameplate("ardupilot", 1, "0a")


def note(history: History, tmp_path: Path, held: dict[str, float], vehicle: Nameplate = ROVER) -> None:
    note_interrupted_write(history, vehicle, held, tmp_path / "undo")


def undo_file(tmp_path: Path) -> Path:
    record = UndoRecord("2026-05-01T00:00:00+00:00", "ardupilot", "sim:rover", OLD, NEW, OLD, ROVER)
    return save_record(record, tmp_path / "undo")


@pytest.mark.parametrize("held", [{**OLD, "COMPASS_OFS_X": 60.0}, NEW])
def test_new_values_on_the_vehicle_are_offered_once(
    tmp_path: Path, history: History, held: dict[str, float]
) -> None:
    path = undo_file(tmp_path)
    for _ in range(2):
        note(history, tmp_path, held)
    (entry,) = history.entries()
    assert entry.undo_file == str(path) and not entry.ok
    assert "cut short" in entry.summary
    assert f"params restore sim:rover {path}" in entry.document["remedy"]


def test_what_was_set_aside_for_the_calibration_alone_and_is_left_so_is_offered(
    tmp_path: Path, history: History
) -> None:
    was, now = {"ARMING_CHECK": 1.0}, {"ARMING_CHECK": 2097146.0}
    record = UndoRecord("2026-05-01T00:00:00+00:00", "ardupilot", "sim:rover", was, now, {}, ROVER, True)
    path = save_record(record, tmp_path / "undo")
    for _ in range(2):
        note(history, tmp_path, OLD)
    (entry,) = history.entries()
    assert entry.undo_file == str(path) and "ARMING_CHECK may not be as before" in entry.summary


@pytest.mark.parametrize(
    "seen",
    [
        (OLD,),  # killed before the first value, or put back
        ({"COMPASS_OFS_X": 7.0, "COMPASS_OFS_Y": 13.0},),  # somebody else's
        ({"COMPASS_OFS_X": 60.0, "COMPASS_OFS_Y": 7.0},),  # written long ago, and one of them again since
        (NEW, Nameplate("px4", 1, "0a")),
        (NEW, Nameplate("ardupilot", 1, "0b")),
        ({},),
    ],
)
def test_anything_else_is_left_alone(tmp_path: Path, history: History, seen: Any) -> None:
    note(history, tmp_path, *seen)  # there is none yet
    path = undo_file(tmp_path)
    note(history, tmp_path, *seen)
    assert history.entries() == []
    path.write_text("{")
    note(history, tmp_path, NEW)
    assert history.entries() == []


def test_a_write_in_the_history_is_known(tmp_path: Path, history: History) -> None:
    path = undo_file(tmp_path)
    history.add("calibration", "2026-05-01", "rover-7", True, "fine", {}, undo_file=str(path))
    note(history, tmp_path, NEW)
    assert len(history.entries()) == 1


def test_a_clock_that_was_set_back_hides_no_write_that_was_cut_short(
    tmp_path: Path, history: History
) -> None:
    earlier = undo_file(tmp_path)
    history.add("calibration", "2026-05-01", "rover-7", True, "fine", {}, undo_file=str(earlier))
    cut_short = undo_file(tmp_path)
    os.utime(cut_short, (0.0, 0.0))
    note(history, tmp_path, NEW)
    assert [entry.undo_file for entry in history.entries()] == [str(cut_short), str(earlier)]
