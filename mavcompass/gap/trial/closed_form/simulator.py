"""Make cases: a head, its flight before and its flight with effects, as columns of the contract."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from mavcompass.gap.trial.closed_form.formulas import (
    AXES,
    NAMES,
    NEEDS_TILT,
    Array,
    Flight,
    Head,
    Values,
    quaternion,
    raw_readings,
    sized,
    unit,
    wave,
)

# Latitude, longitude in degrees, altitude in metres, and the field there in the middle of 2026, north, east,
# down, mG (WMM2025).
PLACES = (
    ((47.3977, 8.5456, 488.0), (215.25, 13.58, 433.14)),
    ((-35.3633, 149.1652, 584.0), (230.04, 51.78, -530.77)),
    ((60.17, 24.94, 20.0), (145.24, 26.74, 504.76)),
    ((1.35, 103.82, 15.0), (410.49, 1.62, -93.11)),
)
UTC_S = 1_782_000_000.0
# Sizes of effects: what they change, mG rms per axis.
SMALLEST_MGAUSS, LARGEST_MGAUSS = 3.0, 40.0
_GRAVITY_MPS2 = 9.80665
_METRES_PER_DEG = 111_195.0


@dataclass(frozen=True, slots=True, eq=False)
class Simulated:
    """Hold a recording: columns by their contract names, the receiver's velocity, the truth.

    Attributes:
        time_s: (N,), since boot. columns: each (N,). velocity_mps: north, east, down, (N, 3).
        raw_mgauss, plain_mgauss: the compass without noise, with and without the effects, (N, 3).
        angles_rad: true roll, pitch, yaw, (N, 3).
    """

    time_s: Array
    columns: dict[str, Array]
    velocity_mps: Array
    raw_mgauss: Array
    plain_mgauss: Array
    angles_rad: Array
    place: tuple[float, float, float]


@dataclass(frozen=True, slots=True, eq=False)
class Made:
    """Hold a case: the flight with effects, a flight before without, the effects, what it is like."""

    flight: Simulated
    baseline: Simulated
    effects: tuple[tuple[str, dict[str, float]], ...]
    words: str


def _head(rng: np.random.Generator) -> Head:
    place, field_mgauss = PLACES[rng.integers(len(PLACES))]
    anomaly = 0.004 * np.linalg.norm(field_mgauss) * unit(rng)
    cross = 0.02 * rng.standard_normal((3, 3))
    return Head(
        place=place,
        field_mgauss=np.array(field_mgauss) + anomaly,
        matrix=np.diag(1.0 + rng.uniform(-0.06, 0.06, 3)) + 0.5 * (cross + cross.T),
        iron_mgauss=rng.uniform(20.0, 150.0) * unit(rng),
        current_field=rng.uniform(0.0, 0.3) * unit(rng),
        noise_mgauss=float(rng.uniform(0.8, 3.0)),
        acc_noise=float(rng.uniform(0.02, 0.08)),
        gyro_noise=float(rng.uniform(0.001, 0.004)),
        gyro_bias=0.002 * rng.standard_normal(3),
        acc_bias=0.03 * rng.standard_normal(3),
        tilts=bool(rng.random() < 0.6),
        reference=bool(rng.random() < 0.5),
        rate_hz=float(rng.choice([20.0, 25.0])),
    )


def _flight(rng: np.random.Generator, head: Head) -> Flight:
    tilt = np.radians(rng.uniform(10.0, 22.0) if head.tilts else rng.uniform(0.3, 1.5))
    turning = float(rng.choice([-1.0, 1.0]) * rng.uniform(0.1, 0.35))
    roll, pitch = (wave(rng, tilt, 5.0, 20.0, offset=float(np.radians(rng.normal(0.0, 0.5)))) for _ in "rp")
    yaw = wave(rng, 0.5, 8.0, 30.0, offset=float(rng.uniform(0.0, 6.28)), rate=turning)
    north, east = (wave(rng, rng.uniform(1.5, 6.0), 12.0, 40.0) for _ in "ne")
    return Flight(
        duration_s=float(rng.uniform(80.0, 150.0)),
        angles=(roll, pitch, yaw),
        way=(north, east, wave(rng, 0.4, 10.0, 30.0, offset=-5.0)),
        throttle=wave(rng, 0.15, 4.0, 20.0, offset=0.45),
        warming_degc=float(rng.uniform(6.0, 14.0)),
        ambient_degc=float(rng.uniform(5.0, 30.0)),
        attitude_error=tuple(  # type: ignore[arg-type]
            wave(rng, np.radians(size), 15.0, 60.0) for size in (0.15, 0.15, 0.4)
        ),
    )


def _recorded(
    head: Head, flight: Flight, effects: Mapping[str, Values], rng: np.random.Generator
) -> Simulated:
    """Write a flight down as a Track CSV would hold it."""
    t = np.arange(round(flight.duration_s * head.rate_hz)) / head.rate_hz
    n = t.size
    raw, plain = raw_readings(head, flight, t, effects), raw_readings(head, flight, t, {})
    noise = head.noise_mgauss
    if "noise_excess" in effects:
        noise = float(np.hypot(noise, effects["noise_excess"]["sigma_mgauss"]))
    rotation = flight.rotation(t)
    force = np.einsum("nij,ni->nj", rotation, flight.position(t, 2) - [0.0, 0.0, _GRAVITY_MPS2])
    angles = np.stack([angle.at(t) for angle in flight.angles], axis=1)
    believed = angles + np.stack([error.at(t) for error in flight.attitude_error], axis=1)
    mag = raw + noise * rng.standard_normal((n, 3))
    acc = force + head.acc_bias + head.acc_noise * rng.standard_normal((n, 3))
    gyro = flight.rate(t) + head.gyro_bias + head.gyro_noise * rng.standard_normal((n, 3))
    columns = {f"mag_{a}_mgauss": mag[:, i] for i, a in enumerate(AXES)}
    columns |= {f"acc_{a}_mps2": acc[:, i] for i, a in enumerate(AXES)}
    columns |= {f"gyro_{a}_radps": gyro[:, i] for i, a in enumerate(AXES)}
    names = ("roll_rad", "pitch_rad", "yaw_rad")
    columns |= {name: believed[:, i] for i, name in enumerate(names)}
    if head.reference:
        columns |= dict(zip(("ref_qw", "ref_qx", "ref_qy", "ref_qz"), quaternion(angles), strict=True))
    place = flight.position(t) + 0.01 * rng.standard_normal((n, 3))
    latitude, longitude, altitude = head.place
    columns |= {
        "pos_n_m": place[:, 0],
        "pos_e_m": place[:, 1],
        "pos_d_m": place[:, 2],
        "lat_deg": latitude + place[:, 0] / _METRES_PER_DEG,
        "lon_deg": longitude + place[:, 1] / (_METRES_PER_DEG * np.cos(np.radians(latitude))),
        "alt_m": altitude - place[:, 2],
        "current_a": flight.current(t) + 0.05 * rng.standard_normal(n),
        "throttle": flight.load(t),
        "temperature_degc": flight.temperature(t),
    }
    velocity = flight.position(t, 1) + 0.03 * rng.standard_normal((n, 3))
    return Simulated(t, columns, velocity, raw, plain, angles, head.place)


def make(seed: int, count: int) -> Made:
    """Make a case with so many effects; the same seed gives the same."""
    rng = np.random.default_rng([seed, 3, count])
    head = _head(rng)
    flight, before = _flight(rng, head), _flight(rng, head)
    effects: dict[str, dict[str, float]] = {}
    while len(effects) < count:
        name = str(rng.choice(NAMES))
        wanted = float(np.exp(rng.uniform(np.log(SMALLEST_MGAUSS), np.log(LARGEST_MGAUSS))))
        if name in effects or (name in NEEDS_TILT and not (head.tilts and head.reference)):
            continue
        values = sized(name, rng, head, flight, wanted)
        if values is not None:
            effects[name] = values
    made = _recorded(head, flight, effects, rng)
    base = _recorded(head, before, {}, rng)
    words = f"{'tilting' if head.tilts else 'level'}{', attitude logged' if head.reference else ''}"
    return Made(made, base, tuple(effects.items()), words)
