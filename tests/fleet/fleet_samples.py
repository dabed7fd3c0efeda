"""Recordings and tasks for the tests of fleets; importable by the processes that do the tasks."""

from __future__ import annotations

import os
import signal
import time
from pathlib import Path

import numpy as np

from mavcompass.correction import IDENTITY
from mavcompass.fleet.examine import Job, Row
from mavcompass.logs import write_track_csv
from mavcompass.track import InForce, MagSeries, Series, Track

PLACE = (47.3977, 8.5456, 488.0)
FIELD_MGAUSS = (210.0, 12.0, 430.0)  # about what the world model has there: north, east, down


def write_recording(
    path: Path, offset_mgauss: tuple[float, float, float], seed: int = 0, rate_hz: float = 10.0
) -> Path:
    """Write a level vehicle that turns in four steps of 90 degrees, as a Track CSV."""
    noise = np.random.default_rng(seed)
    dwell, turn = int(4 * rate_hz), int(3 * rate_hz)
    rate = np.concatenate([np.r_[np.zeros(dwell), np.full(turn, np.pi / 2 / 3.0)] for _ in range(4)])
    rate = np.r_[rate, np.zeros(dwell)]
    time_s = np.arange(rate.size) / rate_hz
    yaw = np.concatenate([[0.0], np.cumsum(rate[:-1]) / rate_hz])
    north, east, down = FIELD_MGAUSS
    field = np.stack(
        [
            north * np.cos(yaw) + east * np.sin(yaw),
            -north * np.sin(yaw) + east * np.cos(yaw),
            np.full(yaw.size, down),
        ],
        axis=1,
    )
    raw = field + offset_mgauss + noise.normal(0.0, 0.5, field.shape)
    flat = np.zeros((yaw.size, 3))
    track = Track(
        source=path.name,
        compasses={1: MagSeries(1, Series.of(time_s, raw), (InForce(-np.inf, IDENTITY),))},
        acc_mps2=Series.of(time_s, flat - np.array([0.0, 0.0, 9.81]) + noise.normal(0.0, 0.01, flat.shape)),
        gyro_radps=Series.of(time_s, np.c_[flat[:, :2], rate] + noise.normal(0.0, 1e-4, flat.shape)),
        place=Series.of(time_s, np.tile(PLACE, (yaw.size, 1))),
    )
    write_track_csv(track, path)
    return path


def looked_at(job: Job, path: str) -> list[Row]:
    """Give the row of a recording without looking into it, where only who does what when is asked."""
    return [{"recording": path, "status": "ok", "vehicle": Path(path).stem, "compass": 1}]


def mark_and_look(mark: str, job: Job, path: str) -> list[Row]:
    """Leave a line in the file `mark` beside the recording for each time it was begun."""
    with Path(path).with_name(mark).open("a") as file:
        file.write(f"{Path(path).name}\n")
    return looked_at(job, path)


def look_or_die(job: Job, path: str) -> list[Row]:
    """Die on a recording called deadly as a segmentation fault would have it."""
    if "deadly" in path:
        os.kill(os.getpid(), signal.SIGSEGV)
    return looked_at(job, path)


class Stubborn(Exception):
    """Be an error that can be written, but not read again."""

    def __init__(self, one: str, two: str) -> None:
        super().__init__(f"{one} {two}")


def square(number: int) -> int:
    """Do as tasks do, each in its own way of going wrong."""
    match number:
        case -1:
            os._exit(7)
        case -2:
            raise ValueError("no square of minus two")
        case -3:
            time.sleep(60.0)
        case -4:
            print("noise on standard output")
        case -5:
            raise Stubborn("two", "words")
        case -6:
            os.kill(os.getpid(), signal.SIGSEGV)
    return number * number
