"""A part that is not installed is named before anything is read, moved or written; so is a missing file."""

from __future__ import annotations

import sys
from pathlib import Path

import pytest

from mavcompass.cli.main import main
from mavcompass.errors import MavCompassError, UsageError
from mavcompass.installation.parts import PARTS, params_path, require

PROJECT = Path(__file__).resolve().parents[2]

ULG = "flight.ulg"


@pytest.fixture
def begun(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> list[str]:
    """Stand in an empty folder with one recording; list what was opened or read all the same."""
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("MAVCOMPASS_UNDO_DIR", str(tmp_path / "undo"))
    Path(ULG).write_bytes(b"ULog")
    begun: list[str] = []

    def note(name: str) -> object:
        return lambda *_, **__: begun.append(name)

    for name in (
        "mavcompass.vehicle.opening.open_link",
        "mavcompass.vehicle.open_link",
        "mavcompass.vehicle.transport.open_transport",
        "mavcompass.logs.read_track",
        "mavcompass.logs.read_track",
        "mavcompass.gap.trial.run_trial",
        "mavcompass.fleet.run.run_fleet",
    ):
        monkeypatch.setattr(name, note(name))
    return begun


@pytest.mark.parametrize(
    ("hidden", "extra", "line"),
    [
        ("jinja2", "report", "calibrate sim:boat --yes --report r.html"),
        ("jinja2", "report", f"calibrate {ULG} --report r.html"),
        ("jinja2", "report", "check sim:rover --offer"),
        ("jinja2", "report", f"gap diagnose {ULG} --report r.html"),
        ("jinja2", "report", "gap blind-trial --cases 40 --report r.html"),
        ("jinja2", "report", f"fleet calibrate {ULG} --out fleet.parquet"),
        ("jinja2", "report", "serve sim:rover"),
        ("serial", "serial", "calibrate /dev/ttyACM0 --yes"),
        ("serial", "serial", "check /dev/ttyACM0"),
        ("serial", "serial", "heading /dev/ttyACM0:57600"),
        ("serial", "serial", "params write /dev/ttyACM0 new.param --yes"),
        ("serial", "serial", "params restore /dev/ttyACM0 --yes"),
        ("serial", "serial", "simulate --listen /dev/ttyACM0"),
        ("serial", "serial", f"replay {ULG} --listen /dev/ttyACM0"),
        ("serial", "serial", "serve /dev/ttyACM0"),
        ("uvicorn", "service", "serve sim:rover"),
        ("prometheus_client", "service", "serve sim:rover"),
        ("pyarrow", "fleet", f"fleet calibrate {ULG} --out fleet.parquet"),
        ("distributed", "fleet", f"fleet diagnose {ULG} --out f.parquet --scheduler tcp://127.0.0.1:1"),
        ("fsspec", "fleet", "fleet diagnose s3://flights/ --out fleet.parquet"),
    ],
)
def test_a_missing_part_is_named_before_anything_begins(
    hidden: str,
    extra: str,
    line: str,
    begun: list[str],
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    monkeypatch.setitem(sys.modules, hidden, None)
    assert main(line.split()) == 2
    said = capsys.readouterr()
    assert said.out == ""
    assert hidden in said.err and f"pip install 'mavcompass[{extra}]'" in said.err
    assert begun == []
    assert [path.name for path in Path().iterdir()] == [ULG]


def test_all_that_is_missing_is_told_at_once(monkeypatch: pytest.MonkeyPatch) -> None:
    for module in ("uvicorn", "jinja2"):
        monkeypatch.setitem(sys.modules, module, None)
    with pytest.raises(UsageError, match=r"jinja2.*uvicorn.*'mavcompass\[report,service\]'"):
        require("An HTML report", "The service")


def test_every_part_can_be_had_here() -> None:
    require(*PARTS)


@pytest.mark.parametrize(
    "line",
    [
        "calibrate sim:boat --yes --report missing/r.html",
        "gap blind-trial --report missing/r.html",
        f"fleet calibrate {ULG} --out missing/fleet.parquet",
    ],
)
def test_a_report_without_a_folder_is_told_before_anything_begins(
    line: str, begun: list[str], capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(line.split()) == 2
    assert "does not exist" in capsys.readouterr().err
    assert begun == []


# --- the files of params/ -------------------------------------------------------------------------------


def test_a_checkout_reads_its_own_params() -> None:
    assert params_path("README.md") == PROJECT / "params" / "README.md"
    assert params_path() == PROJECT / "params"


def test_a_missing_file_says_what_to_do() -> None:
    with pytest.raises(MavCompassError, match=r"no-such-file\.toml is missing .* Install mavcompass again"):
        params_path("no-such-file.toml")
