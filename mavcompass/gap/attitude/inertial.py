"""Faults of gyro and accelerometer that show against the autopilot's attitude and the receiver, not in the
field.

An attitude filter with a receiver estimates the biases of its sensors, so that its attitude turns as the
vehicle does. The mean of what the gyro says less the rate of that attitude is the gyro's bias, the mean of
what the accelerometer feels less gravity and the receiver's acceleration is the accelerometer's. Every
sensor has some: a fault is what the vehicle did not have when it was good.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np

from mavcompass.frames import FloatArray, euler_to_matrix, rotate_back
from mavcompass.gap.attitude.reference import body_rate
from mavcompass.gap.result import Cause
from mavcompass.track import Series, Track
from mavcompass.units import STANDARD_GRAVITY_MPS2

# What differs from one good flight to the next: 0.7 degrees a second, a fortieth of g.
_LEAST = {"gyro_bias": 0.012, "accel_bias": 0.25}
_SIGMAS = 6.0
_FEWEST, _BLOCKS = 200, 12
_SMOOTHED_S = 0.5
# Between attitudes farther apart a tilting vehicle turns in ways that their difference does not show.
_SLOWEST_S = 0.06


@dataclass(frozen=True, slots=True, eq=False)
class Bias:
    """Hold a mean difference (3,) and its standard deviation as blocks of the recording contradict each
    other."""

    mean: FloatArray
    sigma: FloatArray


def inertial_faults(track: Track, baseline: Track) -> tuple[Cause, ...]:
    """Name the biases of gyro and accelerometer that the vehicle did not have in its baseline."""
    now, before = _biases(track), _biases(baseline)
    found = []
    for effect, bias in now.items():
        if effect not in before:
            continue
        change = bias.mean - before[effect].mean
        sigma = np.hypot(bias.sigma, before[effect].sigma)
        if not (np.abs(change) > np.maximum(_SIGMAS * sigma, _LEAST[effect])).any():
            continue
        values = dict(zip("xyz", change.tolist(), strict=True))
        ends = {
            n: (v - 1.96 * s, v + 1.96 * s) for (n, v), s in zip(values.items(), sigma.tolist(), strict=True)
        }
        found.append(Cause(effect, values, ends, 1.0, ()))
    return tuple(found)


def without_faults(track: Track, faults: tuple[Cause, ...]) -> Track:
    """Take known biases out of a recording's gyro and accelerometer, so that its attitude can be found."""
    for fault in faults:
        bias = np.array([fault.parameters[axis] for axis in "xyz"])
        if fault.effect == "gyro_bias" and track.gyro_radps is not None:
            gyro = Series.of(track.gyro_radps.time_s, track.gyro_radps.values - bias)
            track = replace(track, gyro_radps=gyro)
        elif fault.effect == "accel_bias" and track.acc_mps2 is not None:
            acc = Series.of(track.acc_mps2.time_s, track.acc_mps2.values - bias)
            track = replace(track, acc_mps2=acc)
    # The filter that was fed with them no longer is a witness.
    return replace(track, attitude_rad=None) if faults else track


def _biases(track: Track) -> dict[str, Bias]:
    attitude = track.attitude_rad
    if (
        attitude is None
        or len(attitude) < _FEWEST
        or track.gyro_radps is None
        or len(track.gyro_radps) < _FEWEST
    ):
        return {}
    when, first = np.unique(attitude.time_s, return_index=True)
    if float(np.median(np.diff(when))) > _SLOWEST_S:
        return {}
    roll, pitch, yaw = attitude.values[first].T
    rotation = euler_to_matrix(roll, pitch, np.unwrap(yaw))
    out = {"gyro_bias": _mean(track.gyro_radps.at(when) - body_rate(when, rotation))}
    acceleration = _acceleration(track, when)
    if acceleration is not None and track.acc_mps2 is not None:
        force = rotate_back(rotation, acceleration - np.array([0.0, 0.0, STANDARD_GRAVITY_MPS2]))
        out["accel_bias"] = _mean(track.acc_mps2.at(when) - force)
    return out


def _acceleration(track: Track, when: FloatArray) -> FloatArray | None:
    """Return the receiver's acceleration in NED at some times, (N, 3), its velocity smoothed a little."""
    velocity = track.gps_velocity_mps
    if velocity is None or len(velocity) < _FEWEST // 4:
        return None
    width = max(1, round(_SMOOTHED_S / max(float(np.median(np.diff(when))), 1e-3)))
    kernel = np.ones(width) / width
    smooth = np.stack(
        [np.convolve(v, kernel, mode="same") for v in np.nan_to_num(velocity.at(when)).T], axis=1
    )
    out = np.gradient(smooth, when, axis=0)
    out[: 2 * width] = out[-2 * width :] = 0.0
    return np.asarray(out)


def _mean(values: FloatArray) -> Bias:
    values = values[np.isfinite(values).all(axis=1)]
    parts = np.array([part.mean(axis=0) for part in np.array_split(values, _BLOCKS) if len(part)])
    return Bias(values.mean(axis=0), parts.std(axis=0) / math.sqrt(max(len(parts) - 1, 1)))
