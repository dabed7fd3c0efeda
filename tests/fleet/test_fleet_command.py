"""What a person types and sees."""

from __future__ import annotations

import json
import re
import signal
import subprocess
import sys
import time
from collections.abc import Callable
from pathlib import Path

import pytest

from mavcompass.cli.main import main
from mavcompass.fleet.columns import columns_of
from mavcompass.fleet.examine import Work
from mavcompass.fleet.recordings import as_local_file, find_recordings
from mavcompass.fleet.run import journal_of

pq = pytest.importorskip("pyarrow.parquet", reason="pip install 'mavcompass[fleet]'")


def test_the_drifting_boat_is_the_one_to_look_at_first(
    twelve: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    out = tmp_path / "fleet.parquet"
    asked = ["fleet", "calibrate", str(twelve), "--out", str(out), "--workers", "2"]
    assert main([*asked, "--json", "-", "--vehicle-pattern", r"(boat-\d)"]) == 0
    said = json.loads(capsys.readouterr().out)
    assert (said["schema"], said["asked"], said["errors"]) == ("mavcompass.fleet/1", 12, [])
    first = said["vehicles"][0]
    assert first["name"] == said["look_first"][0] == "boat-2"
    assert any("moved by" in reason for reason in first["why"])
    history = first["compasses"][0]["history"]
    drifts = [point["drift_deg"] for point in history]
    # An offset of d mG across a horizontal field H bends the heading by d / (H sqrt 2), rms.
    expected = [57.3 * 8.0 * day / (210.3 * 2**0.5) for day in range(4)]
    assert drifts == pytest.approx(expected, abs=0.4)
    assert first["compasses"][0]["rate_deg_per_30_days"] == pytest.approx(30 * expected[1], rel=0.1)
    iron = next(effect for effect in said["effects"] if effect["effect"] == "hard_iron")
    assert (iron["recordings"], iron["vehicles"]) == (12, 3)
    page = out.with_suffix(".html").read_text(encoding="utf-8")
    assert page.index("boat-2") < page.index("boat-1") and "moved by" in page and "<svg" in page
    assert "http://" not in page and "https://" not in page

    assert main([*asked, "--vehicle-pattern", r"(boat-\d)"]) == 0
    assert "0 of 12 recordings examined, 12 were done before" in capsys.readouterr().out


def test_diagnose_names_effects_and_their_size(
    twelve: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    out = tmp_path / "gaps.parquet"
    first, last = (str(twelve / "boat-2" / f"day{day}.csv") for day in (0, 3))
    asked = ["fleet", "diagnose", first, last, "--out", str(out), "--workers", "2"]
    assert main([*asked, "--presets", "2"]) == 0
    rows = pq.read_table(out).to_pylist()
    assert len(rows) == 2 and {row["status"] for row in rows} == {"ok"}
    worst = rows[-1]
    assert worst["recording"].endswith("day3.csv")
    assert "hard_iron" in worst["effects"].split(",")
    assert worst["effect_hard_iron_mgauss"] > 10.0
    assert json.loads(worst["causes_json"])[0]["parameters"]
    learnt = json.loads((tmp_path / "gaps.distribution.json").read_text(encoding="utf-8"))
    assert (learnt["schema"], learnt["vehicles"]) == ("mavcompass.fleet-distribution/1", 1)
    assert learnt["recordings"] == 2 and learnt["odd"] == []
    assert len(list(tmp_path.glob("gaps.distribution.*.preset.json"))) == 2
    said = capsys.readouterr().out
    assert "Look at boat-2 (" in said and "last: " in said and "simulation's heading is" in said
    assert "heading off" not in said + out.with_suffix(".html").read_text(encoding="utf-8")


def test_a_fleet_of_which_nothing_can_be_used_is_four(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    (tmp_path / "noise.tlog").write_bytes(bytes(range(256)) * 8)
    (tmp_path / "empty.BIN").touch()
    assert main(["fleet", "calibrate", str(tmp_path), "--out", str(tmp_path / "out.parquet")]) == 4
    assert "2 of 2 recordings examined; 2 errors." in capsys.readouterr().out
    rows = pq.read_table(tmp_path / "out.parquet").to_pylist()
    assert {row["error_kind"] for row in rows} == {"BadRecording"}
    assert all(row["error"] for row in rows)


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        (["missing/"], "There is no recording missing/"),
        (["."], "no recordings in ."),
        (["*.tlog"], "no recordings in *.tlog"),
        (["nowhere://bucket/x"], "cannot be opened"),
        ([__file__, "--vehicle-pattern", "("], "no regular expression"),
        ([__file__, "--vehicle-pattern", "boat"], "no group"),
        ([__file__, "--workers", "2", "--scheduler", "tcp://127.0.0.1:1"], "exclude each other"),
    ],
)
def test_wrong_usage_is_two_and_says_what_to_do(
    arguments: list[str],
    said: str,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    monkeypatch.chdir(tmp_path)
    assert main(["fleet", "calibrate", *arguments, "--out", "out.parquet"]) == 2
    assert said in " ".join(capsys.readouterr().err.split())


def test_folders_patterns_files_and_stores_find_the_same(twelve: Path) -> None:
    names = [recording.path for recording in find_recordings([str(twelve)])]
    assert len(names) == 12
    assert [r.path for r in find_recordings([f"{twelve}/**/*.csv", f"{twelve}/boat-1"])] == names
    assert [r.path for r in find_recordings([f"{twelve}/**"])] == names
    pytest.importorskip("fsspec")
    for url in (f"file://{twelve}", f"file://{twelve}/**/*.csv"):
        stored = find_recordings([url])
        assert [r.path.removeprefix("file://") for r in stored] == names
    with as_local_file(stored[0].path) as copy:
        assert copy.read_bytes() == Path(names[0]).read_bytes() and copy.name == "day0.csv"
    assert not copy.exists()


def test_control_c_stops_at_once_and_the_same_command_goes_on(
    twelve: Path, tmp_path: Path, start_process: Callable[..., subprocess.Popen[str]]
) -> None:
    out = tmp_path / "out.parquet"
    command = [sys.executable, "-m", "mavcompass", "fleet", "calibrate", str(twelve), "--out", str(out)]
    running = start_process(*command, "--workers", "1")
    journal = journal_of(out)
    while running.poll() is None:
        if journal.exists() and journal.read_bytes().count(b"\n") >= 4:
            break
        time.sleep(0.005)
    running.send_signal(signal.SIGINT)
    said, complained = running.communicate()
    assert running.returncode == 7, complained
    assert "the same command goes on from there" in said
    done = subprocess.run(command, capture_output=True, text=True, timeout=300)
    assert done.returncode == 0, done.stderr
    counted = re.search(r"(\d+) of 12 recordings examined, (\d+) were done before", done.stdout)
    assert counted is not None
    examined, before = map(int, counted.groups())
    assert examined + before == 12 and 3 <= before < 12


@pytest.mark.parametrize("work", ["calibrate", "diagnose"])
def test_the_document_explains_every_column(work: Work) -> None:
    page = (Path(__file__).parents[2] / "docs" / "fleet.md").read_text(encoding="utf-8")
    for column in columns_of(work):
        if not column.name.startswith("effect_"):
            assert re.search(rf"\| `{column.name}` \| .* \| {re.escape(column.about)} \|", page), column.name
