"""How requests end in history, words and files, also where the disk takes nothing."""

from __future__ import annotations

import math
from collections.abc import Iterator
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from mavcompass.calibration.result import CalibrationResult
from mavcompass.correction import IDENTITY
from mavcompass.errors import MavCompassError, UsageError, WriteFailed
from mavcompass.messages import Heartbeat, Incoming
from mavcompass.procedure.dialect import WriteOutcome
from mavcompass.procedure.report import AutopilotHeading
from mavcompass.procedure.script import Show
from mavcompass.procedure.vehicle_state import VehicleIdentity
from mavcompass.service.config import ServiceConfig, StorageConfig
from mavcompass.service.view import VehicleView
from mavcompass.service.work.history import Entry, History
from mavcompass.service.work.results import (
    Recorder,
    Results,
    _summary,
    old_and_new,
    recording_path,
    sigma_deg,
)
from mavcompass.service.work.tasks import CheckRequest, Task, UndoRequest


class NoWorker:
    """A helper process that does nothing, or cannot."""

    error: Exception | None = None

    def call(self, *_: object) -> None:
        if self.error is not None:
            raise self.error


@pytest.fixture
def history(tmp_path: Path) -> Iterator[History]:
    history = History(tmp_path / "history.db")
    yield history
    history.close()


@pytest.fixture
def worker() -> NoWorker:
    return NoWorker()


@pytest.fixture
def results(tmp_path: Path, history: History, worker: NoWorker) -> Results:
    return Results(ServiceConfig(storage=StorageConfig(str(tmp_path))), history, worker)  # type: ignore[arg-type]


def found(accepted: bool = True, sigma: float = 0.42, **more: Any) -> CalibrationResult:
    reasons = () if accepted else ("It hardly turned.",)
    return CalibrationResult(
        1, "four-positions", accepted, reasons, IDENTITY, heading_sigma_deg=sigma, **more
    )


def report(
    *results: CalibrationResult, written: bool = True, undone: bool = False, off_deg: float = 0.0
) -> Any:
    heading = (
        AutopilotHeading(20.0, off_deg, "it follows the compass", 5.0, abs(off_deg)) if off_deg else None
    )
    steers_off = heading is not None and heading.is_off
    return SimpleNamespace(
        results=results, written=written, undone=undone, heading=heading, steers_off=steers_off
    )


@pytest.mark.parametrize(
    ("told", "words"),
    [
        (report(found()), "compass 1 within 0.4 deg; written"),
        (report(found(), off_deg=0.5), "compass 1 within 0.4 deg; written"),  # its own heading is right
        (report(found(sigma=math.nan)), "compass 1 accepted; written"),
        (report(found(accepted=False), written=False), "compass 1 not accepted; not written"),
        (report(found(), written=False, undone=True), "compass 1 within 0.4 deg; put back"),
        (
            report(found(), found(sigma=1.0), off_deg=-9.0),
            "compass 1 within 0.4 deg, compass 1 within 1.0 deg; written. The autopilot's own heading is"
            " still 9.0 deg off. Reboot it before driving",
        ),
    ],
)
def test_a_calibration_in_a_line(told: Any, words: str) -> None:
    assert _summary(told) == words


def test_a_failure_is_told_and_leaves_its_undo_file_in_the_history(
    results: Results, history: History
) -> None:
    task = Task(1, CheckRequest(), "http", "2026-05-01T00:00:00+00:00")
    for line in range(30):
        task.show(Show("check", f"line {line}"))
    failed = WriteFailed("Half of it was written.", "Restore it.")
    failed.undo_file = Path("/somewhere/undo.json")
    results.failed(task, None, failed)
    assert (task.state, task.error, task.remedy) == ("failed", "Half of it was written.", "Restore it.")
    (entry,) = history.entries()
    assert (entry.id, entry.vehicle, entry.ok) == (task.entry, "unknown", False)
    assert entry.undo_file == "/somewhere/undo.json"
    assert [line["text"] for line in entry.document["lines"]] == [f"line {k}" for k in range(10, 30)]


def test_what_the_disk_does_not_take_is_told_and_the_rest_goes_on(
    results: Results, history: History, worker: NoWorker, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def full(*_: object, **__: object) -> int:
        raise MavCompassError("The history could not be written (full).", "Make room on the service's disk.")

    monkeypatch.setattr(history, "add", full)
    task = Task(1, CheckRequest(), "http", "now")
    results.failed(task, None, ZeroDivisionError("by zero"))
    assert task.error == "ZeroDivisionError: by zero" and task.entry is None
    assert "Make room" in task.lines[-1]["text"]
    (tmp_path / "recordings").write_text("a file where the folder should be")
    results._save_recording(Recorder(), 7)
    assert not recording_path(tmp_path, 7).exists()
    worker.error = MavCompassError("The report could not be made.", "See the log.")
    results._save_report(report(found()), 7)
    (tmp_path / "reports" / "calibration-7.html").unlink(missing_ok=True)
    assert list((tmp_path / "reports").iterdir()) == []


def test_a_recording_is_frames_each_behind_its_time(tmp_path: Path) -> None:
    recorder, path = Recorder(), tmp_path / "recordings" / "calibration-1.tlog"
    for time_s in (5.0, 6.0, 8.0):
        recorder.add(Incoming(time_s, 1, 1, Heartbeat()))
    recorder.save(path)
    data, size = path.read_bytes(), path.stat().st_size // 3
    stamps = [int.from_bytes(data[k * size :][:8], "big") for k in range(3)]
    assert np.diff(stamps) == pytest.approx([1e6, 2e6], abs=1.0) and data[8::size] == b"\xfd" * 3


@pytest.mark.parametrize(
    ("outcome", "summary"),
    [(None, "0 parameters put back."),  # the vehicle held the values already and was sent nothing
     (WriteOutcome(True, Path("/undo/2.json"), {"A": 1.0, "B": 2.0}), "2 parameters put back."),
     (WriteOutcome(False, Path("/undo/2.json"), {"A": 1.0}), "1 parameter put back.")],
)  # fmt: skip
def test_an_undo_takes_its_entry_back_and_can_be_undone_itself(
    outcome: WriteOutcome | None, summary: str, results: Results, history: History
) -> None:
    view = VehicleView(VehicleIdentity(1, 1, "ardupilot", "rover"), "key", 2026.0)
    before = history.add("calibration", "then", "key", True, "", {}, undo_file="/undo/1.json")
    task = Task(1, UndoRequest("1.json", before), "http", "now")
    results.undone(task, view, SimpleNamespace(outcome=outcome))  # type: ignore[arg-type]
    entry, taken_back = history.entries()
    told = outcome or WriteOutcome(True, None, {})
    assert (taken_back.id, taken_back.undone_by, task.entry) == (before, entry.id, entry.id)
    assert (task.ok, entry.ok, entry.vehicle, entry.summary) == (told.verified, told.verified, "key", summary)
    assert entry.undo_file == (outcome and str(outcome.undo_file)) and task.document == entry.document == {
        "schema": "mavcompass.undone/1", "verified": told.verified, "put_back": "1.json",
        "undo_file": entry.undo_file, "values": told.values,
    }  # fmt: skip


@pytest.mark.parametrize("name", ["other.json", "../history.db", "/etc/passwd", ".."])
def test_only_undo_files_of_the_folder_are_undone(name: str, results: Results, tmp_path: Path) -> None:
    (tmp_path / "undo").mkdir()
    (tmp_path / "undo" / "20260501-000-ardupilot.json").write_text("{}")
    with pytest.raises(UsageError, match="There is no undo file"):
        results.undo_path(UndoRequest(name, 1))
    kept = results.undo_path(UndoRequest("20260501-000-ardupilot.json", 1))
    assert kept == (tmp_path / "undo" / "20260501-000-ardupilot.json").resolve()


@pytest.mark.parametrize(
    ("compasses", "sigma"),
    [([{"instance": 2, "heading_sigma_deg": 0.5}], 0.5),
     ([{"instance": 2, "heading_sigma_deg": None}], None),
     ([{"instance": 1, "heading_sigma_deg": 0.5}], None), ([], None)],
)  # fmt: skip
def test_the_sigma_that_the_history_claims(compasses: list[dict[str, Any]], sigma: float | None) -> None:
    entry = Entry(1, "now", "calibration", "key", True, "", (), {"compasses": compasses}, None, None)
    assert sigma_deg(entry, 2) == sigma


def test_old_and_new_stand_side_by_side_with_a_card_where_the_field_is_known() -> None:
    plain = old_and_new(found())
    assert plain["old"] == plain["new"] and plain["old"]["diagonals"] == [1.0, 1.0, 1.0]
    assert plain["deviation"] == []
    known = old_and_new(found(horizontal_mgauss=200.0, vertical_mgauss=400.0))
    assert [row["heading_deg"] for row in known["deviation"]] == [15.0 * k for k in range(24)]
    assert {row["old_error_deg"] for row in known["deviation"]} == {0.0}
    assert (known["horizontal_mgauss"], known["before_deg"]) == (200.0, None)
    assert np.shape(known["old_circle"]) == (36, 2)  # every ten degrees, forward and right
    assert np.hypot(*np.transpose(known["old_circle"])) == pytest.approx(np.full(36, 200.0), abs=0.1)
