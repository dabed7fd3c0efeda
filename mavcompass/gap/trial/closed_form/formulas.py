"""Formulas of the time: attitude, place, loads, with their derivatives."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]


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
