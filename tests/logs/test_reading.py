"""Which format a file has, and what is said of files that have none."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from pathlib import Path
from types import ModuleType

import numpy as np
import pytest
from dataflash_builder import MAG, Log
from pymavlink import mavutil
from recorded_frames import Recording
from ulog_builder import ULogFile

from mavcompass.errors import BadRecording, UsageError
from mavcompass.logs import formats, read_track, read_tracks
from mavcompass.logs.reading import known_formats


def test_the_content_decides_where_the_suffix_is_wrong(tmp_path: Path) -> None:
    Recording().fly(2.0).write(tmp_path / "a.bin")
    Log(MAG).mags(5).write(tmp_path / "a.tlog")
    (tmp_path / "a.txt").write_text("time_s,mag_x_mgauss,mag_y_mgauss,mag_z_mgauss\n0,1,2,3\n")
    assert len(read_track(tmp_path / "a.bin").compasses[1].reported) == 20
    assert len(read_track(tmp_path / "a.tlog").compasses[1].reported) == 5
    assert len(read_track(tmp_path / "a.txt").compasses[1].reported) == 1


def test_the_suffix_decides_where_the_start_is_damaged(tmp_path: Path) -> None:
    path = tmp_path / "a.tlog"
    path.write_bytes(b"\0" * 999 + Recording().fly(2.0).content)
    assert len(read_track(path).compasses[1].reported) == 20
    path = tmp_path / "a.BIN"
    path.write_bytes(b"\0" * 999 + Log(MAG).mags(5).content)
    assert len(read_track(path).compasses[1].reported) == 5


@pytest.mark.parametrize("place", range(8))
@pytest.mark.parametrize("damaged", [0x00, 0x41, 0xFD, 0xFF])
def test_a_damaged_first_time_hides_no_telemetry_log(tmp_path: Path, place: int, damaged: int) -> None:
    content = bytearray(Recording().fly(2.0).content)
    content[place] = damaged
    path = tmp_path / "a"
    path.write_bytes(content)
    assert len(read_track(path).compasses[1].reported) == 20


@pytest.mark.parametrize("byte", [0xFD, 0xFE])
def test_a_log_whose_start_time_looks_like_a_frame_is_still_a_ulog(tmp_path: Path, byte: int) -> None:
    log = ULogFile(start_us=0x0F4200 + byte).topic("sensor_mag", "float x", "float y", "float z")
    for k in range(5):
        log.add("sensor_mag", 2_000_000 + 100_000 * k, 0.2, 0.0, 0.4)
    assert len(read_track(log.write(tmp_path / "a")).compasses[1].reported) == 5


@pytest.mark.parametrize(
    ("recording", "said"),
    [
        ("ardupilot-4.6.3/rover_dist.BIN", "ArduRover V4.6.3 (3fc7011a)"),
        ("ardupilot-4.6.3/rover_dist.tlog", "Arm: Check mag field (xy diff:106>100)"),
        ("px4-1.16/copter_four_positions.ulg", "PX4 1.16.0"),
    ],
)
def test_what_the_autopilot_said_is_kept_each_once(shared_data: Path, recording: str, said: str) -> None:
    texts = read_track(shared_data / recording).texts
    assert texts[0] == said and len(set(texts)) == len(texts)


def test_names_may_be_strings(tmp_path: Path) -> None:
    path = Recording().fly(1.0).write(tmp_path / "a.tlog")
    assert list(read_tracks(str(path))) == [1]


def test_a_file_that_is_not_there_is_a_matter_of_usage(tmp_path: Path) -> None:
    with pytest.raises(UsageError, match=r"no file .*missing\.tlog"):
        read_track(tmp_path / "missing.tlog")
    with pytest.raises(UsageError, match="is a folder"):
        read_track(tmp_path)


@pytest.mark.parametrize("name", ["a.tlog", "a.bin", "a.log", "a.ulg", "a.csv", "a.dat", "a"])
@pytest.mark.parametrize("content", [b"", b"\0" * 5000, b"hello world\n" * 50, bytes(range(256)) * 40])
def test_junk_is_refused_whatever_its_name(tmp_path: Path, name: str, content: bytes) -> None:
    path = tmp_path / name
    path.write_bytes(content)
    with pytest.raises(BadRecording) as caught:
        read_track(path)
    assert caught.value.remedy


def test_what_we_write_pymavlink_reads(tmp_path: Path) -> None:
    recording = Recording().fly(3.0)
    log = mavutil.mavlink_connection(str(recording.write(tmp_path / "a.tlog")))
    found = []
    while (message := log.recv_match()) is not None:
        found.append((round(message._timestamp * 1e6), bytes(message.get_msgbuf())))
    log.close()
    assert found == recording.records


# --- A new reader is one new file: nothing else names it


DIVERS_NOTES = '''
    """A diver's notes: a line of four numbers for each reading."""

    from pathlib import Path

    import numpy as np

    from mavcompass.correction import IDENTITY
    from mavcompass.track import InForce, MagSeries, Series, Track

    NAME = "diver's notes (.dive)"
    SUFFIXES = (".dive",)


    def recognises(head: bytes) -> bool:
        return head.startswith(b"DIVE")


    def read(path: Path, head: bytes) -> dict[int, Track]:
        rows = np.loadtxt(path, skiprows=1)
        reported = Series.of(rows[:, 0], rows[:, 1:])
        compass = MagSeries(1, reported, (InForce(-np.inf, IDENTITY),))
        return {1: Track(source=str(path), compasses={1: compass})}
'''


@pytest.fixture
def divers_notes(add_file: Callable[[ModuleType, str, str], None]) -> Iterator[None]:
    add_file(formats, "divers_notes", DIVERS_NOTES)
    known_formats.cache_clear()
    yield
    known_formats.cache_clear()


@pytest.mark.parametrize("name", ["wreck.dive", "wreck.txt"])
@pytest.mark.usefixtures("divers_notes")
def test_a_file_in_the_folder_is_a_reader(tmp_path: Path, name: str) -> None:
    path = tmp_path / name
    path.write_text("DIVE 7\n0.0 230.0 50.0 -530.0\n0.1 231.0 49.0 -530.0\n")
    compass = read_track(path).compasses[1]
    assert compass.reported.values == pytest.approx(np.array([[230.0, 50.0, -530.0], [231.0, 49.0, -530.0]]))


@pytest.mark.usefixtures("divers_notes")
def test_a_person_is_told_of_it(tmp_path: Path) -> None:
    (tmp_path / "strange.xyz").write_text("?")
    with pytest.raises(BadRecording, match=r"diver's notes \(\.dive\)"):
        read_track(tmp_path / "strange.xyz")
