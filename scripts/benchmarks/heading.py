"""Measure the heading of a Track's columns beside the textbook's formula in numpy and pymavlink's mavextra.

    scripts/bench heading

All in float64 on the same readings, best of several, by processor time. The textbook works on (N, 3) rows:
roll and pitch from the specific force, the field turned level by sines and cosines, one arctan2. mavextra
works on one message at a time, so it gets fewer and is compared per sample; all three agree to 1e-9 rad.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from mavcompass.heading import tilt_compensated_heading
from mavcompass.track import Series

SAMPLES, MAVEXTRA_SAMPLES = 1_000_000, 20_000
TIMER = "time.process_time"
Array = np.ndarray[Any, np.dtype[np.float64]]
OURS, TEXTBOOK, MAVEXTRA = (
    "mavcompass, columns of a Track",
    "textbook, rows",
    "pymavlink mavextra.mag_heading",
)
CHECKS = (
    {"what": "times the textbook", "of": TEXTBOOK, "over": OURS, "at_least": 4.0},
    {"what": "times mavextra.mag_heading", "of": MAVEXTRA, "over": OURS, "at_least": 1000.0},
)


def readings(samples: int) -> tuple[Array, Array]:
    """Return fields (N, 3), mG, and specific forces (N, 3), m/s^2, of tilts up to about 30 degrees."""
    noise = np.random.default_rng(1)
    yaw = noise.uniform(-np.pi, np.pi, samples)
    roll, pitch = noise.uniform(-0.5, 0.5, (2, samples))
    acc = -9.81 * np.c_[-np.sin(pitch), np.cos(pitch) * np.sin(roll), np.cos(pitch) * np.cos(roll)]
    field = np.c_[210.0 * np.cos(yaw), -210.0 * np.sin(yaw), np.full(samples, 430.0)]
    return field + noise.normal(0.0, 2.0, field.shape), acc


def textbook(field: Array, acc: Array) -> Array:
    """Tilt-compensate as application notes do, on rows."""
    roll = np.arctan2(-acc[:, 1], -acc[:, 2])
    pitch = np.arctan2(acc[:, 0], np.hypot(acc[:, 1], acc[:, 2]))
    x = (
        field[:, 0] * np.cos(pitch)
        + field[:, 1] * np.sin(roll) * np.sin(pitch)
        + field[:, 2] * np.cos(roll) * np.sin(pitch)
    )
    y = field[:, 1] * np.cos(roll) - field[:, 2] * np.sin(roll)
    return np.asarray(np.mod(np.arctan2(-y, x), 2.0 * np.pi))


def messages(field: Array, acc: Array) -> list[tuple[SimpleNamespace, SimpleNamespace]]:
    """Return a RAW_IMU and an ATTITUDE for each sample."""
    tilts = [(math.atan2(-a[1], -a[2]), math.atan2(a[0], math.hypot(a[1], a[2]))) for a in acc.tolist()]
    return [
        (SimpleNamespace(xmag=x, ymag=y, zmag=z), SimpleNamespace(roll=roll, pitch=pitch, yaw=0.0))
        for (x, y, z), (roll, pitch) in zip(field.tolist(), tilts, strict=True)
    ]


@pytest.fixture(scope="module")
def works() -> dict[str, tuple[Callable[[], Any], int]]:
    """Make what is measured, and of how many samples: pymavlink alone, and as its graphing tools call it."""
    from pymavlink import mavextra, mavutil

    field, acc = readings(SAMPLES)
    times = np.arange(SAMPLES) * 0.0025
    columns, forces = Series.of(times, field).values, Series.of(times, acc).values
    said, words = (
        messages(field[:MAVEXTRA_SAMPLES], acc[:MAVEXTRA_SAMPLES]),
        "mag_heading(RAW_IMU,ATTITUDE,0)",
    )

    def alone() -> Array:
        return np.radians([mavextra.mag_heading(raw, attitude, declination=0.0) for raw, attitude in said])

    def graphed() -> None:
        for raw, attitude in said:
            mavutil.evaluate_expression(words, {"RAW_IMU": raw, "ATTITUDE": attitude})

    return {
        OURS: (lambda: tilt_compensated_heading(columns, forces), SAMPLES),
        "mavcompass, rows": (lambda: tilt_compensated_heading(field, acc), SAMPLES),
        TEXTBOOK: (lambda: textbook(field, acc), SAMPLES),
        MAVEXTRA: (alone, MAVEXTRA_SAMPLES),
        "the same as mavgraph's expression": (graphed, MAVEXTRA_SAMPLES),
    }


@pytest.mark.parametrize(
    "name", [OURS, "mavcompass, rows", TEXTBOOK, MAVEXTRA, "the same as mavgraph's expression"]
)
def test_headings(benchmark: Any, works: dict[str, tuple[Callable[[], Any], int]], name: str) -> None:
    work, benchmark.extra_info["samples"] = works[name]
    found, right = benchmark.pedantic(work, rounds=5), works[OURS][0]()
    if found is not None:  # where two ways to one heading disagree their times mean nothing
        assert float(np.abs(np.mod(found - right[: len(found)] + np.pi, 2.0 * np.pi) - np.pi).max()) < 1e-9
