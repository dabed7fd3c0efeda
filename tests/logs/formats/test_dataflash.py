"""DataFlash logs: the same values as pymavlink's reader, and everything readable out of damaged ones."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
import pytest
from dataflash_builder import ATT, BAT, FMTU, GPS, IMU, MAG, MSG, MULT, PARM, UNIT, Log
from pymavlink import DFReader

from mavcompass.errors import BadRecording
from mavcompass.logs import read_track
from mavcompass.logs.formats.dataflash.reader import WANTED
from mavcompass.logs.formats.dataflash.records import read_records
from mavcompass.logs.formats.dataflash.text import read_text_records
from mavcompass.units import RAD_PER_DEG

LOGS = ("copter_dist_use2", "rover_plain")


def assert_same_as_pymavlink(path: Path, wanted: dict[str, tuple[str, ...]], text: bool = False) -> None:
    contents = (read_text_records if text else read_records)(path, wanted)
    (log,) = contents.logs
    reader = (DFReader.DFReader_text if text else DFReader.DFReader_binary)(str(path))
    theirs: dict[str, list[DFReader.DFMessage]] = {}
    while (message := reader.recv_match(type=list(wanted))) is not None:
        theirs.setdefault(message.get_type(), []).append(message)
    reader.close()
    assert log.records.keys() == theirs.keys()
    for name, messages in theirs.items():
        records = log.records[name]
        assert contents.counts[name] == len(messages) == len(records)
        for field in records.rows.dtype.names:
            expected = [getattr(message, field) for message in messages]
            if isinstance(expected[0], str):
                assert [one.decode("utf-8") for one in records.rows[field].tolist()] == expected, (
                    name,
                    field,
                )
            else:
                np.testing.assert_array_equal(records.decoded(field), expected, err_msg=f"{name}.{field}")


@pytest.mark.parametrize("name", LOGS)
def test_every_value_equals_pymavlinks(shared_data: Path, name: str) -> None:
    assert_same_as_pymavlink(shared_data / "ardupilot-4.6.3" / f"{name}.BIN", WANTED)


def test_every_kind_of_record_is_counted_as_pymavlink_does(shared_data: Path) -> None:
    path = shared_data / "ardupilot-4.6.3" / "copter_dist_use2.BIN"
    reader = DFReader.DFReader_binary(str(path))
    theirs = {some.name: len(reader.offsets[number]) for number, some in reader.formats.items()}
    reader.close()
    assert read_records(path, {}).counts == {name: count for name, count in theirs.items() if count}


def test_text_log_equals_pymavlinks_and_the_binary_log(shared_data: Path, tmp_path: Path) -> None:
    binary = shared_data / "ardupilot-4.6.3" / "rover_plain.BIN"
    path = tmp_path / "flight.log"
    write_as_text(binary, path, ("FMT", "UNIT", "MULT", "FMTU", "MAG", "PARM", "MSG", "ATT", "GPS", "IMU"))
    assert_same_as_pymavlink(path, {name: WANTED[name] for name in ("MAG", "ATT", "GPS", "IMU")}, text=True)
    from_text, from_binary = read_track(path), read_track(binary)
    assert from_text.parameters == from_binary.parameters
    assert from_text.vehicle == from_binary.vehicle == "rover"
    for instance, compass in from_binary.compasses.items():
        np.testing.assert_array_equal(from_text.compasses[instance].reported.values, compass.reported.values)
        assert from_text.compasses[instance].in_force == compass.in_force
    assert from_text.attitude_rad is not None and from_binary.attitude_rad is not None
    np.testing.assert_allclose(from_text.attitude_rad.values, from_binary.attitude_rad.values, atol=1e-12)


def write_as_text(binary: Path, path: Path, kinds: tuple[str, ...]) -> None:
    reader = DFReader.DFReader_binary(str(binary))
    with path.open("w") as file:
        while (message := reader.recv_match(type=list(kinds))) is not None:
            values = [str(getattr(message, field)) for field in message.get_fieldnames()]
            file.write(", ".join([message.get_type(), *values]) + "\n")
    reader.close()


def test_recorded_rover_gives_all_quantities_in_the_units_used_inside(shared_data: Path) -> None:
    track = read_track(shared_data / "ardupilot-4.6.3" / "rover_dist.BIN")
    assert (track.autopilot, track.vehicle, list(track.compasses)) == ("ardupilot", "rover", [1, 2, 3])
    compass = track.compasses[1]
    assert compass.truncated and compass.quantum_mgauss == 1.0 and compass.correction_known
    assert compass.in_force[0].correction.offsets_mgauss == (5.0, 13.0, -18.0)
    assert np.linalg.norm(track.compasses[2].reported.values, axis=1) == pytest.approx(580, abs=5)
    for series in (track.acc_mps2, track.gyro_radps, track.attitude_rad, track.truth_q, track.place):
        assert series is not None and len(series) > 200
    assert track.acc_mps2 is not None and track.gyro_radps is not None and track.truth_q is not None
    assert np.median(track.acc_mps2.values[:, 2]) == pytest.approx(-9.81, abs=0.02)
    assert track.gyro_radps.time_s is track.acc_mps2.time_s
    assert np.linalg.norm(track.truth_q.values, axis=1) == pytest.approx(1.0, abs=1e-5)
    assert track.motors is not None and 0.0 <= track.motors.values.min() <= track.motors.values.max() <= 1.0
    assert track.utc_offset_s == pytest.approx(1795209343.95, abs=0.1)


def test_a_correction_changed_on_the_way_is_in_force_from_then_on(tmp_path: Path) -> None:
    log = Log(MAG, PARM)
    for axis, value in zip("XYZ", (5.0, 13.0, -18.0), strict=True):
        log.add("PARM", 1_000_000, f"COMPASS_OFS_{axis}", value)
    log.mags(10, 1_000_000).add("PARM", 2_000_000, "COMPASS_OFS_X", 105.0).mags(10, 2_000_001, x=300)
    track = read_track(log.write(tmp_path / "a.bin"))
    steps = track.compasses[1].in_force
    assert [step.from_s for step in steps] == [-math.inf, 2.0]
    assert [step.correction.offsets_mgauss[0] for step in steps] == [5.0, 105.0]
    np.testing.assert_allclose(track.raw_field(1)[:, 0], 195.0)


def test_offsets_are_taken_from_mag_where_the_parameters_are_missing(tmp_path: Path) -> None:
    track = read_track(Log(MAG).mags(5, offset=7).write(tmp_path / "a.bin"))
    assert track.compasses[1].correction_known
    np.testing.assert_allclose(track.raw_field(1)[:, 0], 193.0)


def test_units_and_multipliers_come_from_the_log_itself(tmp_path: Path) -> None:
    odd = (10, "MAG", "Qhhh", "TimeUS,MagX,MagY,MagZ")
    log = Log(odd, FMTU, UNIT, MULT)
    log.add("UNIT", 0, ord("G"), "Gauss").add("UNIT", 0, ord("s"), "s")
    log.add("MULT", 0, ord("D"), 1.0e-4).add("MULT", 0, ord("F"), 1.0e-6)
    log.add("FMTU", 0, 10, "sGGG", "FDDD").add("MAG", 1_000_000, 2000, 0, -5000)
    track = read_track(log.write(tmp_path / "a.bin"))
    assert track.compasses[1].reported.values[0] == pytest.approx([200.0, 0.0, -500.0])


def test_old_names_are_understood(tmp_path: Path) -> None:
    log = Log(
        (10, "MAG", "Ihhh", "TimeMS,MagX,MagY,MagZ"),
        (11, "MAG2", "Ihhh", "TimeMS,MagX,MagY,MagZ"),
        (12, "IMU", "Iffffff", "TimeMS,GyrX,GyrY,GyrZ,AccX,AccY,AccZ"),
        (13, "CURR", "IhIhh", "TimeMS,ThrOut,ThrInt,Volt,Curr"),
        (14, "GPS", "BIHBcLLeeEefI", "Status,TimeMS,Week,NSats,HDop,Lat,Lng,RelAlt,Alt,Spd,GCrs,VZ,T"),
        (15, "PARM", "Nf", "Name,Value"),
        (16, "ATT", "IccccCC", "TimeMS,DesRoll,Roll,DesPitch,Pitch,DesYaw,Yaw"),
    )
    log.add("PARM", "COMPASS_OFS_X", 1.0).add("PARM", "COMPASS_OFS2_X", 2.0)
    for n in range(5):
        log.add("MAG", 1000 + n, 200, 0, -500).add("MAG2", 1000 + n, 210, 0, -500)
        log.add("IMU", 1000 + n, 0.0, 0.0, 0.1, 0.0, 0.0, -9.8).add("CURR", 1000 + n, 0, 0, 1200, 1550)
        log.add(
            "GPS", 3, 5000 + n, 1800, 9, 100, 479_000_000, 80_000_000, 0, 50_000, 100, 9000, 0.0, 1000 + n
        )
        log.add("ATT", 1000 + n, 0, 100, 0, -200, 0, 27000)
    track = read_track(log.write(tmp_path / "a.bin"))
    assert list(track.compasses) == [1, 2]
    assert track.compasses[2].reported.values[0, 0] == 210.0
    assert track.compasses[1].time_s.tolist() == pytest.approx([1.0, 1.001, 1.002, 1.003, 1.004])
    assert track.parameters == {"COMPASS_OFS_X": 1.0, "COMPASS_OFS2_X": 2.0}
    assert track.current_a is not None and track.current_a.values[0] == pytest.approx(15.5)
    assert track.place is not None and track.place.values[0] == pytest.approx([47.9, 8.0, 500.0])
    assert track.gps_velocity_mps is not None and track.gps_velocity_mps.values[0, 1] == pytest.approx(1.0)
    assert track.attitude_rad is not None
    assert track.attitude_rad.values[0] == pytest.approx(np.array([1.0, -2.0, -90.0]) * RAD_PER_DEG)


def test_batteries_and_receivers_other_than_the_first_do_not_mix_in(tmp_path: Path) -> None:
    log = Log(MAG, BAT).mags(3)
    log.add("BAT", 1_000_000, 0, 12.0, 7.0).add("BAT", 1_000_000, 1, 12.0, 70.0)
    track = read_track(log.write(tmp_path / "a.bin"))
    assert track.current_a is not None and track.current_a.values.tolist() == [7.0]


def test_a_damaged_stretch_is_skipped_and_said(tmp_path: Path) -> None:
    log = Log(MAG).mags(100)
    content = bytearray(log.content)
    record = len(log.parts[-1])
    first = len(content) - 60 * record
    content[first + 10 : first + 10 + 3 * record] = b"\x55" * 3 * record
    path = tmp_path / "a.bin"
    path.write_bytes(content)
    track = read_track(path)
    kept = track.compasses[1].reported.values[:, 1].tolist()
    assert kept == [n for n in range(100) if n not in (40, 41, 42, 43)]
    assert any("bytes were left out" in note for note in track.notes)


def test_bytes_lost_in_a_record_do_not_make_a_wrong_one(tmp_path: Path) -> None:
    log = Log(MAG).mags(50)
    record = len(log.parts[-1])
    cut = len(log.content) - 20 * record + 15
    path = tmp_path / "a.bin"
    path.write_bytes(log.content[:cut] + log.content[cut + 5 :])
    assert read_track(path).compasses[1].reported.values[:, 1].tolist() == [n for n in range(50) if n != 30]


def test_filling_at_the_end_of_a_flash_page_is_not_damage_of_the_last_record(tmp_path: Path) -> None:
    path = tmp_path / "a.bin"
    path.write_bytes(Log(MAG).mags(10).content + b"\xff" * 200)
    assert len(read_track(path).compasses[1].reported) == 10


def test_logs_put_together_go_on_in_time_each_with_its_own_formats(tmp_path: Path) -> None:
    first = Log(MAG, MSG).add("MSG", 0, "APM:Rover V3.1.0").mags(10, 50_000_000)
    other = (10, "IMU", "QBffffff", "TimeUS,I,GyrX,GyrY,GyrZ,AccX,AccY,AccZ")
    second = Log(other, (11, "MAG", "QBhhh", "TimeUS,I,MagX,MagY,MagZ"))
    for n in range(10):
        second.add("IMU", 2_000_000 + n, 0, 0.0, 0.0, 0.0, 0.0, 0.0, -9.8)
        second.add("MAG", 2_000_000 + n, 0, 300, n, -500)
    path = tmp_path / "a.bin"
    path.write_bytes(first.content + second.content)
    track = read_track(path)
    reported = track.compasses[1].reported
    assert track.vehicle == "rover" and reported.values[:, 0].tolist() == [200.0] * 10 + [300.0] * 10
    assert bool((np.diff(reported.time_s) > 0.0).all())
    assert sum("2 logs" in note or "started 2 times" in note for note in track.notes) == 2


def test_the_pause_between_two_power_ups_is_the_gps_clocks(tmp_path: Path) -> None:
    content = b""
    for boot_us, week_ms in ((60_000_000, 100_000_000), (5_000_000, 100_600_000)):
        log = Log(MAG, GPS)
        log.add("GPS", boot_us, 3, week_ms, 2300, 9, 100, 479_000_000, 80_000_000, 0, 0.0, 0.0, 0.0)
        content += log.mags(10, boot_us).content
    path = tmp_path / "a.bin"
    path.write_bytes(content)
    times = read_track(path).compasses[1].time_s
    assert times[10] - times[0] == pytest.approx(600.0, abs=1e-6)


def test_one_impossible_time_is_left_out(tmp_path: Path) -> None:
    log = Log(MAG).mags(20)
    log.add("MAG", 10**15, 0, 1, 1, 1, 0, 0, 0).mags(20, 3_000_000)
    track = read_track(log.write(tmp_path / "a.bin"))
    assert len(track.compasses[1].reported) == 40
    assert track.duration_s == pytest.approx(3.9)
    assert any("impossible time" in note for note in track.notes)


@pytest.mark.parametrize("chunk_bytes", [1, 1000, 5000])
def test_the_size_of_the_chunks_changes_nothing(tmp_path: Path, chunk_bytes: int) -> None:
    log = Log(MAG, IMU, ATT)
    rng = np.random.default_rng(3)
    for n in range(400):
        log.add("IMU", n, 0, *rng.normal(size=6)).mags(1, n)
    content = bytearray(log.content)
    for place in range(2000, len(content), 997):
        content[place] ^= 0x0F
    path = tmp_path / "a.bin"
    path.write_bytes(content)
    whole, pieces = (
        read_records(path, {"MAG": (), "IMU": ()}),
        read_records(path, {"MAG": (), "IMU": ()}, chunk_bytes),
    )
    assert (whole.counts, whole.skipped_bytes, whole.skipped_stretches) == (
        pieces.counts,
        pieces.skipped_bytes,
        pieces.skipped_stretches,
    )
    for name in ("MAG", "IMU"):
        np.testing.assert_array_equal(whole.logs[0].records[name].rows, pieces.logs[0].records[name].rows)


def test_a_log_without_magnetometer_says_so(tmp_path: Path) -> None:
    log = Log(IMU).add("IMU", 1, 0, 0.0, 0.0, 0.0, 0.0, 0.0, -9.8)
    with pytest.raises(BadRecording, match="no magnetometer") as caught:
        read_track(log.write(tmp_path / "a.bin"))
    assert "LOG_BITMASK" in caught.value.remedy


def test_a_compass_of_zeros_is_no_compass(tmp_path: Path) -> None:
    log = Log(MAG).add("MAG", 1, 0, 0, 0, 0, 0, 0, 0)
    with pytest.raises(BadRecording, match="only zeros"):
        read_track(log.write(tmp_path / "a.bin"))


def test_readings_of_zeros_among_others_are_left_out_and_said(tmp_path: Path) -> None:
    """A firmware whose motor compensation was no number logged zeros while the motors ran."""
    log = Log(MAG).mags(20)
    for n in range(5):
        log.add("MAG", 3_000_000 + n * 100_000, 0, 0, 0, 0, 5, 13, -18)
    track = read_track(log.write(tmp_path / "a.bin"))
    assert len(track.compasses[1].reported) == 20
    assert any("said nothing (zero on every axis) in 5 of 25 readings" in note for note in track.notes)
