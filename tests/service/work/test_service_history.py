"""What the service remembers."""

from __future__ import annotations

import os
import sqlite3
import threading
from pathlib import Path

import pytest

from mavcompass.errors import MavCompassError
from mavcompass.service.work.history import History
from mavcompass.service.work.results import _keep_latest
from mavcompass.vehicle.parameters.undo import UndoRecord, load_record, save_record


def add(
    history: History,
    day: int = 1,
    ok: bool = True,
    device: int = 7,
    vehicle: str = "boat",
    undo_file: str = "/nowhere/undo.json",
) -> int:
    made_at, document = f"2026-05-{day:02d}T10:00:00+00:00", {"compasses": [{"instance": 1}]}
    compasses = [(1, device)]
    return history.add("calibration", made_at, vehicle, ok, "fine", document, compasses, undo_file=undo_file)


def test_what_was_added_is_there_after_a_restart(tmp_path: Path) -> None:
    history = History(tmp_path / "deep" / "history.db")
    number = add(history)
    history.attach_report(number, "/tmp/report.html")
    history.close()
    history = History(tmp_path / "deep" / "history.db")
    entry = history.entry(number)
    assert entry is not None
    assert entry.document == {"compasses": [{"instance": 1}]}
    assert entry.compasses == ((1, 7),)
    assert entry.head()["has_report"]
    assert entry.head()["undo_file"] == "/nowhere/undo.json"
    assert history.entry(99) is None
    history.close()


def test_lists_are_newest_first_and_can_be_narrowed_and_continued(tmp_path: Path) -> None:
    history = History(tmp_path / "history.db")
    numbers = [add(history, day, device=day % 2) for day in range(1, 8)]
    history.add("check", "2026-06-01T00:00:00+00:00", "boat", False, "no", {})
    assert [entry.id for entry in history.entries("calibration")] == numbers[::-1]
    assert [entry.id for entry in history.entries(device=1)] == numbers[::2][::-1]
    assert [entry.kind for entry in history.entries(limit=1)] == ["check"]
    assert [entry.id for entry in history.entries(before=numbers[2])] == numbers[:2][::-1]
    history.close()


def test_the_latest_calibration_in_force_is_found_by_vehicle_and_device(tmp_path: Path) -> None:
    history = History(tmp_path / "history.db")
    good = add(history, 1)
    add(history, 2, ok=False)
    add(history, 3, device=8)
    add(history, 4, vehicle="rover")
    latest = history.latest_calibration("boat", 7)
    assert latest is not None and latest.id == good
    assert history.latest_calibration("boat", 9) is None
    history.close()


def test_an_undo_takes_back_what_was_written_since_and_is_itself_taken_back(tmp_path: Path) -> None:
    history = History(tmp_path / "history.db")
    first, undone, other, last = add(history), add(history), add(history, vehicle="rover"), add(history)

    def undo() -> int:
        return history.add("undo", "now", "boat", True, "", {}, undo_file="/nowhere/again.json")

    def latest() -> int | None:
        entry = history.latest_calibration("boat", 7)
        return None if entry is None else entry.id

    by = undo()
    history.undone(undone, by)
    assert latest() == first, "what was in force before is in force again: nothing to be warned of"
    assert {e.id: e.undone_by for e in history.entries()} == {
        by: None,
        last: by,
        other: None,
        undone: by,
        first: None,
    }
    again = undo()
    history.undone(by, again)
    assert latest() == last and history.entry(by).head()["undone_by"] == again  # type: ignore[union-attr]
    history.close()


def test_a_database_of_a_newer_program_is_left_alone(tmp_path: Path) -> None:
    path = tmp_path / "history.db"
    database = sqlite3.connect(path)
    database.execute("PRAGMA user_version = 99")
    database.close()
    with pytest.raises(MavCompassError, match="newer mavcompass"):
        History(path)


def test_a_file_that_is_no_database_is_told(tmp_path: Path) -> None:
    (tmp_path / "history.db").write_bytes(b"certainly not a database" * 100)
    with pytest.raises(MavCompassError, match="cannot be used"):
        History(tmp_path / "history.db")


def test_several_threads_may_write(tmp_path: Path) -> None:
    history = History(tmp_path / "history.db")
    threads = [threading.Thread(target=lambda: [add(history) for _ in range(20)]) for _ in range(4)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert len({entry.id for entry in history.entries(limit=200)}) == 80
    history.close()


def test_a_full_disk_is_told_and_the_history_goes_on_afterwards(tmp_path: Path) -> None:
    history = History(tmp_path / "history.db")
    add(history)
    database = history._database
    pages = database.execute("PRAGMA page_count").fetchone()[0]
    database.execute(f"PRAGMA max_page_count = {pages}")
    large = {"much": "x" * 100_000}
    with pytest.raises(MavCompassError, match=r"The history could not be written \(.*full\)"):
        history.add("check", "2026-06-01T00:00:00+00:00", "boat", True, "fine", large)
    database.execute(f"PRAGMA max_page_count = {pages + 1000}")
    assert add(history) == 2
    assert [entry.id for entry in history.entries()] == [2, 1]
    history.close()


def test_the_oldest_entries_go_but_not_what_a_compass_was_last_calibrated_with(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("mavcompass.service.work.history.MOST_ENTRIES", 3)
    history = History(tmp_path / "history.db")
    old, last, failed = add(history), add(history), add(history, ok=False)
    others = [add(history, device=8, vehicle="rover") for _ in range(4)]
    assert [entry.id for entry in history.entries()] == [*reversed(others[1:]), last]
    latest = history.latest_calibration("boat", 7)
    assert latest is not None and latest.id == last
    assert history.entry(old) is None and history.entry(failed) is None
    history.close()


def test_an_undo_file_lives_as_long_as_an_entry_names_it(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("mavcompass.service.work.history.MOST_ENTRIES", 3)
    history = History(tmp_path / "history.db")
    folder = tmp_path / "undo"
    record = UndoRecord("2026-05-01T00:00:00+00:00", "ardupilot", "sim:rover", {"A": 1.0}, {"A": 2.0}, {})
    by_hand, twice, in_force, once, *newest = (save_record(record, folder) for _ in range(7))
    for undo_file in (twice, in_force, once, twice, *newest[:2]):
        add(history, ok=undo_file == in_force, undo_file=str(undo_file))
    named = {Path(name) for name in history.undo_files()}
    assert named == {twice, in_force, *newest[:2]}
    assert set(folder.glob("*.json")) == {by_hand, newest[2], *named}
    assert all(load_record(path) == record for path in named)
    add(history, ok=False, undo_file=str(newest[2]))
    assert not list(folder.glob(f"{twice.stem}.*"))
    history.close()


def test_the_latest_recordings_are_kept_though_the_clock_was_set_back(tmp_path: Path) -> None:
    for number in range(1, 12):
        path = tmp_path / f"calibration-{number}.tlog"
        path.write_bytes(b"")
        os.utime(path, (2e9 - number, 2e9 - number))
    (tmp_path / "calibration-of-a-person.tlog").write_bytes(b"")
    _keep_latest(tmp_path, 2)
    kept = {path.name for path in tmp_path.iterdir()}
    assert kept == {"calibration-10.tlog", "calibration-11.tlog", "calibration-of-a-person.tlog"}
