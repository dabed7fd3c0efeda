"""Another simulator: recordings in closed form, by code that shares nothing with this one but the contract.

It imports numpy alone. What it yields are the columns of a Track CSV by their contract names, and effects by
the catalogue's ids and units. Attitude, place, field and loads are formulas of the time, and so are their
derivatives: nothing is integrated, filtered or interpolated, and a late reading is the formula at an earlier
time.

    raw(t) = S (f(t)) + b + c I(t) + k (T(t) - T0),   f = (Rz(psi) Ry(theta) Rx(phi))^T B(p(t))

A compass head that is carried about: yaw, pitch and roll are sums of sines beside a steady turn, its place a
Lissajous figure; the autopilot's attitude is the true one with slow sines of its own.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
Values = Mapping[str, float]
AXES = ("x", "y", "z")
NAMES = (
    "hard_iron", "hard_iron_step", "soft_iron", "axis_scale", "motor_current", "temperature_bias",
    "transport_lag", "noise_excess", "spatial_dipole", "field_intensity", "inclination", "declination",
)  # fmt: skip
# What a level head, or one without a logged attitude, does not show.
NEEDS_TILT = frozenset({"soft_iron", "declination"})
_SYMMETRIC = {"xx": (0, 0), "yy": (1, 1), "zz": (2, 2), "xy": (0, 1), "xz": (0, 2), "yz": (1, 2)}
_ALWAYS_S = 1e7
_FIXED = frozenset({"reference_degc", "on_s", "off_s", "north_m", "east_m", "down_m"})
_MOST = {"transport_lag": 0.45, "field_intensity": 0.4, "inclination": 0.3, "declination": 0.5}


@dataclass(frozen=True, slots=True, eq=False)
class Wave:
    """Hold q(t) = offset + rate t + sum of a sin(w t + p): a quantity with all its derivatives."""

    offset: float
    rate: float
    amplitude: Array
    frequency: Array
    phase: Array

    def at(self, t: Array, order: int = 0) -> Array:
        """Return the quantity, (N,), or its first or second derivative."""
        turned = np.multiply.outer(t, self.frequency) + self.phase + 0.5 * np.pi * order
        waves = np.sin(turned) @ (self.amplitude * self.frequency**order)
        steady = (self.offset + self.rate * t, np.full(t.size, self.rate), np.zeros(t.size))[order]
        return np.asarray(steady + waves)


def wave(
    rng: np.random.Generator,
    size: float,
    fastest_s: float,
    slowest_s: float,
    offset: float = 0.0,
    rate: float = 0.0,
) -> Wave:
    """Draw three sines between two periods, of an rms."""
    frequency = 2.0 * np.pi / np.exp(rng.uniform(np.log(fastest_s), np.log(slowest_s), 3))
    amplitude = size * np.sqrt(2.0 / 3.0) * rng.uniform(0.7, 1.3, 3)
    return Wave(offset, rate, amplitude, frequency, rng.uniform(0.0, 2.0 * np.pi, 3))


@dataclass(frozen=True, slots=True, eq=False)
class Flight:
    """Hold a recording's formulas: angles (roll, pitch, yaw), way (north, east, down), throttle, errors."""

    duration_s: float
    angles: tuple[Wave, Wave, Wave]
    way: tuple[Wave, Wave, Wave]
    throttle: Wave
    warming_degc: float
    ambient_degc: float
    attitude_error: tuple[Wave, Wave, Wave]

    def rotation(self, t: Array) -> Array:
        """Return body-to-world rotations, (N, 3, 3)."""
        roll, pitch, yaw = (wave.at(t) for wave in self.angles)
        return rotation_of(roll, pitch, yaw)

    def rate(self, t: Array) -> Array:
        """Return the body's angular rate, (N, 3): p = phi' - psi' sin(theta) and so on."""
        roll, pitch, _ = (wave.at(t) for wave in self.angles)
        d_roll, d_pitch, d_yaw = (wave.at(t, 1) for wave in self.angles)
        return np.stack(
            [
                d_roll - d_yaw * np.sin(pitch),
                d_pitch * np.cos(roll) + d_yaw * np.sin(roll) * np.cos(pitch),
                d_yaw * np.cos(roll) * np.cos(pitch) - d_pitch * np.sin(roll),
            ],
            axis=1,
        )

    def position(self, t: Array, order: int = 0) -> Array:
        """Return the place north, east, down, (N, 3), its velocity or its acceleration."""
        return np.stack([wave.at(t, order) for wave in self.way], axis=1)

    def load(self, t: Array) -> Array:
        """Return the throttle, (N,), 0 to 1."""
        return np.clip(self.throttle.at(t), 0.02, 1.0)

    def current(self, t: Array) -> Array:
        """Return the battery current, (N,), amperes."""
        return np.asarray(0.8 + 26.0 * self.load(t) ** 1.5)

    def temperature(self, t: Array) -> Array:
        """Return the sensor's temperature, (N,), degC."""
        return np.asarray(self.ambient_degc + self.warming_degc * (1.0 - np.exp(-t / 70.0)))


def rotation_of(roll: Array, pitch: Array, yaw: Array) -> Array:
    """Write Rz(yaw) Ry(pitch) Rx(roll) out, (N, 3, 3)."""
    a, b, c, d, e, f = (g(v) for v in (roll, pitch, yaw) for g in (np.sin, np.cos))
    rows = [
        [d * f, a * c * f - b * e, b * c * f + a * e],
        [d * e, a * c * e + b * f, b * c * e - a * f],
        [-c, a * d, b * d],
    ]
    return np.stack([np.stack(row, axis=1) for row in rows], axis=1)


def quaternion(angles: Array) -> tuple[Array, Array, Array, Array]:
    """Write the quaternion of roll, pitch, yaw (N, 3) out, scalar first."""
    s, c = np.sin(0.5 * angles).T, np.cos(0.5 * angles).T
    return (
        c[0] * c[1] * c[2] + s[0] * s[1] * s[2],
        s[0] * c[1] * c[2] - c[0] * s[1] * s[2],
        c[0] * s[1] * c[2] + s[0] * c[1] * s[2],
        c[0] * c[1] * s[2] - s[0] * s[1] * c[2],
    )


@dataclass(frozen=True, slots=True, eq=False)
class Head:
    """Hold a vehicle: its compass and how it errs.

    Attributes:
        place: degrees and metres; field_mgauss: the true field there (3,).
        matrix, iron_mgauss, current_field: raw = matrix f + iron + current_field I.
        noise_mgauss, acc_noise, gyro_noise: of one reading. gyro_bias, acc_bias: (3,).
        tilts: whether it is tilted by more than a few degrees. reference: whether the attitude is logged.
        rate_hz: of all columns.
    """

    place: tuple[float, float, float]
    field_mgauss: Array
    matrix: Array
    iron_mgauss: Array
    current_field: Array
    noise_mgauss: float
    acc_noise: float
    gyro_noise: float
    gyro_bias: Array
    acc_bias: Array
    tilts: bool
    reference: bool
    rate_hz: float


def _vector(values: Values) -> Array:
    return np.array([values[axis] for axis in AXES])


def _world(head: Head, flight: Flight, t: Array, effects: Mapping[str, Values]) -> Array:
    """Return the field at the sensor's place, north, east, down, (N, 3)."""
    out = np.tile(head.field_mgauss, (t.size, 1))
    if "declination" in effects:
        angle = effects["declination"]["angle_rad"]
        out = out @ rotation_of(*(np.array([v]) for v in (0.0, 0.0, angle)))[0].T
    if "inclination" in effects:
        level, down = np.hypot(out[:, 0], out[:, 1]), out[:, 2]
        dip = np.arctan2(down, level) + effects["inclination"]["angle_rad"]
        size = np.hypot(level, down)
        out = np.stack([out[:, 0] / level * size * np.cos(dip), out[:, 1] / level * size * np.cos(dip),
                        size * np.sin(dip)], axis=1)  # fmt: skip
    if "field_intensity" in effects:
        out = out * (1.0 + effects["field_intensity"]["fraction"])
    if "spatial_dipole" in effects:
        v = effects["spatial_dipole"]
        away = flight.position(t) - np.array([v["north_m"], v["east_m"], v["down_m"]])
        moment = np.array([v["moment_north"], v["moment_east"], v["moment_down"]])
        r = np.linalg.norm(away, axis=1)[:, None]
        out = out + 3.0 * away * (away @ moment)[:, None] / r**5 - moment / r**3
    return out


def raw_readings(head: Head, flight: Flight, t: Array, effects: Mapping[str, Values]) -> Array:
    """Return what the compass would say without noise, (N, 3)."""
    if "transport_lag" in effects:
        late = {name: values for name, values in effects.items() if name != "transport_lag"}
        return raw_readings(head, flight, t - effects["transport_lag"]["lag_s"], late)
    body = np.einsum("nij,ni->nj", flight.rotation(t), _world(head, flight, t, effects))
    if "soft_iron" in effects:
        stretch = np.eye(3)
        for name, (i, j) in _SYMMETRIC.items():
            stretch[i, j] = stretch[j, i] = (i == j) + effects["soft_iron"][name]
        body = body @ stretch.T
    body = body @ head.matrix.T
    if "axis_scale" in effects:
        body = body * (1.0 + _vector(effects["axis_scale"]))
    out = body + head.iron_mgauss + flight.current(t)[:, None] * head.current_field
    if "hard_iron" in effects:
        out = out + _vector(effects["hard_iron"])
    if "hard_iron_step" in effects:
        values = effects["hard_iron_step"]
        out = out + np.outer((t >= values["on_s"]) & (t < values["off_s"]), _vector(values))
    if "motor_current" in effects:
        out = out + flight.current(t)[:, None] * _vector(effects["motor_current"])
    if "temperature_bias" in effects:
        values = effects["temperature_bias"]
        above = flight.temperature(t) - values["reference_degc"]
        out = out + above[:, None] * _vector(values)
    return np.asarray(out)


def unit(rng: np.random.Generator, count: int = 3) -> Array:
    vector = rng.standard_normal(count)
    return np.asarray(vector / np.linalg.norm(vector))


def _directed(rng: np.random.Generator, names: tuple[str, ...], size: float) -> dict[str, float]:
    return dict(zip(names, (size * unit(rng, len(names))).tolist(), strict=True))


def _drawn(name: str, rng: np.random.Generator, head: Head, flight: Flight) -> dict[str, float]:
    """Draw an effect of some size and direction; `_sized` then makes it as large as wanted."""
    sign = float(rng.choice([-1.0, 1.0]))
    match name:
        case "hard_iron" | "motor_current" | "axis_scale":
            return _directed(rng, AXES, {"hard_iron": 20.0, "motor_current": 1.0, "axis_scale": 0.05}[name])
        case "soft_iron":
            return _directed(rng, tuple(_SYMMETRIC), 0.06)
        case "temperature_bias":
            return {**_directed(rng, AXES, 2.0), "reference_degc": flight.ambient_degc}
        case "hard_iron_step":
            on = float(rng.uniform(0.2, 0.6) * flight.duration_s)
            return {**_directed(rng, AXES, 30.0), "on_s": on, "off_s": _ALWAYS_S}
        case "spatial_dipole":
            near = flight.position(np.array([rng.uniform(0.2, 0.8) * flight.duration_s]))[0]
            source = near + np.array([*rng.uniform(-1.5, 1.5, 2), rng.uniform(0.6, 1.5)])
            places = dict(zip(("north_m", "east_m", "down_m"), source.tolist(), strict=True))
            moment = _directed(rng, ("moment_north", "moment_east", "moment_down"), 40.0)
            return {**places, **moment, "on_s": -_ALWAYS_S, "off_s": _ALWAYS_S}
        case "transport_lag":
            return {"lag_s": 0.15}
        case "noise_excess":
            return {"sigma_mgauss": 8.0}
        case "field_intensity":
            return {"fraction": sign * 0.05}
        case _:
            return {"angle_rad": sign * 0.05}


def sized(
    name: str, rng: np.random.Generator, head: Head, flight: Flight, wanted: float
) -> dict[str, float] | None:
    """Draw an effect that changes the readings by so much, rms per axis; None where that would be absurd."""
    values = _drawn(name, rng, head, flight)
    if name == "noise_excess":
        return {"sigma_mgauss": wanted}
    t = np.linspace(0.0, flight.duration_s, 400)
    plain = raw_readings(head, flight, t, {})
    for _ in range(6):
        change = float(np.sqrt(np.mean((raw_readings(head, flight, t, {name: values}) - plain) ** 2)))
        if change <= 0.0:
            return None
        factor = wanted / change
        values = {key: v if key in _FIXED else v * factor for key, v in values.items()}
        if name in _MOST and max(abs(v) for v in values.values()) > _MOST[name]:
            return None
        if abs(factor - 1.0) < 0.02:
            return values
    return None


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
