"""`mavcompass calibrate RECORDING`: what it says, which files it writes, and which it refuses to write."""

from __future__ import annotations

import json
import math
from dataclasses import replace
from pathlib import Path

import pytest
from calibration_worlds import Iron, turning_track

from mavcompass.cli import calibration
from mavcompass.cli.main import main
from mavcompass.correction import IDENTITY, FieldCorrection
from mavcompass.track import InForce, Track
from mavcompass.vehicle.parameters.files import read_parameter_file

IRON = Iron((-120.0, 80.0, 0.0))
NOT_KNOWN = InForce(-math.inf, IDENTITY)
IN_FORCE = FieldCorrection((20.0, 10.0, 0.0))


@pytest.fixture
def flight(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A recording of ArduPilot, turned in four positions, whose own notes tell nothing of its parameters."""
    track = turning_track(IRON, in_force=IN_FORCE, autopilot="ardupilot")
    unknown = replace(track.compasses[1], in_force=(NOT_KNOWN,), correction_known=False)
    return reading(replace(track, compasses={1: unknown}, notes=("It begins late.",)), tmp_path, monkeypatch)


def reading(track: Track, folder: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    path = folder / "flight.BIN"
    path.write_bytes(b"")
    monkeypatch.setattr(calibration.api, "read_track", lambda source: replace(track, source=str(source)))
    return path


def test_parameters_relative_to_unknown_ones_are_not_written(
    flight: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    wanted = tmp_path / "new.param"
    assert main(["calibrate", str(flight), "--params-out", str(wanted)]) != 0
    said = capsys.readouterr()
    assert "does not tell which parameters were in force for compass 1" in said.err
    assert "--in-force FILE" in said.err
    assert "Note: It begins late." in said.out
    assert not wanted.exists()


def test_with_the_parameters_of_that_day_the_new_ones_are_whole(
    flight: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    old, new, report = (tmp_path / name for name in ("old.param", "new.param", "report.html"))
    old.write_text("COMPASS_OFS_X 20\nCOMPASS_OFS_Y 10\nCOMPASS_OFS_Z 0\n")
    words = ["--in-force", str(old), "--params-out", str(new), "--report", str(report), "--json", "-"]
    assert main(["calibrate", str(flight), *words]) == 0
    document = json.loads(capsys.readouterr().out)
    assert document["compasses"][0]["accepted"] is True
    values = read_parameter_file(new)
    assert values["COMPASS_OFS_X"] == pytest.approx(120.0, abs=2.0)
    assert values["COMPASS_OFS_Y"] == pytest.approx(-80.0, abs=2.0)
    assert report.read_text().startswith("<!")


def test_one_that_is_not_accepted_writes_no_parameters(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    flight = reading(turning_track(IRON, noise=40.0), tmp_path, monkeypatch)
    new = tmp_path / "new.param"
    words = ["--params-out", str(new), "--max-error-deg", "0.1"]
    assert main(["calibrate", str(flight), *words]) == 5
    assert "not accepted" in capsys.readouterr().out.lower()
    assert not new.exists()


def test_one_that_cannot_be_solved_says_so_in_its_document_too(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    flight = reading(turning_track(IRON, turns_deg=()), tmp_path, monkeypatch)
    assert main(["calibrate", str(flight), "--json", "-"]) == 5
    said = capsys.readouterr()
    (compass,) = json.loads(said.out)["compasses"]
    assert compass["accepted"] is False
    assert compass["reasons"][0] in said.err


@pytest.mark.parametrize(("compasses", "has"), [((1, 2), "1, 2"), ((), "none")])
def test_a_compass_that_is_not_there_is_told_with_those_that_are(
    compasses: tuple[int, ...],
    has: str,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    track = turning_track(IRON)
    held = {instance: replace(track.compasses[1], instance=instance) for instance in compasses}
    flight = reading(replace(track, compasses=held), tmp_path, monkeypatch)
    assert main(["calibrate", str(flight), "--compass", "3"]) != 0
    said = capsys.readouterr().err
    assert f"has no compass 3; it has {has}." in said and "--compass" in said
