"""Recordings that people reported, through every command that reads them."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from mavcompass.cli.main import main
from mavcompass.fleet.examine import Job, examine

Run = Callable[..., tuple[int, str, Any]]


@pytest.fixture
def case(shared_data: Path) -> Callable[[str], str]:
    def find(name: str) -> str:
        file = shared_data.parent / "cases" / name
        if not file.exists():
            pytest.skip(f"{file} is not there")
        return str(file)

    return find


@pytest.fixture
def run(capsys: pytest.CaptureFixture[str], tmp_path: Path) -> Run:
    """Run a command; return its exit code, what it said, and its document."""

    def run(*words: str) -> tuple[int, str, Any]:
        document = tmp_path / "out.json"
        document.unlink(missing_ok=True)
        code = main([*words, "--json", str(document)])
        said = "".join(capsys.readouterr())
        return code, said, json.loads(document.read_text()) if document.exists() else None

    return run


def test_a_slow_stream_is_waited_for(case: Callable[[str], str], run: Run) -> None:
    _, said, document = run("check", case("plane385_three_compasses.tlog"))
    judged = {item["compass"] for item in document["items"] if item["name"] == "field"}
    assert judged == {1, 2, 3} and "cable" not in said


def test_nobody_turns_the_vehicle_of_a_recording(shared_data: Path, run: Run) -> None:
    """It drives on while it is checked: that was "the vehicle moved 5.0 m away", and no answer at all."""
    code, said, document = run("check", str(shared_data / "gap-firmware" / "r_hard" / "flight.tlog"))
    assert code == 0 and "No turn was made" in said and not document["turned"]
    assert "Compass 2 was not judged: no readings came (SCALED_IMU2)." in said and "cable" not in said
    assert any(item["name"] == "field" and item["compass"] == 1 for item in document["items"])


@pytest.mark.parametrize("suffix", [".tlog", ".BIN"])
def test_every_recording_can_be_checked(shared_data: Path, run: Run, suffix: str) -> None:
    """The .tlog has no parameters of compasses; the autopilot's own log beside it has."""
    code, said, document = run("check", str(shared_data / "ardupilot-4.6.3" / f"rover_dist{suffix}"))
    assert code == 5 and document["verdict"] == "fail" and "Not fit to drive: calibrate compass 1" in said


@pytest.mark.parametrize(
    ("recording", "says"),
    [
        ("px4-1.16/copter_four_positions.ulg", "Compass 1: its heading was 27.9 deg off in this recording"),
        ("gap-firmware/r_orient/flight.tlog", "COMPASS_ORIENT 2 is right"),
    ],
)
def test_a_check_goes_by_all_that_was_recorded(
    shared_data: Path, run: Run, recording: str, says: str
) -> None:
    """At rest both are near enough: what they were when it turned is in the same file."""
    code, said, document = run("check", str(shared_data / recording))
    assert code == 5 and document["verdict"] == "fail" and says in said


def test_parameters_without_a_magnetometer(case: Callable[[str], str], run: Run, tmp_path: Path) -> None:
    file = case("px4_params_only.tlog")
    code, said, document = run("params", "show", file)
    assert code == 0 and "CAL_MAG1_ZSCALE" in said and document["compasses"]
    kept = tmp_path / "kept.params"
    assert run("params", "backup", file, str(kept))[0] == 0 and kept.exists()
    assert run("params", "diff", file, str(kept))[2]["differing"] == []
    for command in (["heading"], ["calibrate"], ["gap", "diagnose"]):
        code, said, _ = run(*command, file)
        assert code == 4 and "holds no magnetometer" in said and "SR0_" not in said


def test_a_compass_that_reports_is_there_whatever_its_id(case: Callable[[str], str], run: Run) -> None:
    file = case("copter36_devid0.tlog")
    _, said, document = run("check", file)
    assert {item["compass"] for item in document["items"] if item["name"] == "offsets"} == {1, 2}
    assert "no compass" not in said and "COMPASS_DEV_ID is 0" in said
    code, said, document = run("params", "show", file)
    assert code == 0 and document["compasses"] == [1, 2] and "COMPASS_DEV_ID is 0" in said
    code, _, document = run("heading", file, "--compass", "2", "--rate", "1")
    assert code == 0 and document["headings"] and "COMPASS_DEV_ID2 is 0" in document["notes"][0]


def test_a_priority_that_names_another_sensor_is_told_everywhere(
    case: Callable[[str], str], run: Run
) -> None:
    file, note = case("prio.tlog"), "COMPASS_PRIO1_ID names another sensor than the one in use, compass 2's"
    for words in (
        ["check"],
        ["calibrate", "--compass", "all"],
        ["params", "show"],
        ["heading", "--rate", "1"],
    ):
        _, said, document = run(*words, file)
        assert note in said and note in json.dumps(document), words
    (row,) = examine(Job("calibrate"), file)
    assert note in row["warnings"]
