"""`mavcompass check --offer`: the calibration where it is the remedy, and only if the person wants it."""

from __future__ import annotations

import sys
from pathlib import Path

import click
import pytest

from mavcompass.cli.main import main
from mavcompass.cli.terminal import show
from mavcompass.report import calibration


class Keyboard:
    """A person's terminal."""

    def isatty(self) -> bool:
        return True


@pytest.fixture(autouse=True)
def person(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("MAVCOMPASS_UNDO_DIR", str(tmp_path / "undo"))
    monkeypatch.setattr(sys, "stdin", Keyboard())


@pytest.mark.parametrize(("wanted", "code"), [(True, 0), (False, 5)])
def test_the_calibration_is_run_where_it_is_wanted(
    wanted: bool,
    code: int,
    monkeypatch: pytest.MonkeyPatch,
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
) -> None:
    asked: list[str] = []

    def confirm(question: str, **_: object) -> bool:
        asked.append(question)
        return wanted

    monkeypatch.setattr(click, "confirm", confirm)
    monkeypatch.setattr(calibration, "write_report", lambda report, path: path.write_text("<!doctype html>"))
    monkeypatch.setattr(show, "ask_on_terminal", lambda question: lambda: True)
    assert main(["check", "sim:rover,seed=3", "--turn", "none", "--offer"]) == code
    assert asked[0] == "Calibrate now? The vehicle will turn."
    reports = [path.name for path in tmp_path.glob("*.html")]
    assert reports == (["compass-rover-1.html"] if wanted else [])
    said = capsys.readouterr().out
    assert ("Written. Report: compass-rover-1.html" in said) is wanted


def test_nothing_is_offered_where_nothing_is_to_be_calibrated(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(click, "confirm", lambda *_, **__: pytest.fail("asked"))
    words = ["--effect", "hard_iron:x=0", "--turn", "none", "--offer"]
    assert main(["check", "sim:rover,seed=3", *words]) == 0
