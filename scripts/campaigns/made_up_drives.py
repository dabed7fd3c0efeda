"""Whole recordings of made-up vehicles: dwells of 5 s, turns between them, and an ordinary drive.

Every vehicle has what every vehicle has: a field that lags by 0.03 s, a gyro whose scale is good to 1 % and
whose bias wanders by 0.01 deg/s, a tilt good to 0.02 deg, an accelerometer that is off by 1 mg all along.
"""

from __future__ import annotations

import math
from dataclasses import replace
from itertools import pairwise

import numpy as np
from made_up import GYRO_S, SCENARIOS, Scenario, Truth, headings_of, rocking, vehicle_of

from mavcompass.frames import FloatArray
from mavcompass.track import MagSeries, Series, Track
from mavcompass.units import STANDARD_GRAVITY_MPS2

EVERY = 5
TURN_RADPS = math.radians(30.0)
LAG_S, SCALE, WANDER_RADPS, TILT_RAD = 0.03, 0.01, math.radians(0.01), math.radians(0.02)
ACCELEROMETER_RAD = 0.001
WANDERS_IN_S = 6.0
BASE = SCENARIOS["wrong steps"]
CASES: dict[str, tuple[Scenario, str]] = {
    **{name: (scenario, "stops") for name, scenario in SCENARIOS.items()},
    "drive": (BASE, "drive"),
    "few headings": (BASE, "few"),
    "motors": (replace(BASE, current=20.0, motor=5.0), "drive"),
    "passing magnets": (BASE, "magnets"),
}


def timeline(stops: FloatArray, dwell_s: float) -> tuple[FloatArray, FloatArray]:
    """Return the yaw of a vehicle that goes from stop to stop, and which stop it is at, as a fraction."""
    yaw, place = [np.full(int(dwell_s / GYRO_S), stops[0])], [np.zeros(int(dwell_s / GYRO_S))]
    for k, (a, b) in enumerate(pairwise(stops)):
        count = max(int(1.5 * abs(b - a) / TURN_RADPS / GYRO_S), 2)
        ramp = 0.5 - 0.5 * np.cos(np.linspace(0.0, math.pi, count))
        yaw += [a + (b - a) * ramp, np.full(int(dwell_s / GYRO_S), b)]
        place += [k + ramp, np.full(int(dwell_s / GYRO_S), k + 1.0)]
    return np.concatenate(yaw), np.concatenate(place)


def stops_of(scenario: Scenario, truth: Truth, kind: str, rng: np.random.Generator) -> FloatArray:
    """Draw the headings at which a vehicle stops."""
    if kind == "stops":
        return headings_of(scenario, truth, rng)
    first = rng.uniform(0.0, 2.0 * math.pi)
    if kind == "few":
        return np.asarray(
            first + np.linspace(0.0, math.radians(rng.uniform(100.0, 170.0)), rng.integers(3, 5))
        )
    turns = rng.choice([-1.0, 1.0], 12) * np.radians(rng.uniform(30.0, 150.0, 12))
    return np.asarray(first + np.concatenate([[0.0], np.cumsum(turns)]))


def disturbance(
    scenario: Scenario, kind: str, time: FloatArray, place: FloatArray, rng: np.random.Generator
) -> FloatArray:
    """Return what steel at one stop, or magnets that pass, add to the field, (N, 3)."""
    added = np.zeros((time.size, 3))
    if scenario.disturbance:
        near = np.clip(1.0 - np.abs(place - rng.integers(int(place[-1]) + 1)), 0.0, 1.0) ** 3
        added += near[:, np.newaxis] * rng.normal(0.0, scenario.disturbance, 3)
    for _ in range(int(rng.integers(1, 4)) if kind == "magnets" else 0):
        passing = np.exp(-0.5 * ((time - rng.uniform(0.0, time[-1])) / rng.uniform(0.5, 1.5)) ** 2)
        added += passing[:, np.newaxis] * rng.normal(0.0, 1.0, 3) * rng.uniform(30.0, 120.0)
    return added


def recorded(scenario: Scenario, kind: str, rng: np.random.Generator) -> tuple[Truth, Track]:
    """Make a vehicle and its recording."""
    truth = vehicle_of(scenario, rng)
    stops = stops_of(scenario, truth, kind, rng)
    yaw, place = timeline(stops, 5.0 if kind in ("stops", "few") else 3.0)
    time, at_stop = np.arange(yaw.size) * GYRO_S, np.arange(stops.size)
    roll, pitch = (
        np.interp(place, at_stop, np.radians(rng.normal(0.0, 1.0, stops.size)) * scenario.tilt)
        for _ in range(2)
    )
    raw = truth.raw(yaw, roll, pitch) + disturbance(scenario, kind, time, place, rng)
    current = None
    if scenario.current:
        load = np.interp(place, at_stop, rng.uniform(0.0, scenario.current, stops.size))
        raw += (load - load.mean())[:, np.newaxis] * rng.normal(0.0, scenario.motor, 3)
        current = Series.of(time, load)
    noise = scenario.noise if scenario.noise >= 0.0 else 10.0 ** rng.uniform(-0.7, 0.3)
    readings = raw[::EVERY] + rng.normal(0.0, noise, raw[::EVERY].shape)
    if scenario.whole_numbers:
        readings = np.trunc(readings)
    unknown_tilt = math.hypot(math.radians(scenario.tilt_sigma), TILT_RAD)
    roll, pitch = (
        angle + rng.normal(0.0, ACCELEROMETER_RAD) + rocking(yaw.size, unknown_tilt, rng)
        for angle in (roll, pitch)
    )
    force = np.stack([np.sin(pitch), -np.cos(pitch) * np.sin(roll), -np.cos(pitch) * np.cos(roll)], axis=1)
    compass = MagSeries(
        1,
        Series.of(time[::EVERY], readings),
        quantum_mgauss=float(scenario.whole_numbers),
        truncated=scenario.whole_numbers,
    )
    return truth, Track(
        source="made up",
        autopilot="px4",
        vehicle="rover",
        compasses={1: compass},
        acc_mps2=Series.of(time, STANDARD_GRAVITY_MPS2 * force + rng.normal(0.0, 0.02, force.shape)),
        gyro_radps=Series.of(time, _gyro(scenario, yaw, time, rng)),
        current_a=current,
    )


def _gyro(scenario: Scenario, yaw: FloatArray, time: FloatArray, rng: np.random.Generator) -> FloatArray:
    lagging = np.interp(time + rng.normal(0.0, LAG_S), time, np.gradient(yaw, GYRO_S))
    knots = np.arange(0.0, time[-1] + 2.0 * WANDERS_IN_S, WANDERS_IN_S)
    wander = np.interp(time, knots, np.cumsum(rng.normal(0.0, WANDER_RADPS, knots.size)))
    bias = math.radians(rng.normal(0.0, math.hypot(scenario.gyro_bias_sigma, 0.02))) + wander
    white = math.radians(max(scenario.gyro_sigma, 0.01)) / math.sqrt(8.0 * GYRO_S)
    rate = np.zeros((time.size, 3))
    rate[:, 2] = lagging * (1.0 + rng.normal(0.0, SCALE)) + bias + rng.normal(0.0, white, time.size)
    return rate
