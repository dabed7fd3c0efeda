"""The compass, and effects as formulas over it and the flight."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from mavcompass.gap.trial.closed_form.formulas import Array, Flight, rotation_of

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
