"""A few of the inputs of `scripts/campaigns/hostile_recordings.py`, and each kind of file that is none."""

from __future__ import annotations

import json
import subprocess
import sys
from collections.abc import Callable
from contextlib import suppress
from dataclasses import replace
from pathlib import Path
from types import ModuleType

import numpy as np
import pytest

import mavcompass
from mavcompass.errors import BadRecording, PoorCalibration, UsageError
from mavcompass.fleet.examine import Job, examine
from mavcompass.gap import diagnose_gap
from mavcompass.gap.rehearsal import read_stored
from mavcompass.logs import read_track
from mavcompass.service.config import load_config
from mavcompass.track import Track
from mavcompass.vehicle.parameters.files import read_parameter_file
from mavcompass.vehicle.parameters.undo import load_record
from mavcompass.vehicle.replay import replayed_autopilot
from mavcompass.vehicle.wire.signing import Signing

CAMPAIGN = Path(__file__).parents[2] / "scripts" / "campaigns" / "hostile_recordings.py"


@pytest.fixture(scope="module")
def files(campaigns: Callable[[str], ModuleType]) -> ModuleType:
    return campaigns("hostile_files")


def test_a_draw_of_hostile_recordings_stays_within_the_budgets(tmp_path: Path) -> None:
    words = [sys.executable, str(CAMPAIGN), "--share", "0.02", "--json", str(tmp_path / "told")]
    words += [word for name in ("heading", "calibrate") for word in ("--command", name)]
    done = subprocess.run(words, capture_output=True, text=True)
    told = json.loads((tmp_path / "told").read_text())
    assert done.returncode == 0, done.stdout
    assert told["inputs"] >= 8 and told["runs"] == 2 * told["inputs"]
    assert 0 in [one["code"] for one in told["each"]], "some of them can be read"


def test_there_are_many_kinds(files: ModuleType) -> None:
    names = [(one.name, one.suffix) for one in files.inputs()]
    assert len(names) == len(set(names)) >= 300


@pytest.mark.parametrize("suffix", [".tlog", ".bin", ".csv"])
@pytest.mark.parametrize("kind", ["a pipe", "zeros without end", "a socket", "a folder", "a link to nowhere"])
def test_what_has_no_end_is_refused_by_every_door(
    tmp_path: Path, files: ModuleType, kind: str, suffix: str
) -> None:
    path = tmp_path / f"a{suffix}"
    files.SPECIAL[kind](path)
    for door in (read_track, replayed_autopilot):
        with pytest.raises(UsageError) as caught:
            door(path)
        assert caught.value.remedy


@pytest.mark.parametrize("suffix", [".tlog", ".bin", ".log", ".ulg", ".csv"])
def test_a_recording_whose_times_are_all_one_is_refused(
    tmp_path: Path, files: ModuleType, suffix: str
) -> None:
    times = files.BOOT_S + 0.0 * files.Flight().time_s
    path = tmp_path / f"a{suffix}"
    path.write_bytes(files.WRITERS[suffix](files.Flight(time_s=times)))
    with pytest.raises(BadRecording, match="one and the same"):
        read_track(path)


@pytest.mark.parametrize("suffix", [".tlog", ".bin"])
@pytest.mark.parametrize("value", [1e38, 1e6])
def test_offsets_that_no_compass_can_have_count_as_unknown(
    tmp_path: Path, files: ModuleType, suffix: str, value: float
) -> None:
    flight = files.Flight(parameters={f"COMPASS_OFS_{axis}": value for axis in "XYZ"})
    path = tmp_path / f"a{suffix}"
    path.write_bytes(files.WRITERS[suffix](flight))
    track = read_track(path)
    assert not track.compasses[1].correction_known
    assert any("no compass can have them" in note for note in track.notes)
    assert (track.raw_field(1) == track.compasses[1].reported.values).all()


@pytest.mark.parametrize(
    ("kind", "said"),
    [
        ("a million columns", "columns"),
        ("a header of 60 MB", "columns"),
        ("a line of 60 MB", "has a line of more than"),
        ("an open quote in the header", "has no column time_s"),
    ],
)
def test_columns_and_lines_without_end_are_refused(
    tmp_path: Path, files: ModuleType, kind: str, said: str
) -> None:
    path = tmp_path / "a.csv"
    path.write_bytes(dict(files._of_csv(files.WRITERS[".csv"](files.Flight())))[kind]())
    with pytest.raises(BadRecording, match=said):
        read_track(path)


def test_a_text_without_end_is_refused() -> None:
    for read in (read_parameter_file, load_record, load_config, read_stored, Signing.of_file):
        with pytest.raises(UsageError):
            read(Path("/dev/zero"))


@pytest.mark.parametrize("suffix", [".tlog", ".bin", ".log", ".ulg", ".csv"])
@pytest.mark.parametrize("force", [0.0, -300.0, -32768.0, 1e30])
def test_what_shows_no_gravity_is_refused_by_every_door_that_needs_a_level(
    tmp_path: Path, files: ModuleType, suffix: str, force: float
) -> None:
    flight = files.Flight()
    path = tmp_path / f"a{suffix}"
    path.write_bytes(files.WRITERS[suffix](replace(flight, acc=np.full_like(flight.acc, force))))
    track = read_track(path)
    doors: tuple[Callable[[Track], object], ...] = (mavcompass.calibrate, mavcompass.heading, diagnose_gap)
    for door in doors:
        with pytest.raises((BadRecording, PoorCalibration), match="nothing tells what is level") as caught:
            door(track)
        assert caught.value.remedy
    rows = [examine(Job(work), str(path)) for work in ("calibrate", "diagnose")]
    assert ["nothing tells what is level" in row[0]["error"] for row in rows] == [True, True]


@pytest.mark.parametrize("suffix", [".tlog", ".bin", ".log", ".ulg", ".csv"])
@pytest.mark.parametrize("quantity", ["mag", "acc", "gyro"])
@pytest.mark.parametrize("odd", [1e30, -np.inf, np.nan])
def test_what_no_sensor_can_say_is_left_out_and_told(
    tmp_path: Path, files: ModuleType, suffix: str, quantity: str, odd: float
) -> None:
    """Formats of whole numbers cannot say more than their end; what is no number is absent without a word."""
    values = getattr(files.Flight(), quantity).copy()
    values[100:105] = odd
    path = tmp_path / f"a{suffix}"
    path.write_bytes(files.WRITERS[suffix](files.Flight(**{quantity: values})))
    track = read_track(path)
    fewer = [name for name, series in track.columns() if len(series) == files.COUNT - 5]
    assert [{"compass 1": "mag"}.get(name, name.partition("_")[0]) for name in fewer] == [quantity]
    told = any(note.startswith(f"Left out 5 of {files.COUNT} readings of ") for note in track.notes)
    assert told or np.isnan(odd)


@pytest.mark.parametrize("suffix", [".tlog", ".bin", ".log", ".ulg", ".csv"])
@pytest.mark.parametrize("value", [0.0, 1.0, -32768.0])
def test_a_compass_that_says_one_thing_is_diagnosed_or_refused(
    tmp_path: Path, files: ModuleType, suffix: str, value: float
) -> None:
    path = tmp_path / f"a{suffix}"
    path.write_bytes(files.WRITERS[suffix](files.Flight(mag=np.full((files.COUNT, 3), value))))
    with suppress(BadRecording):
        assert [cause.effect for cause in diagnose_gap(read_track(path)).causes] == ["stale_samples"]
