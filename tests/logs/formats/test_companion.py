"""A telemetry log without parameters takes them from the autopilot's own log of the same power-up."""

from __future__ import annotations

import shutil
from pathlib import Path

import numpy as np
from dataflash_builder import GPS, MAG, PARM, Log
from recorded_frames import T0_US, Recording, parameter

from mavcompass.logs import read_track

# GPS week and milliseconds of the recording's start, when time since boot was 20 s.
_WEEK = 2288
_MS = round((T0_US * 1e-6 + 18.0 - 315_964_800 - _WEEK * 604_800) * 1e3)


def autopilots_log(boot_us: int = 20_000_000) -> Log:
    log = Log(MAG, PARM, GPS)
    for axis, value in zip("XYZ", (5.0, 13.0, -18.0), strict=True):
        log.add("PARM", boot_us, f"COMPASS_OFS_{axis}", value)
    log.add("GPS", boot_us, 3, _MS, _WEEK, 9, 100, 479_000_000, 80_000_000, 0, 0.0, 0.0, 0.0)
    return log.mags(10, boot_us)


def test_the_corrections_come_from_the_log_beside_and_that_is_said(tmp_path: Path) -> None:
    autopilots_log().write(tmp_path / "flight.BIN")
    track = read_track(Recording().fly(5.0).write(tmp_path / "flight.tlog"))
    np.testing.assert_array_equal(track.raw_field(1), [[195.0, 37.0, -482.0]] * 50)
    assert track.compasses[1].correction_known
    assert any("taken from flight.BIN" in note for note in track.notes)
    assert not any("taken as they are" in note for note in track.notes)


def test_the_log_of_another_flight_is_not_believed(tmp_path: Path) -> None:
    autopilots_log(boot_us=90_000_000).write(tmp_path / "flight.BIN")
    track = read_track(Recording().fly(5.0).write(tmp_path / "flight.tlog"))
    assert not track.compasses[1].correction_known
    assert any("taken as they are" in note for note in track.notes)


def test_parameters_in_the_recording_itself_need_no_companion(tmp_path: Path) -> None:
    autopilots_log().write(tmp_path / "flight.BIN")
    recording = Recording()
    for axis in "XYZ":
        recording.add(0.0, parameter(f"COMPASS_OFS_{axis}", 1.0, index=1))
    track = read_track(recording.fly(5.0).write(tmp_path / "flight.tlog"))
    assert track.compasses[1].in_force[0].correction.offsets_mgauss == (1.0, 1.0, 1.0)


def test_junk_beside_a_recording_is_ignored(tmp_path: Path) -> None:
    (tmp_path / "flight.bin").write_bytes(b"junk" * 100)
    (tmp_path / "flight.log").write_text("ground station started\n")
    track = read_track(Recording().fly(2.0).write(tmp_path / "flight.tlog"))
    assert not track.compasses[1].correction_known


def test_recorded_rovers_agree_with_their_own_log(shared_data: Path, tmp_path: Path) -> None:
    folder = shared_data / "ardupilot-4.6.3"
    track = read_track(folder / "rover_dist.tlog")
    log = read_track(folder / "rover_dist.BIN")
    for instance in (1, 2, 3):
        assert track.compasses[instance].in_force == log.compasses[instance].in_force
        assert track.compasses[instance].device_id == log.compasses[instance].device_id
    alone = tmp_path / "rover_dist.tlog"
    shutil.copy(folder / "rover_dist.tlog", alone)
    assert not read_track(alone).compasses[1].correction_known
