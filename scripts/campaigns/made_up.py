"""Vehicles made up by seed for the Monte Carlo tables: their irons, their troubles, what is true of them."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from campaign import borrow
from scipy.signal import lfilter

from mavcompass.correction import FieldCorrection
from mavcompass.earth_field import EarthField
from mavcompass.frames import FloatArray, wrap_pi
from mavcompass.heading.compute import level_heading

borrow("calibration")
from calibration_worlds import Iron, body_field, heading_errors  # noqa: E402

EARTH = EarthField((200.0 * math.cos(0.2), 200.0 * math.sin(0.2), -430.0))
GYRO_S, ROCKS_IN_S = 0.02, 0.5
CIRCLE = np.arange(72) * (2.0 * math.pi / 72)


@dataclass(frozen=True)
class Scenario:
    """What a run is made of; angles in degrees, fields in milligauss."""

    about: str
    positions: int = 4
    noise: float = 3.0
    samples: int = 50
    step_error: float = 0.0
    gyro_sigma: float = 0.0
    gyro_scale_sigma: float = 0.0
    gyro_bias_sigma: float = 0.0  # degrees per second
    offset: float = 80.0
    offset_of_h: float = 0.0  # instead of `offset`, with the steps closed on the bent compass
    gain: float = 0.06
    cross: float = 0.04
    crossed: float = 0.25  # share of vehicles with cross terms
    tilt: float = 0.0
    tilt_sigma: float = 0.0
    whole_numbers: bool = False
    disturbance: float = 0.0
    current: float = 0.0  # amperes
    motor: float = 0.0  # mG per ampere
    world_model: bool = True


SCENARIOS = {
    "exact steps": Scenario("exact steps, white noise 3 mG", crossed=0.0),
    "wrong steps": Scenario("steps 3 deg rms, gyro 0.3 deg per step", step_error=3.0, gyro_sigma=0.3),
    "bent loop 0.25 H": Scenario(
        "steps closed on the bad compass", offset_of_h=0.25, gyro_sigma=0.3, noise=1.0
    ),
    "bent loop 0.5 H": Scenario(
        "steps closed on the bad compass", offset_of_h=0.5, gyro_sigma=0.3, noise=1.0
    ),
    "whole numbers": Scenario(
        "int16 truncation, noise 0.2 to 2 mG", whole_numbers=True, noise=-1.0, step_error=3.0, gyro_sigma=0.3
    ),
    "tilt": Scenario(
        "ground of 3 deg, tilt known to 0.2 deg",
        tilt=3.0,
        tilt_sigma=0.2,
        step_error=3.0,
        gyro_sigma=0.3,
    ),
    "cross terms": Scenario(
        "soft iron with cross terms of 0.03",
        cross=0.03,
        crossed=1.0,
        gain=0.1,
        step_error=5.0,
        gyro_sigma=0.3,
    ),
    "gyro scale and bias": Scenario(
        "gyro scale 1 %, bias 0.05 deg/s, three positions in ten with 5 stops",
        positions=5,
        gyro_scale_sigma=0.01,
        gyro_bias_sigma=0.05,
        gyro_sigma=0.1,
        step_error=5.0,
    ),
    "disturbance": Scenario(
        "steel of 20 mG rms, each axis, near one position", disturbance=20.0, step_error=3.0, gyro_sigma=0.3
    ),
    "disturbance, 5 stops": Scenario(
        "the same with a fifth stop back at the first heading",
        positions=5,
        disturbance=20.0,
        step_error=3.0,
        gyro_sigma=0.3,
    ),
    "current": Scenario(
        "0 to 10 A of 0.5 mG/A; judged at their mean current",
        current=10.0,
        motor=0.5,
        step_error=3.0,
        gyro_sigma=0.3,
    ),
    "three positions": Scenario("only three positions", positions=3, step_error=5.0, gyro_sigma=0.3),
    "no place": Scenario("no world model", world_model=False, step_error=3.0, gyro_sigma=0.3),
}


def vehicle_of(scenario: Scenario, rng: np.random.Generator) -> Iron:
    spread = 0.0 if scenario.offset_of_h else scenario.gain
    gain = np.diag(1.0 + rng.normal(0.0, 1.0, 3) * spread)
    gain[2, 2] = 0.5 * (gain[0, 0] + gain[1, 1]) + rng.normal() * 0.03
    for pairs in (((0, 1),), ((0, 2), (1, 2))):
        size = scenario.cross * (rng.random() < scenario.crossed)
        for row, column in pairs:
            gain[row, column] = gain[column, row] = rng.normal() * size
    offset = rng.normal(0.0, 1.0, 3) * scenario.offset
    if scenario.offset_of_h:
        angle = rng.uniform(0.0, 2.0 * math.pi)
        size = scenario.offset_of_h * EARTH.horizontal_mgauss
        offset = np.array([size * math.cos(angle), size * math.sin(angle), 20.0 * rng.normal()])
    return Iron(offset, gain)


def headings_of(scenario: Scenario, truth: Iron, rng: np.random.Generator) -> FloatArray:
    k = scenario.positions
    first = rng.uniform(0.0, 2.0 * math.pi)
    nominal = 2.0 * math.pi / k if k != 5 else math.pi / 2.0
    if not scenario.offset_of_h:
        turns = nominal + np.radians(rng.normal(0.0, 1.0, k - 1) * scenario.step_error)
        return first + np.concatenate([[0.0], np.cumsum(turns)])
    # The autopilot turns until its bent compass has moved by 90 degrees.
    fine = np.linspace(0.0, 2.0 * math.pi, 3601)
    shown = level_heading(truth.raw(body_field(fine, earth=EARTH)))
    wanted = first + nominal * np.arange(k)
    nearest = np.array([fine[np.argmin(np.abs(wrap_pi(shown - w)))] for w in wanted])
    return np.asarray(nearest[0] + np.concatenate([[0.0], np.cumsum(np.mod(np.diff(nearest), 2 * math.pi))]))


def errors_deg(correction: FieldCorrection, truth: Iron) -> FloatArray:
    """Return the level heading errors on the circle, (72,)."""
    return heading_errors(correction, truth, earth=EARTH)


def rocking(count: int, sigma_rad: float, rng: np.random.Generator) -> FloatArray:
    """Return an error of the tilt whose mean over 5 s is `sigma_rad`."""
    memory = math.exp(-GYRO_S / ROCKS_IN_S)
    white = rng.normal(0.0, math.sqrt(1.0 - memory**2), count)
    return np.asarray(lfilter([1.0], [1.0, -memory], white)) * sigma_rad / math.sqrt(2.0 * ROCKS_IN_S / 5.0)
