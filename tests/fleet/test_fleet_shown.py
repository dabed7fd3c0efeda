"""What a person sees while a fleet is worked on, and of what it found."""

from __future__ import annotations

from pathlib import Path

import pytest

from mavcompass.cli import fleet as shown
from mavcompass.cli.terminal import lines
from mavcompass.fleet.run import Progress
from mavcompass.fleet.summary import History, Point, Summary, Vehicle, _reasons
from mavcompass.printable import figure
from mavcompass.report.fleet import drift_figure, write_fleet_report


def test_a_pipe_gets_no_bar(capsys: pytest.CaptureFixture[str]) -> None:
    with shown.showing() as show:
        show(Progress(3, 1, 1))
    assert capsys.readouterr().err == ""


@pytest.mark.parametrize(
    ("progress", "words", "not_said"),
    [
        (Progress(9, 4, 0), ["4/9"], "error"),
        (Progress(9, 9, 2), ["9/9", "2 errors"], "takes"),
        (
            Progress(9, 5, 1, (("/far/away/v7/long.BIN", 20.0),)),
            ["1 error", "v7/long.BIN takes 20 s"],
            "away",
        ),
        (Progress(9, 5, 0, (("a/b.BIN", 19.0),)), ["5/9"], "b.BIN"),  # less than twenty seconds
    ],
)
def test_a_terminal_gets_counts_errors_and_what_takes_long(
    progress: Progress,
    words: list[str],
    not_said: str,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    monkeypatch.setattr(lines, "is_live", lambda: True)
    monkeypatch.setenv("FORCE_COLOR", "1")
    monkeypatch.setenv("COLUMNS", "200")
    with shown.showing() as show:
        show(progress)
    said = capsys.readouterr().err
    assert all(word in said for word in words) and not_said not in said, said


@pytest.mark.parametrize(
    ("span_s", "words"),
    [
        (600.0, "compass 1: recordings of the same hour differ by 32.3°"),
        (10_800.0, "compass 1: its calibration moved by 32.3° in 3 hours"),
        (40.0 * 86_400.0, "compass 1: its calibration moved by 32.3° in 40 days"),
    ],
)
def test_a_drift_is_told_over_a_time_that_a_person_knows(span_s: float, words: str, tmp_path: Path) -> None:
    points = (Point(0.0, "a.tlog", 0.0, 0.0, 0.1), Point(span_s, "a.BIN", 0.0, 32.3, 0.1))
    history = History(1, None, points)
    assert [reason for _, reason in _reasons(history, diagnosed=False)] == [words]
    one = Vehicle("one", "rover", 2, 0, 0, (), (history,), 32.3, (words,))
    summary = Summary("calibrate", 2, (), (one,), ())
    write_fleet_report(summary, {}, tmp_path / "fleet.html")
    page = (tmp_path / "fleet.html").read_text("utf-8")
    assert ("Over time" in page) is (span_s > 3600.0), "a flight's two recordings are no history"
    assert ("the median of 1 compasses" in page) is (span_s > 86_400.0) and ">-0" not in page


def test_what_rounds_to_nothing_has_no_sign() -> None:
    assert [figure(v, "%+.2f") for v in (-0.001, 0.001, -0.01)] == ["+0.00", "+0.00", "-0.01"]


@pytest.mark.parametrize(
    ("span_s", "axis"),
    [
        (3_600.0, "hours since 2026-05-01 06:30 UTC"),
        (7_200.0, "hours since 2026-05-01 06:30 UTC"),
        (172_799.0, "hours since 2026-05-01 06:30 UTC"),
        (172_800.0, "days since 2026-05-01"),
    ],
)
def test_recordings_of_one_day_are_drawn_apart(span_s: float, axis: str) -> None:
    began = 1_777_617_000.0  # 2026-05-01 06:30 UTC
    points = (Point(began, "a.BIN", 1.0), Point(began + span_s, "b.BIN", 2.0))
    seven = Vehicle("seven", "rover", 2, 0, 0, (), (History(1, None, points),), 2.0, ())
    assert axis in drift_figure(seven, calibrated=False)
