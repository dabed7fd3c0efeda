"""What the autopilot's own attitude tells: what steers its yaw, and other faults.

The smoothed attitude solves for the gyro's bias and scale. An autopilot's filter with a receiver estimates
the bias of the accelerometer, so that its attitude stays level: the mean of what is felt less gravity and
the receiver's acceleration is that bias. Every sensor has some: a fault is what the vehicle did not have
when it was good.
"""

from __future__ import annotations

import math
from dataclasses import replace
from typing import Literal

import numpy as np

from mavcompass.chance import chance_above, chi_square_of
from mavcompass.frames import FloatArray, euler_to_matrix, rotate_back
from mavcompass.gap.attitude.kinematics import integral
from mavcompass.gap.attitude.scatter import Bias, smoothed
from mavcompass.gap.result import Cause
from mavcompass.simulation.effects import detected_by
from mavcompass.simulation.effects.effect import Detector
from mavcompass.simulation.effects.sampling import first_order_lag
from mavcompass.steering import steering_source
from mavcompass.track import Series, Track
from mavcompass.units import STANDARD_GRAVITY_MPS2

Steering = Literal["own", "other", "unknown"]
# How long a filter remembers what a turn has made of its yaw: one of these about, none tells.
TURN_MEMORIES_S = np.array([2.0, 8.0, 32.0])
# Three axes together, in squared sigmas: as improbable as six sigmas on one of three.
_IMPROBABLE = chi_square_of(6.0 * chance_above(6.0), 3)
_FEWEST, _BLOCKS = 200, 12
_SMOOTHED_S = 0.5
_OF_ACCELERATION = 0.02
# Between attitudes farther apart a tilting vehicle turns in ways that their difference does not show.
_SLOWEST_S = 0.125


def told_rotation(attitude_rad: Series, time_s: FloatArray) -> FloatArray:
    """Return the autopilot's attitude (roll, pitch, yaw) at other times, as rotations (N, 3, 3)."""
    when, first = np.unique(attitude_rad.time_s, return_index=True)
    roll, pitch, yaw = attitude_rad.values[first].T
    angles = Series.of(when, np.stack([roll, pitch, np.unwrap(yaw)], axis=1)).at(time_s)
    return euler_to_matrix(*angles.T)


def remembered_turns(time_s: FloatArray, turned_rad: FloatArray) -> FloatArray:
    """Return how far a vehicle has turned (N,) less what a filter forgot of it, for each memory, (N, 3).

    An autopilot integrates the gyro, whose scale s is off, and follows a compass that is late: its yaw errs
    by e' = s w - (e + late w) / T, which is s - late / T times what is returned here.
    """
    turned = turned_rad[:, None]
    forgotten = [first_order_lag(time_s, turned, memory_s)[0] for memory_s in TURN_MEMORIES_S]
    return np.asarray(turned - np.hstack(forgotten))


def steered_by(track: Track, instance: int) -> Steering:
    """Tell from the parameters whether the compass under test steers the autopilot's yaw."""
    source = steering_source(track.autopilot, track.parameters)
    if source is None:
        return "unknown"
    return "own" if source == instance else "other"


def accelerometer_fault(track: Track, baseline: Track) -> tuple[Cause, ...]:
    """Name the bias of the accelerometer that the vehicle did not have in its baseline."""
    return sensor_fault("accelerometer offset", _accelerometer_bias(track), _accelerometer_bias(baseline))


def sensor_fault(shown: Detector, now: Bias | None, before: Bias | None) -> tuple[Cause, ...]:
    """Name the bias of a sensor, or the gyro's gain error, that the vehicle did not have in its baseline."""
    if now is None or before is None:
        return ()
    effect = detected_by(shown)
    change, sigma = now.mean - before.mean, np.hypot(now.sigma, before.sigma)
    if np.abs(change).max() < effect.daily or float(np.sum((change / sigma) ** 2)) < _IMPROBABLE:
        return ()
    values, doubts = (dict(zip("xyz", column.tolist(), strict=True)) for column in (change, sigma))
    return (Cause.told(effect.id, values, doubts),)


def without_fault(track: Track, fault: tuple[Cause, ...]) -> Track:
    """Take a known bias out of a recording's accelerometer, so that its attitude can be found."""
    if not fault or track.acc_mps2 is None:
        return track
    bias = np.array([fault[0].parameters[axis] for axis in "xyz"])
    # The filter that was fed with it no longer is a witness.
    return replace(
        track, acc_mps2=Series.of(track.acc_mps2.time_s, track.acc_mps2.values - bias), attitude_rad=None
    )


def _accelerometer_bias(track: Track) -> Bias | None:
    attitude = track.attitude_rad
    if attitude is None or len(attitude) < _FEWEST or track.acc_mps2 is None:
        return None
    when = np.unique(attitude.time_s)
    acceleration = _acceleration(track, when)
    if acceleration is None or float(np.median(np.diff(when))) > _SLOWEST_S:
        return None
    told = told_rotation(attitude, when)
    values = track.acc_mps2.at(when) - _felt(told, acceleration)
    values = values[np.isfinite(values).all(axis=1)]
    parts = np.array([part.mean(axis=0) for part in np.array_split(values, _BLOCKS) if len(part)])
    # As blocks of the recording contradict each other.
    scatter = parts.std(axis=0) / math.sqrt(max(len(parts) - 1, 1))
    # A filter's level errs as the vehicle accelerates, and a yaw that is off turns the acceleration.
    pushed = math.sqrt(float(np.mean(np.sum(acceleration**2, axis=1))))
    turned = _by_gyro(track, when, told)
    by_yaw = (_felt(turned, acceleration) - _felt(told, acceleration)).mean(axis=0)
    sigma = np.sqrt(scatter**2 + (_OF_ACCELERATION * pushed) ** 2 + by_yaw**2)
    return Bias(values.mean(axis=0), sigma)


def _felt(rotation: FloatArray, acceleration: FloatArray) -> FloatArray:
    """Return what an accelerometer feels in some attitudes, accelerated so in NED, (N, 3)."""
    return rotate_back(rotation, acceleration - np.array([0.0, 0.0, STANDARD_GRAVITY_MPS2]))


def _by_gyro(track: Track, when: FloatArray, told: FloatArray) -> FloatArray:
    """Return the autopilot's attitude with the yaw of the gyro, its mean and drift as told."""
    if track.gyro_radps is None:
        return told
    rate = np.einsum("nij,nj->ni", told, np.nan_to_num(track.gyro_radps.at(when)))
    yaw = np.unwrap(np.arctan2(told[:, 1, 0], told[:, 0, 0]))
    ahead = yaw - integral(when, rate)[:, 2]
    since = when - when.mean()
    return euler_to_matrix(0.0, 0.0, np.polyval(np.polyfit(since, ahead, 1), since) - ahead) @ told


def _acceleration(track: Track, when: FloatArray) -> FloatArray | None:
    """Return the receiver's acceleration in NED at some times, (N, 3), its velocity smoothed a little."""
    velocity = track.gps_velocity_mps
    if velocity is None or len(velocity) < _FEWEST // 4:
        return None
    width = max(1, round(_SMOOTHED_S / max(float(np.median(np.diff(when))), 1e-3)))
    smooth = smoothed(np.nan_to_num(velocity.at(when)), width)
    out = np.gradient(smooth, when, axis=0)
    out[: 2 * width] = out[-2 * width :] = 0.0
    return np.asarray(out)
