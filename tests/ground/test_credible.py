"""What no sensor can say is not a reading: whatever the quantity, it is left out and told."""

from __future__ import annotations

import csv
import math
from dataclasses import fields
from pathlib import Path

import numpy as np
import pytest

from mavcompass import messages as mav
from mavcompass.credible import with_credible_readings
from mavcompass.logs import read_track
from mavcompass.logs.formats.csv.reader import KNOWN, TIME
from mavcompass.track import MagSeries, Series, Track
from mavcompass.track_builder import TrackBuilder

COLUMNS = sorted(field.name for field in fields(Track) if field.type == "Series | None")


def track_of(name: str, series: Series) -> Track:
    compass = MagSeries(1, series)
    return Track(compasses={1: compass}) if name == "compass 1" else Track(**{name: series})  # type: ignore[arg-type]


@pytest.mark.parametrize("odd", [np.inf, -np.inf, 1e30, -1e8])
@pytest.mark.parametrize("name", [*COLUMNS, "compass 1"])
def test_every_quantity_of_a_track_has_its_bounds(name: str, odd: float) -> None:
    values = np.full((6, 3), 0.5)
    values[1, 2] = np.nan  # a receiver that does not tell the velocity down
    sound = track_of(name, Series.of(np.arange(6.0), values))
    assert with_credible_readings(sound) is sound
    values[[0, 4], [1, 2]] = odd
    kept = with_credible_readings(track_of(name, Series.of(np.arange(6.0), values)))
    assert dict(kept.columns())[name].time_s.tolist() == [1.0, 2.0, 3.0, 5.0]
    assert [note.startswith("Left out 2 of 6 readings of ") for note in kept.notes] == [True]
    none = with_credible_readings(track_of(name, Series.of([1.0], [[odd] * 3])))
    assert not any(len(series) for _, series in none.columns()) and len(none.notes) == 1


@pytest.mark.parametrize("column", sorted(KNOWN - {TIME}))
def test_every_column_of_a_table_leaves_it_out(tmp_path: Path, column: str) -> None:
    with (path := tmp_path / "a.csv").open("w") as file:
        table = csv.DictWriter(file, sorted(KNOWN))
        table.writeheader()
        for k in range(9):
            table.writerow(dict.fromkeys(KNOWN, 0.5) | {TIME: 0.1 * k} | ({column: 1e30} if k == 4 else {}))
    track = read_track(path)
    assert sorted(len(series) for _, series in track.columns()) == [
        8,
        *[9] * (len(list(track.columns())) - 1),
    ]
    assert [note.startswith("Left out 1 of 9 readings of ") for note in track.notes] == [True]


@pytest.mark.parametrize(
    ("odd", "good"),
    [
        (mav.RawImu(time_usec=1000, xgyro=32767), mav.RawImu(time_usec=2000)),
        (mav.ScaledImu2(time_boot_ms=1, zmag=-32768), mav.ScaledImu2(time_boot_ms=2)),
        (mav.Attitude(time_boot_ms=1, yaw=1e30), mav.Attitude(time_boot_ms=2)),
        (mav.Attitude(time_boot_ms=1, yaw=math.nan), mav.Attitude(time_boot_ms=2)),
        (mav.LocalPositionNed(time_boot_ms=1, x=-math.inf), mav.LocalPositionNed(time_boot_ms=2)),
        (mav.GlobalPositionInt(time_boot_ms=1, lat=2**31 - 1), mav.GlobalPositionInt(time_boot_ms=2)),
        (mav.SysStatus(current_battery=32767), mav.SysStatus(current_battery=5)),
        (mav.Simstate(pitch=math.inf), mav.Simstate(pitch=0.1)),
    ],
)
def test_a_live_track_leaves_it_out(odd: mav.Message, good: mav.Message) -> None:
    builder = TrackBuilder("ardupilot", "rover")
    for k, message in enumerate((odd, good)):
        builder.add(mav.Incoming(0.1 * k, 1, 1, message))
    track = builder.build()
    assert 1 in [len(series) for _, series in track.columns()]
    told = [note.startswith("Left out 1 of 2 readings of ") for note in track.notes]
    assert told == [] if "nan" in repr(odd) else any(told), "an estimator that has not begun is no damage"
