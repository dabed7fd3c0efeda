"""Measure the heading of a Track's columns beside the textbook's formula in numpy and pymavlink's mavextra.

    scripts/bench heading [-- --samples 1000000]

All in float64 on the same readings, best of several in turns. The textbook works on (N, 3) rows: roll and
pitch from the specific force, the field turned level by sines and cosines, one arctan2. mavextra works on
one message at a time, so it gets fewer and is compared per sample; all three agree to 1e-9 rad.
"""

from __future__ import annotations

import argparse
import math
import time
from collections.abc import Callable, Sequence
from types import SimpleNamespace
from typing import Any

import numpy as np

ROUNDS = 7
MAVEXTRA_SAMPLES = 20_000
QUICK = ("--samples", "200000")
Array = np.ndarray[Any, np.dtype[np.float64]]


def main(argv: Sequence[str] | None = None) -> dict[str, Any]:
    """Measure; return million headings per second of each."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--samples", type=int, default=1_000_000)
    samples = parser.parse_args(argv).samples

    from mavcompass.heading import tilt_compensated_heading
    from mavcompass.track import Series

    rows_field, rows_acc = readings(samples)
    times = np.arange(samples) * 0.0025
    field, acc = Series.of(times, rows_field).values, Series.of(times, rows_acc).values
    rate = rates(
        {
            "mavcompass, columns of a Track": (lambda: tilt_compensated_heading(field, acc), samples),
            "mavcompass, (N, 3) rows": (lambda: tilt_compensated_heading(rows_field, rows_acc), samples),
            "textbook, (N, 3) rows": (lambda: textbook(rows_field, rows_acc), samples),
        }
    )
    few = min(MAVEXTRA_SAMPLES, samples)
    rate |= rates(mavextra(rows_field[:few], rows_acc[:few]), rounds=3)
    check_agreement(tilt_compensated_heading(field, acc), textbook(rows_field, rows_acc))
    ours = rate["mavcompass, columns of a Track"]
    for name, per_second in rate.items():
        print(f"  {name:34s} {per_second / 1e6:9.3f} M/s   mavcompass is {ours / per_second:8.1f} x")
    checks = [
        {"what": "times the textbook", "value": ours / rate["textbook, (N, 3) rows"], "at_least": 4.0},
        {
            "what": "times mavextra.mag_heading",
            "value": ours / rate["pymavlink mavextra.mag_heading"],
            "at_least": 1000.0,
        },
    ]
    return {"headings_per_second": rate, "checks": checks}


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


def mavextra(field: Array, acc: Array) -> dict[str, tuple[Callable[[], object], int]]:
    """Return work for pymavlink, on a RAW_IMU and an ATTITUDE per sample that are made beforehand.

    Once its function alone, once as its graphing tools call it, by an expression over the messages.
    """
    from pymavlink import mavextra as theirs
    from pymavlink import mavutil

    raw = [SimpleNamespace(xmag=f[0], ymag=f[1], zmag=f[2]) for f in field.tolist()]
    tilts = [(math.atan2(-a[1], -a[2]), math.atan2(a[0], math.hypot(a[1], a[2]))) for a in acc.tolist()]
    attitude = [SimpleNamespace(roll=roll, pitch=pitch, yaw=0.0) for roll, pitch in tilts]

    def function() -> list[float]:
        return [theirs.mag_heading(r, a, declination=0.0) for r, a in zip(raw, attitude, strict=True)]

    def expression() -> None:
        words = "mag_heading(RAW_IMU,ATTITUDE,0)"
        for r, a in zip(raw, attitude, strict=True):
            mavutil.evaluate_expression(words, {"RAW_IMU": r, "ATTITUDE": a})

    check_agreement(textbook(field, acc), np.radians(function()))
    return {
        "pymavlink mavextra.mag_heading": (function, len(raw)),
        "the same as mavgraph's expression": (expression, len(raw)),
    }


def check_agreement(a: Array, b: Array) -> None:
    """Stop where two ways to the same heading disagree: then their times mean nothing."""
    apart = float(np.abs(np.mod(a - b + np.pi, 2.0 * np.pi) - np.pi).max())
    if apart > 1e-9:
        raise AssertionError(f"headings disagree by {apart} rad")


def rates(works: dict[str, tuple[Callable[[], object], int]], rounds: int = ROUNDS) -> dict[str, float]:
    """Return samples per second of each work, best of several rounds in turns."""
    best = dict.fromkeys(works, math.inf)
    for _ in range(rounds):
        for name, (work, _) in works.items():
            began = time.process_time()
            work()
            best[name] = min(best[name], time.process_time() - began)
    return {name: works[name][1] / seconds for name, seconds in best.items()}


if __name__ == "__main__":
    main()
