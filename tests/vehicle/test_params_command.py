"""`mavcompass params` as a person and a script use it, on the simulated vehicle in memory."""

from __future__ import annotations

import io
import json
import os
import shlex
import shutil
import sys
import threading
from pathlib import Path

import pytest

from mavcompass import vehicle as vehicle_room
from mavcompass.cli.main import main
from mavcompass.simulation.vehicle import SimulatedAutopilot
from mavcompass.vehicle.link import ONBOARD_COMPUTER
from mavcompass.vehicle.links.simulated import SimulatedLink
from mavcompass.vehicle.parameters.files import read_parameter_file

SOURCE = "tcp:127.0.0.1:5760"


class Hangar:
    """Keep one simulated vehicle, to which every command connects anew."""

    def __init__(self) -> None:
        self.storage: dict[str, float] = {}
        self.autopilot = SimulatedAutopilot("rover", seed=1, storage=self.storage, armed=False)
        self.asked_for: list[str] = []

    def open_link(self, source: str) -> SimulatedLink:
        self.asked_for.append(source)
        return SimulatedLink(self.autopilot, source, ONBOARD_COMPUTER)


@pytest.fixture
def hangar(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> Hangar:
    hangar = Hangar()
    monkeypatch.setattr(vehicle_room, "open_link", hangar.open_link)
    monkeypatch.setenv("MAVCOMPASS_UNDO_DIR", str(tmp_path / "undo"))
    monkeypatch.setattr(sys, "stdin", io.StringIO(""))
    return hangar


@pytest.fixture
def compass_file(tmp_path: Path) -> Path:
    path = tmp_path / "compass.param"
    path.write_text("# found yesterday\nCOMPASS_OFS_X,120\nCOMPASS_OFS_Y,-80\nRC1_MIN,1100\n")
    return path


class Terminal(io.StringIO):
    """Be a person's keyboard."""

    def isatty(self) -> bool:
        return True


def held(capsys: pytest.CaptureFixture[str]) -> dict[str, float]:
    capsys.readouterr()
    assert main(["params", "show", SOURCE, "--json", "-"]) == 0
    return json.loads(capsys.readouterr().out)["parameters"]


def run_json(capsys: pytest.CaptureFixture[str], *arguments: object) -> tuple[int, dict[str, object]]:
    capsys.readouterr()
    code = main([*map(str, arguments), "--json", "-"])
    return code, json.loads(capsys.readouterr().out)


def test_show_in_a_pipe_is_a_file_that_mavproxy_loads(
    hangar: Hangar, capsys: pytest.CaptureFixture[str], tmp_path: Path
) -> None:
    assert main(["params", "show", SOURCE]) == 0
    path = tmp_path / "shown.parm"
    path.write_text(capsys.readouterr().out)
    assert read_parameter_file(path) == held(capsys)


def test_show_on_a_terminal_is_a_table_with_a_column_per_compass(
    hangar: Hangar, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("mavcompass.cli.params._is_table_wanted", lambda output: True)
    assert main(["params", "show", SOURCE]) == 0
    table = capsys.readouterr().out
    assert "compass 1" in table and "compass 3" in table
    (row,) = [line for line in table.splitlines() if line.split()[:1] == ["EXTERNAL"]]
    assert len(row.split()) == 4


def test_write_restore_round_trip(
    hangar: Hangar, capsys: pytest.CaptureFixture[str], compass_file: Path
) -> None:
    before = held(capsys)
    code, written = run_json(capsys, "params", "write", SOURCE, compass_file, "--yes")
    assert code == 0 and written["written"] and written["verified"]
    assert [change["name"] for change in written["changes"]] == ["COMPASS_OFS_X", "COMPASS_OFS_Y"]
    assert held(capsys) == before | {"COMPASS_OFS_X": 120.0, "COMPASS_OFS_Y": -80.0}
    assert Path(str(written["undo_file"])).exists()
    code, restored = run_json(capsys, "params", "restore", SOURCE, "--yes")  # the last undo file by itself
    assert code == 0 and restored["verified"]
    assert held(capsys) == before


def test_what_was_kept_of_another_vehicle_is_refused_with_both_identities(
    hangar: Hangar, capsys: pytest.CaptureFixture[str], compass_file: Path
) -> None:
    first = f"{hangar.autopilot.board.uid:016x}"
    assert main(["params", "write", SOURCE, str(compass_file), "--yes"]) == 0
    (undo_file,) = compass_file.parent.glob("undo/*.json")
    folder = compass_file.parent
    assert main(["params", "backup", SOURCE, str(folder / "backup.params")]) == 0
    elsewhere = Path(shutil.copy(undo_file.with_suffix(".param"), folder / "copied.param"))
    hangar.autopilot = SimulatedAutopilot("rover", seed=2, system=2, armed=False)
    second = f"{hangar.autopilot.board.uid:016x}"
    before = held(capsys)
    assert main(["params", "restore", SOURCE, "--yes"]) == 2
    assert "no undo file of this vehicle (system 2, ardupilot 4.6.3, board" in capsys.readouterr().err
    written = undo_file.with_suffix(".new.param")
    for file in (undo_file, written, elsewhere, folder / "backup.params"):
        verb = "restore" if file is undo_file else "write"
        assert main(["params", verb, SOURCE, str(file), "--yes"]) == 7
        told = capsys.readouterr().err
        assert "of another vehicle: system 1, ardupilot 4.6.3" in told and first in told and second in told
        assert "--other-vehicle" in told
    assert held(capsys) == before
    assert main(["params", "restore", SOURCE, str(undo_file), "--other-vehicle", "--yes"]) == 0


def test_an_undo_file_of_an_earlier_version_says_what_is_not_known_and_is_restored_all_the_same(
    hangar: Hangar, capsys: pytest.CaptureFixture[str], compass_file: Path
) -> None:
    before = held(capsys)
    assert main(["params", "write", SOURCE, str(compass_file), "--yes"]) == 0
    (undo_file,) = compass_file.parent.glob("undo/*.json")
    document = json.loads(undo_file.read_text())
    del document["vehicle"]
    old = undo_file.with_name("20260501030201-000-ardupilot.json")
    old.write_text(json.dumps(document))
    undo_file.unlink()
    assert main(["params", "restore", SOURCE, "--yes"]) == 2
    assert f"did not note whose it was, is {old}. Where it is this vehicle's" in capsys.readouterr().err
    assert main(["params", "restore", SOURCE, str(old), "--yes"]) == 7
    assert f"{old} does not say which vehicle it is of" in capsys.readouterr().err
    assert main(["params", "restore", SOURCE, str(old), "--other-vehicle", "--yes"]) == 0
    assert held(capsys) == before


def test_the_command_that_is_printed_restores(
    hangar: Hangar, capsys: pytest.CaptureFixture[str], compass_file: Path
) -> None:
    before = held(capsys)
    assert main(["params", "write", SOURCE, str(compass_file), "--yes"]) == 0
    (line,) = [line for line in capsys.readouterr().out.splitlines() if line.startswith("To undo: ")]
    words = shlex.split(line.removeprefix("To undo: "))
    assert words[0] == "mavcompass"
    assert main([*words[1:], "--yes"]) == 0
    assert held(capsys) == before


def test_a_dry_run_shows_and_writes_nothing(
    hangar: Hangar, capsys: pytest.CaptureFixture[str], compass_file: Path, tmp_path: Path
) -> None:
    before = held(capsys)
    assert main(["params", "write", SOURCE, str(compass_file), "--dry-run"]) == 0
    said = capsys.readouterr().out
    assert "COMPASS_OFS_X" in said and "-> 120" in said and "Nothing written" in said
    assert held(capsys) == before and not (tmp_path / "undo").exists()


def test_in_a_pipe_nobody_can_be_asked(
    hangar: Hangar, capsys: pytest.CaptureFixture[str], compass_file: Path
) -> None:
    assert main(["params", "write", SOURCE, str(compass_file)]) == 2
    assert "--yes" in capsys.readouterr().err
    assert not hangar.asked_for


@pytest.mark.parametrize(("typed", "code", "offset"), [("y\n", 0, 120.0), ("n\n", 7, None), ("\n", 7, None)])
def test_on_a_terminal_the_person_is_asked(
    hangar: Hangar,
    capsys: pytest.CaptureFixture[str],
    monkeypatch: pytest.MonkeyPatch,
    compass_file: Path,
    typed: str,
    code: int,
    offset: float | None,
) -> None:
    before = held(capsys)
    monkeypatch.setattr(sys, "stdin", Terminal(typed))
    assert main(["params", "write", SOURCE, str(compass_file)]) == code
    assert "Write 2 parameters?" in capsys.readouterr().err
    assert held(capsys)["COMPASS_OFS_X"] == (before["COMPASS_OFS_X"] if offset is None else offset)


def test_what_is_there_already_is_not_written(
    hangar: Hangar, capsys: pytest.CaptureFixture[str], tmp_path: Path
) -> None:
    file = tmp_path / "same.parm"
    assert main(["params", "backup", SOURCE, str(file)]) == 0
    assert main(["params", "diff", SOURCE, str(file)]) == 0
    assert "holds the values" in capsys.readouterr().out
    code, report = run_json(capsys, "params", "write", SOURCE, file, "--yes")
    assert code == 0 and not report["written"] and report["changes"] == []
    assert not (tmp_path / "undo").exists()


def test_values_come_through_a_pipe_too(hangar: Hangar, tmp_path: Path) -> None:
    """It can be read once."""
    os.mkfifo(pipe := tmp_path / "pipe")
    writer = threading.Thread(target=pipe.write_text, args=("COMPASS_OFS_X,120\n",))
    writer.start()
    assert main(["params", "write", SOURCE, str(pipe), "--yes"]) == 0
    writer.join()
    assert hangar.autopilot.firmware.store["COMPASS_OFS_X"] == 120.0


@pytest.mark.parametrize("damage", ["{", '{"system": 1}', '{"system": []}'])
def test_a_file_whose_line_of_the_vehicle_is_damaged_is_not_written_unasked(
    hangar: Hangar, tmp_path: Path, damage: str, capsys: pytest.CaptureFixture[str]
) -> None:
    (file := tmp_path / "mine.param").write_text(f"# vehicle {damage}\nCOMPASS_OFS_X,120\n")
    assert main(["params", "write", SOURCE, str(file), "--yes"]) == 7
    assert "its line of the vehicle is damaged" in capsys.readouterr().err
    assert main(["params", "write", SOURCE, str(file), "--yes", "--other-vehicle"]) == 0


@pytest.mark.parametrize("suffix", ["param", "parm", "params"])
def test_a_backup_holds_all_and_is_not_replaced_unasked(
    hangar: Hangar, capsys: pytest.CaptureFixture[str], tmp_path: Path, suffix: str
) -> None:
    file = tmp_path / f"before.{suffix}"
    assert main(["params", "backup", SOURCE, str(file)]) == 0
    assert read_parameter_file(file) == held(capsys)
    assert main(["params", "backup", SOURCE, str(file)]) == 2
    assert "exists" in capsys.readouterr().err
    assert main(["params", "backup", SOURCE, str(file), "--yes"]) == 0


def test_free_angles_are_shown_saved_and_restored_with_the_orientation_that_names_them(
    hangar: Hangar, capsys: pytest.CaptureFixture[str], tmp_path: Path
) -> None:
    store, file = hangar.autopilot.firmware.store, tmp_path / "mounted.param"
    mounted = {"COMPASS_ORIENT": 101.0, "CUST_ROT_ENABLE": 1.0, "CUST_ROT1_PITCH": 12.5}
    for name, value in mounted.items():
        store.set(name, value)
    assert main(["params", "backup", SOURCE, str(file)]) == 0
    for name in mounted:
        store.set(name, 0.0)
    assert main(["params", "restore", SOURCE, str(file), "--yes"]) == 0
    assert {name: held(capsys)[name] for name in mounted} == mounted


def test_a_backup_without_a_file_goes_to_standard_output(
    hangar: Hangar, capsys: pytest.CaptureFixture[str], tmp_path: Path
) -> None:
    assert main(["params", "backup", SOURCE]) == 0
    file = tmp_path / "piped.param"
    file.write_text(capsys.readouterr().out)
    assert read_parameter_file(file) == held(capsys)


def test_a_difference_is_shown_by_name(
    hangar: Hangar, capsys: pytest.CaptureFixture[str], compass_file: Path
) -> None:
    now = held(capsys)
    code, report = run_json(capsys, "params", "diff", SOURCE, compass_file)
    assert code == 0
    assert report["differing"] == [
        {"name": "COMPASS_OFS_X", "vehicle": now["COMPASS_OFS_X"], "file": 120.0},
        {"name": "COMPASS_OFS_Y", "vehicle": now["COMPASS_OFS_Y"], "file": -80.0},
    ]


def test_what_is_out_of_range_is_refused_but_can_be_put_back(
    hangar: Hangar, capsys: pytest.CaptureFixture[str], tmp_path: Path
) -> None:
    file = tmp_path / "far.param"
    file.write_text("COMPASS_OFS_X,5000\n")
    before = held(capsys)
    code, report = run_json(capsys, "params", "write", SOURCE, file, "--yes")
    assert code == 7 and not report["written"] and "takes 1800" in str(report["error"])
    assert held(capsys) == before
    code, report = run_json(capsys, "params", "restore", SOURCE, file, "--yes")
    assert code == 0 and any("takes 1800" in str(remark) for remark in report["remarks"])
    assert held(capsys)["COMPASS_OFS_X"] == 5000.0


@pytest.mark.parametrize(
    ("text", "code", "said"),
    [
        ("COMPASS_DEV_ID,1234\nCOMPASS_OFS_X,1\n", 7, "another sensor"),
        ("RC1_MIN,1100\n", 2, "holds no compass parameter"),
        ("CAL_MAG0_XOFF,0.1\n", 2, "holds no compass parameter"),
        ("COMPASS_OFS_X,abc\n", 2, "line 1: 'abc' is not a number"),
        ("COMPASS_OFS9_X,1\n", 7, "no parameter COMPASS_OFS9_X"),
    ],
)
def test_an_unsuitable_file_is_told_and_not_written(
    hangar: Hangar, capsys: pytest.CaptureFixture[str], tmp_path: Path, text: str, code: int, said: str
) -> None:
    file = tmp_path / "wrong.param"
    file.write_text(text)
    before = held(capsys)
    assert main(["params", "write", SOURCE, str(file), "--yes"]) == code
    assert said in capsys.readouterr().err
    assert held(capsys) == before


def test_nothing_to_restore_is_told(
    hangar: Hangar, capsys: pytest.CaptureFixture[str], tmp_path: Path
) -> None:
    assert main(["params", "restore", SOURCE, "--yes"]) == 2
    assert str(tmp_path / "undo") in capsys.readouterr().err
    assert main(["params", "restore", SOURCE, str(tmp_path / "absent.json"), "--yes"]) == 2


def test_a_recording_is_read_but_not_written(
    hangar: Hangar, capsys: pytest.CaptureFixture[str], compass_file: Path, shared_data: Path
) -> None:
    log = str(shared_data / "ardupilot-4.6.3" / "rover_dist.BIN")
    code, shown = run_json(capsys, "params", "show", log)
    assert code == 0 and shown["parameters"]["COMPASS_OFS_Y"] == 13.0 and shown["compasses"] == [1, 2, 3]
    code, report = run_json(capsys, "params", "diff", log, compass_file)
    assert code == 0 and len(report["differing"]) == 2
    assert main(["params", "write", log, str(compass_file), "--yes"]) == 2
    assert "recording" in capsys.readouterr().err


def test_yes_and_dry_run_exclude_each_other(hangar: Hangar, compass_file: Path) -> None:
    assert main(["params", "write", SOURCE, str(compass_file), "--yes", "--dry-run"]) == 2


def test_a_px4_vehicle_is_shown_and_written(
    hangar: Hangar, capsys: pytest.CaptureFixture[str], tmp_path: Path
) -> None:
    hangar.autopilot = SimulatedAutopilot("px4-copter", seed=1, armed=False)
    before = held(capsys)
    file = tmp_path / "compass.params"
    assert main(["params", "backup", SOURCE, str(file)]) == 0
    assert "CAL_MAG0_ID\t" in file.read_text() and "\t6\n" in file.read_text()
    file.write_text("1\t1\tCAL_MAG0_XOFF\t0.25\t9\n")
    code, written = run_json(capsys, "params", "write", SOURCE, file, "--yes")
    assert code == 0 and written["verified"]
    assert held(capsys) == before | {"CAL_MAG0_XOFF": 0.25}
    assert main(["params", "restore", SOURCE, "--yes"]) == 0
    assert held(capsys) == before


def test_an_armed_vehicle_is_written_to_with_a_warning(
    hangar: Hangar, capsys: pytest.CaptureFixture[str], compass_file: Path
) -> None:
    hangar.autopilot = SimulatedAutopilot("rover", seed=1, armed=True)
    assert main(["params", "write", SOURCE, str(compass_file), "--yes"]) == 0
    assert "the vehicle is armed; its heading will change" in capsys.readouterr().out
    hangar.autopilot = SimulatedAutopilot("px4-copter", seed=1, armed=True)
    compass_file.write_text("CAL_MAG0_XOFF,0.25\n")
    assert main(["params", "write", SOURCE, str(compass_file), "--yes"]) == 0
    assert "store its own over it: write it again then" in capsys.readouterr().out


def test_what_a_px4_holds_but_does_not_go_by_is_loaded(
    hangar: Hangar, capsys: pytest.CaptureFixture[str], tmp_path: Path
) -> None:
    vehicle = hangar.autopilot = SimulatedAutopilot("px4-copter", seed=1, armed=True)
    compasses, before = vehicle.firmware.compasses, held(capsys)
    file = tmp_path / "compass.param"
    file.write_text(f"CAL_MAG0_XOFF,{before['CAL_MAG0_XOFF'] + 0.003}\n")  # too little to be loaded by itself
    write = ["params", "write", SOURCE, str(file)]
    assert main([*write, "--yes"]) == 0
    flown = compasses.correction(1)
    assert compasses.held(1) != flown
    vehicle.firmware.status.armed = False
    assert main([*write, "--dry-run"]) == 0
    assert "nothing was written" in capsys.readouterr().out and compasses.correction(1) == flown
    assert main([*write, "--yes"]) == 0
    assert "already held these values; it goes by them now" in capsys.readouterr().out
    assert compasses.correction(1) == compasses.held(1)
    # The last undo file is still the one that leads back to what was flown with.
    assert main(["params", "restore", SOURCE, "--yes"]) == 0
    assert held(capsys) == before and compasses.correction(1) == compasses.held(1)
