"""What a person sees while a fleet is worked on, and of what it found."""

from __future__ import annotations

import pytest

from mavcompass.cli.fleet import shown
from mavcompass.fleet.run import Progress
from mavcompass.fleet.summary import History, Point, Vehicle
from mavcompass.report.fleet import drift_figure


def test_a_pipe_gets_no_bar(capsys: pytest.CaptureFixture[str]) -> None:
    with shown.showing() as show:
        show(Progress(3, 1, 1))
    assert capsys.readouterr().err == ""


@pytest.mark.parametrize(
    ("progress", "words"),
    [
        (Progress(9, 4, 0), ["4/9"]),
        (Progress(9, 9, 2), ["9/9", "2 errors"]),
        (
            Progress(9, 5, 1, (("/far/away/vehicle7/long.BIN", 20.0),)),
            ["1 error", "vehicle7/long.BIN takes 20 s"],
        ),
    ],
)
def test_a_terminal_gets_counts_errors_and_what_takes_long(
    progress: Progress, words: list[str], monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(shown, "is_live", lambda: True)
    monkeypatch.setenv("FORCE_COLOR", "1")
    monkeypatch.setenv("COLUMNS", "200")
    with shown.showing() as show:
        show(progress)
    said = capsys.readouterr().err
    assert all(word in said for word in words), said


def test_what_takes_less_than_twenty_seconds_is_not_named(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(shown, "is_live", lambda: True)
    monkeypatch.setenv("FORCE_COLOR", "1")
    with shown.showing() as show:
        show(Progress(9, 5, 0, (("a/b.BIN", 19.0),)))
    assert "b.BIN" not in capsys.readouterr().err


@pytest.mark.parametrize(
    ("span_s", "axis"),
    [
        (600.0, "minutes since 2026-05-01 06:30 UTC"),
        (7_199.0, "minutes since 2026-05-01 06:30 UTC"),
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
