"""Track CSV: any subset of the columns, exact round trips, errors that name the line."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp

from mavcompass.correction import FieldCorrection
from mavcompass.errors import BadRecording
from mavcompass.logs import read_track, write_track_csv
from mavcompass.logs.formats.csv.reader import read_track_csv
from mavcompass.track import InForce, MagSeries, Series, Track

MAG = "mag_x_mgauss,mag_y_mgauss,mag_z_mgauss"


def write(path: Path, text: str) -> Path:
    path.write_text(text, encoding="utf-8")
    return path


def refused(path: Path, text: str) -> str:
    with pytest.raises(BadRecording) as caught:
        read_track(write(path, text))
    assert caught.value.remedy
    return str(caught.value)


finite = st.floats(-1e6, 1e6)


@st.composite
def series(draw: st.DrawFn, width: int | None) -> Series:
    count = draw(st.integers(1, 12))
    times = np.sort(draw(hnp.arrays(np.float64, count, elements=st.sampled_from(np.arange(8) * 0.1))))
    shape = count if width is None else (count, width)
    return Series.of(times, draw(hnp.arrays(np.float64, shape, elements=finite)))


@settings(suppress_health_check=[HealthCheck.function_scoped_fixture], deadline=None, max_examples=60)
@given(st.data())
def test_what_is_written_is_read_back_exactly(tmp_path: Path, data: st.DataObject) -> None:
    widths = {"acc_mps2": 3, "gyro_radps": 3, "attitude_rad": 3, "reference_q": 4, "position_ned_m": 3}
    widths |= {"place": 3, "motors": 4}
    columns = {name: data.draw(st.none() | series(width)) for name, width in widths.items()}
    if (place := columns["place"]) is not None:
        columns["place"] = Series.of(place.time_s, place.values / 1.2e4)
    for name in ("current_a", "throttle", "temperature_degc", "gps_yaw_rad"):
        columns[name] = data.draw(st.none() | series(None))
    track = Track(compasses={1: MagSeries(1, data.draw(series(3)))}, **columns)
    path = tmp_path / "a.csv"
    write_track_csv(track, path)
    back = read_track_csv(path)  # whether those times are a clock is not the format's to say
    columns["mag"] = track.compasses[1].reported
    for name, written in columns.items():
        found = back.compasses[1].reported if name == "mag" else getattr(back, name)
        assert (found is None) == (written is None), name
        if written is not None:
            np.testing.assert_array_equal(found.time_s, written.time_s)
            np.testing.assert_array_equal(found.values, written.values)


def test_the_raw_field_is_written_with_the_correction_undone(tmp_path: Path) -> None:
    correction = FieldCorrection(offsets_mgauss=(10.0, 0.0, 0.0))
    mag = MagSeries(2, Series.of([0.0], [[110.0, 0.0, 400.0]]), (InForce(-np.inf, correction),))
    path = tmp_path / "a.csv"
    write_track_csv(Track(compasses={2: mag}), path, instance=2)
    assert read_track(path).compasses[1].reported.values.tolist() == [[100.0, 0.0, 400.0]]


def test_any_order_of_columns_spaces_a_byte_order_mark_and_dos_lines(tmp_path: Path) -> None:
    text = "\ufeffmag_z_mgauss, mag_x_mgauss ,time_s,mag_y_mgauss\r\n3, 1,0.5, 2\r\n6,4,0.6,5\r\n"
    path = tmp_path / "a.csv"
    path.write_bytes(text.encode("utf-8"))
    reported = read_track(path).compasses[1].reported
    assert reported.values.tolist() == [[1.0, 2.0, 3.0], [4.0, 5.0, 6.0]]
    assert reported.time_s.tolist() == [0.5, 0.6]


def test_empty_is_missing_for_that_quantity_only(tmp_path: Path) -> None:
    text = f"time_s,{MAG},current_a\n0,1,2,3,\n1,,,,7\n2,4,5,6,8\n"
    track = read_track(write(tmp_path / "a.csv", text))
    assert track.compasses[1].time_s.tolist() == [0.0, 2.0]
    assert track.current_a is not None
    assert track.current_a.time_s.tolist() == [1.0, 2.0]
    assert track.current_a.values.tolist() == [7.0, 8.0]


def test_columns_of_no_track_are_passed_over_and_named(tmp_path: Path) -> None:
    track = read_track(write(tmp_path / "a.csv", f"time_s,{MAG},label\n0,1,2,3,hello\n"))
    assert len(track.compasses[1].reported) == 1
    assert any("label" in note for note in track.notes)


def test_rows_out_of_order_are_sorted_and_said(tmp_path: Path) -> None:
    track = read_track(write(tmp_path / "a.csv", f"time_s,{MAG}\n2,4,5,6\n1,1,2,3\n"))
    assert track.compasses[1].reported.values[0].tolist() == [1.0, 2.0, 3.0]
    assert any("sorted" in note for note in track.notes)


def test_errors_name_the_line_and_the_column(tmp_path: Path) -> None:
    path = tmp_path / "a.csv"
    message = refused(path, f"time_s,{MAG}\n0,1,2,3\n1,1,oops,3\n")
    assert "line 3" in message and "mag_y_mgauss" in message and "oops" in message
    assert "line 3: 3 fields where the header has 4" in refused(path, f"time_s,{MAG}\n0,1,2,3\n1,1,2\n")
    assert "line 3: time_s is missing" in refused(path, f"time_s,{MAG}\n0,1,2,3\n,1,2,3\n")
    assert "mag_z_mgauss" in refused(path, "time_s,mag_x_mgauss,mag_y_mgauss\n0,1,2\n")
    assert "twice" in refused(path, f"time_s,{MAG},time_s\n0,1,2,3,4\n")


def test_a_last_line_that_was_not_written_to_its_end_is_left_out_and_said(tmp_path: Path) -> None:
    track = read_track(write(tmp_path / "a.csv", f"time_s,{MAG}\n0,1,2,3\n1,4,5"))
    assert track.compasses[1].time_s.tolist() == [0.0]
    assert any("cut off" in note for note in track.notes)


def test_a_damaged_line_is_left_out_and_said(tmp_path: Path) -> None:
    lines = ["time_s,mag_x_mgauss,mag_y_mgauss,mag_z_mgauss", *(f"{n / 10},{n},2,3" for n in range(60))]
    lines[7], lines[20], lines[31] = "0.6,6,2", '1.9,19,"2,3', "3.0,3\ufffd0,2,3"
    path = tmp_path / "damaged.csv"
    path.write_bytes("\n".join(lines).replace("\ufffd", "\x80").encode("latin-1"))
    track = read_track(path)
    assert track.compasses[1].reported.values[:, 0].tolist() == [n for n in range(60) if n not in (6, 19, 30)]
    assert any(note.startswith("3 damaged lines") and "line 8" in note for note in track.notes)


def test_damage_at_the_beginning_is_made_up_for_by_what_comes_later_where_that_is_enough(
    tmp_path: Path,
) -> None:
    good = [f"{k * 0.1:.1f},{k % 90}.5,{200 - k % 7}.25,-400.5" for k in range(60_000)]
    rows = [f"time_s,{MAG}", *["x,,,"] * 6_000, *good]
    track = read_track(write(tmp_path / "late.csv", "\n".join(rows) + "\n"))
    assert len(track.compass(1).reported) == len(good) and track.notes[0].startswith("6000 damaged lines")
    # One in ten is the most.
    assert "line 2" in refused(tmp_path / "never.csv", "\n".join([*rows, *["x,,,"] * 1_000]) + "\n")


def test_lines_are_counted_with_blank_ones_and_quoted_ones(tmp_path: Path) -> None:
    message = refused(tmp_path / "a.csv", f'time_s,{MAG}\n\n0,"1",2,3\n\n1,x,2,3\n')
    assert "line 5" in message


def test_a_table_without_magnetometer_or_rows_is_refused(tmp_path: Path) -> None:
    path = tmp_path / "a.csv"
    assert "no magnetometer" in refused(path, "time_s,current_a\n0,1\n")
    assert "no magnetometer" in refused(path, f"time_s,{MAG}\n")
    assert "no magnetometer" in refused(path, f"time_s,{MAG}\n0,,,\n")
    assert "time_s" in refused(path, f"{MAG}\n1,2,3\n")


@pytest.mark.parametrize("name", ["01_undisturbed_slow_rotation_A", "34_disturbed_attached_magnet_3cm"])
def test_recorded_reference_attitudes_are_read(shared_data: Path, name: str) -> None:
    path = shared_data / "real" / "broad" / f"{name}.csv"
    track = read_track(path)
    lines = path.read_text().splitlines()
    assert len(track.compasses[1].reported) == len(lines) - 1
    header, row = lines[0].split(","), lines[4000].split(",")
    reported = track.compasses[1].reported.values[3999]
    assert reported.tolist() == [float(row[header.index(f"mag_{axis}_mgauss")]) for axis in "xyz"]
    assert track.reference_q is not None and len(track.reference_q) <= len(track.compasses[1].reported)
    assert np.linalg.norm(track.reference_q.values, axis=1) == pytest.approx(1.0, abs=1e-4)


def test_the_hand_turned_sensor_is_read_as_recorded(shared_data: Path) -> None:
    path = shared_data / "real" / "hmc5883l-hand-rotation" / "full-sphere.csv"
    track = read_track(path)
    assert track.compasses[1].reported.values[0].tolist() == [241.284, -337.615, -388.991]
    assert track.temperature_degc is not None and len(track.temperature_degc) == 8190


def test_whole_numbers_are_the_formats_steps_and_cut_ones_are_known(tmp_path: Path) -> None:
    rng = np.random.default_rng(5)
    t = np.arange(4000) * 0.05
    turning = np.stack([250.0 * np.cos(0.5 * t), -250.0 * np.sin(0.5 * t), 0.0 * t + 430.0], axis=1)
    field = turning + rng.normal(0.0, 1.5, turning.shape)
    force = np.array([0.02, -0.03, -9.8]) + rng.normal(0.0, 0.05, turning.shape)
    milli_g = 0.00980665
    for wire, cut in ((np.trunc, True), (np.round, False)):
        made = Track(
            compasses={1: MagSeries(1, Series.of(t, wire(field)))},
            acc_mps2=Series.of(t, wire(force / milli_g) * milli_g),
        )
        write_track_csv(made, tmp_path / "steps.csv")
        read = read_track(tmp_path / "steps.csv")
        assert read.compasses[1].quantum_mgauss == 1.0
        assert read.compasses[1].truncated == cut
        assert read.acc_truncation_mps2 == pytest.approx(milli_g if cut else 0.0)


@pytest.mark.parametrize("step", [0.3, 4.0])
def test_other_steps_are_the_sensors_own(tmp_path: Path, step: float) -> None:
    rng = np.random.default_rng(6)
    field = np.round(rng.normal(0.0, 200.0, (500, 3)) / step) * step
    write_track_csv(
        Track(compasses={1: MagSeries(1, Series.of(np.arange(500) * 0.1, field))}), tmp_path / "s.csv"
    )
    assert read_track(tmp_path / "s.csv").compasses[1].quantum_mgauss == 0.0
