"""Counts are recordings, vehicles are told apart, and a slow recording holds nothing."""

from __future__ import annotations

import time
from pathlib import Path

import pytest
from fleet_samples import looked_at, write_recording

from mavcompass.fleet.engine import Engine
from mavcompass.fleet.examine import Job, Row
from mavcompass.fleet.recordings import accelerometer_mark, find_recordings, told_apart
from mavcompass.fleet.run import Progress, run_fleet
from mavcompass.fleet.summary import summarise

SIDES = ("x", "y", "z")


def row(
    recording: str,
    day: float,
    accelerometer: str | None = None,
    offset_x: float | None = None,
    ids: str | None = "97539",
    **more: object,
) -> Row:
    offsets = {f"in_force_offset_{side}_mgauss": None if offset_x is None else offset_x for side in SIDES}
    return {
        "recording": recording,
        "status": "ok",
        "vehicle": "flights, system 1",
        "named_by": "folder",
        "recorded_unix_s": day * 86_400.0,
        "compass": 1,
        "accelerometer": accelerometer,
        "device_ids": ids,
        **offsets,
        **more,
    }


def names(*rows: Row) -> dict[str, str]:
    return {r["recording"]: r["vehicle"].removeprefix("flights, system 1") for r in told_apart(rows)}


def test_twins_with_the_same_sensors_are_told_apart_by_their_accelerometers() -> None:
    assert names(row("b", 2, "one"), row("a", 1, "two"), row("c", 3, "one")) == {
        "a": ", A",
        "b": ", B",
        "c": ", B",
    }


def test_one_vehicle_keeps_its_name() -> None:
    assert names(row("a", 1, "one"), row("b", 2, "one"), row("c", 3)) == {"a": "", "b": "", "c": ""}


def test_a_new_calibration_of_one_sensor_makes_no_new_vehicle() -> None:
    assert set(
        names(row("a", 1, "one", 50.0), row("b", 2, "two", 50.0), row("c", 3, "two", 70.0)).values()
    ) == {""}


def test_other_device_ids_are_another_vehicle_where_nothing_else_is_known() -> None:
    assert names(row("a", 1), row("b", 2, ids="4711"), row("c", 3, ids=None)) == {
        "a": ", A",
        "b": ", B",
        "c": ", A",
    }


def test_offsets_of_zero_are_no_mark() -> None:
    assert names(row("a", 1, "one", 0.0), row("b", 2, "two", 0.0)) == {"a": ", A", "b": ", B"}


def test_a_name_that_a_person_gave_is_left_alone() -> None:
    given = {"named_by": "pattern"}
    assert set(names(row("a", 1, "one", **given), row("b", 2, "two", **given)).values()) == {""}


def test_the_accelerometer_s_mark_is_of_its_calibration() -> None:
    ardupilot = {f"INS_ACC{kind}_{axis}": 0.1 for kind in ("OFFS", "SCAL") for axis in "XYZ"}
    px4 = {f"CAL_ACC0_{axis}{kind}": 0.1 for kind in ("OFF", "SCALE") for axis in "XYZ"}
    assert accelerometer_mark(ardupilot) == accelerometer_mark(px4) is not None
    assert accelerometer_mark(ardupilot | {"INS_ACCOFFS_X": 0.2}) != accelerometer_mark(ardupilot)
    assert accelerometer_mark(dict.fromkeys(ardupilot, 0.0)) is None
    assert accelerometer_mark({}) is None


def test_counts_are_recordings_however_many_compasses_failed() -> None:
    failed = {"status": "error", "error": "Cut short.", "error_kind": "BadRecording"}
    rows = [row("a", 1) | failed | {"compass": i} for i in (1, 2, 3)]
    rows += [row("b", 2) | {"accepted": False, "status": "not_accepted", "seconds": 3.0, "compass": 1}]
    rows += [row("b", 2) | failed | {"compass": 2, "seconds": 4.0}]
    summary = summarise(rows, "calibrate")
    assert summary.recordings == 2
    assert summary.errors == (("a", "Cut short."), ("b", "compass 2: Cut short."))
    assert (summary.vehicles[0].errors, summary.vehicles[0].not_accepted) == (2, 1)
    assert summary.vehicles[0].why == ("2 recordings could not be used",)
    assert summary.slowest[0] == ("b", 7.0)


def test_an_ordinary_flight_gives_no_calibration_and_is_no_error() -> None:
    still = {"status": "error", "error": "Too little turning.", "error_kind": "PoorCalibration"}
    summary = summarise([row("a", 1) | still], "calibrate")
    assert summary.errors == () and summary.not_accepted == (("a", "Too little turning."),)
    assert summary.look_first == ()


@pytest.mark.parametrize(
    ("verdict", "is_notable"), [("no_gap", False), ("not_testable", False), ("named", True)]
)
def test_what_is_the_recordings_own_noise_is_no_reason_to_look(verdict: str, is_notable: bool) -> None:
    diagnosed = {
        "status": "ok",
        "verdict": verdict,
        "heading_gap_deg": 9.0,
        "compass": 1,
        "recorded_unix_s": 1.0,
    }
    summary = summarise([row("a", 1) | diagnosed], "diagnose")
    assert bool(summary.look_first) is is_notable


def calibrated(recording: str, day: float, x_mgauss: float, **more: object) -> Row:
    corrected = dict.fromkeys([f"off_diagonal_{pair}" for pair in ("xy", "xz", "yz")], 0.0)
    corrected |= {f"diagonal_{side}": 1.0 for side in SIDES} | {"scale": 1.0, "offset_x_mgauss": x_mgauss}
    corrected |= {"offset_y_mgauss": 0.0, "offset_z_mgauss": 0.0, "heading_sigma_deg": 0.3}
    field = {"field_horizontal_mgauss": 200.0, "field_vertical_mgauss": 400.0, "heading_change_deg": 0.0}
    return row(recording, day, "one", **{"accepted": True} | corrected | field | more)


def test_iron_that_moved_is_dated_and_told_with_what_came_between() -> None:
    """20 mG across 200 bend a heading by up to 5.7 degrees, over the circle by 4.1."""
    crash = {"status": "not_accepted", "accepted": False, "events": "Crash: Disarming"}
    rows = [calibrated(name, day, 0.5 * day, firmware="V4.5.7") for name, day in (("a", 0), ("b", 1))]
    rows += [row("c", 2, "one", **crash)]
    rows += [calibrated(name, day, 20.0, firmware="V4.6.3") for name, day in (("d", 3), ("e", 40))]
    (vehicle,) = summarise(rows, "calibrate").vehicles
    between = 'between 1970-01-02 and 1970-01-04 (firmware V4.5.7 became V4.6.3; "Crash: Disarming")'
    assert vehicle.why == (f"compass 1: its calibration moved by 4.0° {between}",)
    assert vehicle.histories[0].health == "moved by 4.0° until 1970-01-04, steady for 37 days"


def slow_or_quick(job: Job, path: str) -> list[Row]:
    """Look at a recording called slow only once it was noticed."""
    while Path(path).stem == "slow" and not Path(path).with_name("noticed").exists():
        time.sleep(0.02)
    return looked_at(job, path)


def test_a_slow_recording_does_not_hold_the_page_and_is_named(tmp_path: Path) -> None:
    for name in ("quick1.csv", "quick2.csv", "slow.csv"):
        write_recording(tmp_path / name, (20.0, -10.0, 5.0))
    pages: list[tuple[int, int]] = []
    named: list[tuple[str, float]] = []

    def look(progress: Progress) -> None:
        if pages[-1:] == [(2, 2)] and len(progress.under_way) == 1:
            named.extend(progress.under_way)
            (tmp_path / "noticed").touch()

    result = run_fleet(
        Job("calibrate"),
        find_recordings([str(tmp_path)]),
        tmp_path / "out.parquet",
        Engine(workers=2, timeout_s=120.0),
        on_progress=look,
        on_rows=lambda rows, progress: pages.append((len(rows), progress.done)),
        rows_every_s=0.1,
        examine_one=slow_or_quick,
    )
    assert result.examined == 3 and {row["status"] for row in result.rows} == {"ok"}
    path, seconds = named[0]
    assert path.endswith("slow.csv") and seconds > 0.0
