"""`mavcompass doctor`: what it sees on a computer, and that each trouble comes with its remedy."""

from __future__ import annotations

import json
import os
import socket
import sys
from pathlib import Path

import pytest

from mavcompass.cli import doctor as computer
from mavcompass.cli.main import main


def test_every_finding_that_is_no_pass_has_a_remedy(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["doctor", "--json", "-"]) in (0, 5)
    document = json.loads(capsys.readouterr().out)
    assert document["schema"] == "mavcompass.doctor/1"
    names = {finding["name"] for finding in document["findings"]}
    assert names == {"python", "parts", "serial", "udp", "clock", "undo", "disk"}
    assert all(f["remedy"] for f in document["findings"] if f["verdict"] != "pass")


def test_what_must_be_mended_gives_five(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setenv("MAVCOMPASS_UNDO_DIR", os.devnull)
    assert main(["doctor"]) == 5
    assert "FAIL  Undo files cannot be written to /dev/null" in capsys.readouterr().out


def test_a_missing_part_comes_with_the_command_that_installs_it(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "serial", None)
    (finding,) = computer.parts()
    assert finding.verdict == "warn" and "serial" in finding.text
    assert finding.remedy.endswith("pip install 'mavcompass[serial]'")


def test_parts_of_one_extra_are_one_finding(monkeypatch: pytest.MonkeyPatch) -> None:
    for module in ("pyarrow", "distributed", "jinja2"):
        monkeypatch.setitem(sys.modules, module, None)
    report, fleet = computer.parts()
    assert "jinja2" in report.text and report.remedy.endswith("pip install 'mavcompass[report]'")
    assert "pyarrow, distributed" in fleet.text and fleet.remedy.endswith("pip install 'mavcompass[fleet]'")


def test_who_listens_on_the_port_is_named() -> None:
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as other:
        other.bind(("127.0.0.1", 0))
        port = other.getsockname()[1]
        finding = computer.udp_port(port)
        assert finding.verdict == "warn" and f"(process {os.getpid()}) listens there" in finding.text
        assert f"udpin:127.0.0.1:{port + 1}" in finding.remedy
        assert "another program" in computer.udp_port(port, Path("/nowhere")).text
    assert computer.udp_port(port).verdict == "pass"


def test_a_serial_port_that_somebody_has_open_is_told(tmp_path: Path) -> None:
    (tmp_path / "ttyACM0").touch()
    assert [f.verdict for f in computer.serial_ports(tmp_path)] == ["pass"]
    with (tmp_path / "ttyACM0").open():
        (finding,) = computer.serial_ports(tmp_path)
    assert finding.verdict == "warn" and f"(process {os.getpid()}) has it open" in finding.text


def test_a_serial_port_without_permission_names_its_group(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    port = tmp_path / "ttyUSB0"
    port.touch()
    monkeypatch.setattr(os, "access", lambda path, mode: False)  # root may open everything
    (finding,) = computer.serial_ports(tmp_path)
    assert finding.verdict == "warn"
    assert finding.remedy.startswith(f"sudo usermod -aG {port.group()} $USER")


def test_the_clock_of_a_board_without_battery_is_a_failure() -> None:
    assert computer.clock(0.0).verdict == "fail" and "1970" in computer.clock(0.0).text
    assert computer.clock(1_790_000_000.0).verdict == "pass"
    assert computer.clock(1_900_000_000.0).verdict == "warn"


def test_a_folder_that_is_not_there_yet_is_one_that_can_be_made(tmp_path: Path) -> None:
    assert computer.writing(tmp_path / "deep" / "undo").verdict == "pass"
    assert not (tmp_path / "deep").exists()
    assert computer.space(tmp_path / "deep" / "undo").name == "disk"
