"""The attitude that the diagnosis believes, and how far: never the compass under test.

`columns` is an independent reference (optical, turntable). `gps-yaw` takes the yaw of a dual-antenna
receiver and roll and pitch of gyro and accelerometer. `gyro` integrates the gyro, levels it with the
accelerometer in both directions of time, and leaves the initial yaw and the bias about the vertical to
be solved with the field. `attitude`, the autopilot's own, comes last: its yaw was made from a compass.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from mavcompass.errors import BadRecording
from mavcompass.frames import FloatArray, euler_to_matrix, matrix_to_euler, quaternion_to_matrix
from mavcompass.gap.kinematics import exponentials
from mavcompass.gap.levelling import levelled
from mavcompass.simulation.effects.sampling import at_times
from mavcompass.track import Series, Track

ReferenceKind = Literal["columns", "gps-yaw", "gyro", "attitude"]
Choice = Literal["auto", "gyro", "gps-yaw", "attitude", "columns"]

# Integrating the gyro needs samples closer together than this; slower recordings use ATTITUDE.
SLOWEST_GYRO_S = 0.15
_REMEDY = "Record RAW_IMU or IMU messages at 10 Hz or more, or an attitude (ATTITUDE, ATT)."


@dataclass(frozen=True, slots=True, eq=False)
class Reference:
    """Hold the believed attitude at the times of the magnetometer's readings.

    Attributes:
        kind: where it comes from.
        rotation: body to NED, (N, 3, 3); rate_radps: its body rate, (N, 3).
        known: where there is one, (N,).
        yaw_sigma_rad: a priori standard deviation of a constant yaw error (0: none is solved for).
        drift_sigma_radps: the same of a yaw error that grows evenly.
        bent_sigma_rad: the same of a yaw error that goes with the heading (a compass made the yaw).
        tilt_sigma_rad: what roll and pitch show themselves to be off by; 0 where nothing tells.
        notes: what a reader of the result must know.
    """

    kind: ReferenceKind
    rotation: FloatArray
    rate_radps: FloatArray
    known: NDArray[np.bool_]
    yaw_sigma_rad: float = 0.0
    drift_sigma_radps: float = 0.0
    bent_sigma_rad: float = 0.0
    tilt_sigma_rad: float = 0.0
    notes: tuple[str, ...] = ()


def reference_attitude(track: Track, time_s: FloatArray, choice: Choice = "auto") -> Reference:
    """Choose and build the attitude reference at some times.

    Raises BadRecording where the recording does not hold what the choice needs.
    """
    kind = _automatic(track) if choice == "auto" else choice
    builders = {"columns": _columns, "gps-yaw": _gps_yaw, "gyro": _gyro, "attitude": _attitude}
    reference = builders[kind](track, time_s)
    if reference is None:
        raise BadRecording(f"The recording has nothing for the attitude reference {kind!r}.", _REMEDY)
    return reference


def _automatic(track: Track) -> ReferenceKind:
    if track.reference_q is not None and len(track.reference_q) > 1:
        return "columns"
    gyro_works = (
        track.gyro_radps is not None
        and track.acc_mps2 is not None
        and len(track.gyro_radps) > 20
        and float(np.median(np.diff(track.gyro_radps.time_s))) <= SLOWEST_GYRO_S
    )
    if gyro_works and track.gps_yaw_rad is not None and np.isfinite(track.gps_yaw_rad.values).sum() > 20:
        return "gps-yaw"
    return "gyro" if gyro_works else "attitude"


def _columns(track: Track, time_s: FloatArray) -> Reference | None:
    if track.reference_q is None:
        return None
    finite = np.isfinite(track.reference_q.values).all(axis=1)
    if finite.sum() < 8:
        return None
    clock, q = track.reference_q.time_s[finite], track.reference_q.values[finite]
    q = q / np.linalg.norm(q, axis=1, keepdims=True)
    # A quaternion and its negative are the same attitude: make neighbours agree before interpolating.
    flips = np.cumprod(np.where(np.einsum("ij,ij->i", q[1:], q[:-1]) < 0.0, -1.0, 1.0))
    q[1:] *= flips[:, None]
    wanted = q if clock.size == time_s.size and np.array_equal(clock, time_s) else at_times(clock, q, time_s)
    wanted = wanted / np.linalg.norm(wanted, axis=1, keepdims=True)
    rotation = quaternion_to_matrix(wanted)
    step = float(np.median(np.diff(clock)))
    known = _near(clock, time_s, 2.5 * step)
    return Reference("columns", rotation, body_rate(time_s, rotation), known)


def _near(clock: FloatArray, time_s: FloatArray, within_s: float) -> NDArray[np.bool_]:
    after = np.clip(np.searchsorted(clock, time_s), 1, clock.size - 1)
    distance = np.minimum(np.abs(time_s - clock[after]), np.abs(time_s - clock[after - 1]))
    return np.asarray(distance <= within_s)


def body_rate(time_s: FloatArray, rotation: FloatArray) -> FloatArray:
    """Differentiate rotations (N, 3, 3) to body rates (N, 3), radians per second.

    Five-point central differences of the rotation vectors to the neighbours, whose derivative at zero
    is the rate exactly; the error is of fourth order in the step. The ends use the nearest two.
    """
    n = len(rotation)
    if n < 5:
        return np.zeros((n, 3))
    near = _rotation_vectors(rotation[:-1], rotation[1:]) / np.diff(time_s)[:, None]
    rate = np.vstack([near[:1], 0.5 * (near[:-1] + near[1:]), near[-1:]])
    step = np.diff(time_s)
    even = np.ptp(np.stack([step[:-3], step[1:-2], step[2:-1], step[3:]]), axis=0) < 0.05 * step[1:-2]
    middle = rotation[2:-2]
    vectors = [_rotation_vectors(middle, rotation[2 + j : n - 2 + j]) for j in (-2, -1, 1, 2)]
    span = (time_s[4:] - time_s[:-4])[:, None] / 4.0
    fine = (8.0 * (vectors[2] - vectors[1]) - (vectors[3] - vectors[0])) / (12.0 * span)
    rate[2:-2] = np.where(even[:, None], fine, rate[2:-2])
    return rate


def _rotation_vectors(first: FloatArray, second: FloatArray) -> FloatArray:
    """Return the rotation vectors (N, 3) of first^T second."""
    # Only the antisymmetric part and the trace of the product are needed.
    p = [[np.einsum("ni,ni->n", first[:, :, i], second[:, :, j]) for j in range(3)] for i in range(3)]
    axis = 0.5 * np.stack([p[2][1] - p[1][2], p[0][2] - p[2][0], p[1][0] - p[0][1]], axis=1)
    sine = np.sqrt(np.einsum("ni,ni->n", axis, axis))
    angle = np.arctan2(sine, 0.5 * (p[0][0] + p[1][1] + p[2][2] - 1.0))
    factor = np.where(sine > 1e-9, angle / np.where(sine > 1e-9, sine, 1.0), 1.0)
    return np.asarray(axis * factor[:, None])


def _gyro(track: Track, time_s: FloatArray) -> Reference | None:
    smoothed = levelled(track)
    if smoothed is None:
        return None
    clock = smoothed.clock
    notes = (
        "The attitude is the smoothed gyro and accelerometer; its initial yaw is solved with the field.",
    )
    return Reference(
        "gyro",
        _rotations_at(clock, smoothed.rotation, smoothed.rate_radps, time_s),
        at_times(clock, smoothed.rate_radps, time_s),
        _near(clock, time_s, 3.0 * float(np.median(np.diff(clock)))),
        yaw_sigma_rad=math.radians(60.0),
        drift_sigma_radps=smoothed.drift_sigma_radps,
        tilt_sigma_rad=smoothed.tilt_sigma_rad,
        notes=notes,
    )


def _rotations_at(
    clock: FloatArray, rotation: FloatArray, rate: FloatArray, time_s: FloatArray
) -> FloatArray:
    """Carry rotations to other times with the rate at the nearest sample before."""
    left = np.clip(np.searchsorted(clock, time_s, side="right") - 1, 0, clock.size - 1)
    middle_rate = at_times(clock, rate, 0.5 * (time_s + clock[left]))
    return np.asarray(rotation[left] @ exponentials(middle_rate * (time_s - clock[left])[:, None]))


def _gps_yaw(track: Track, time_s: FloatArray) -> Reference | None:
    smoothed = levelled(track)
    if smoothed is None or track.gps_yaw_rad is None:
        return None
    clock, rotation, rate = smoothed.clock, smoothed.rotation, smoothed.rate_radps
    finite = np.isfinite(track.gps_yaw_rad.values)
    heard, yaw = track.gps_yaw_rad.time_s[finite], np.unwrap(track.gps_yaw_rad.values[finite])
    if heard.size < 8:
        return None
    integrated = np.unwrap(matrix_to_euler(rotation)[2])
    error = yaw - np.interp(heard, clock, integrated)
    error = np.unwrap(error)
    # The integral's error is slow: a running median over ten seconds keeps the receiver's noise out.
    width = max(1, int(10.0 / max(float(np.median(np.diff(heard))), 1e-3)))
    slow = np.array([np.median(error[max(0, i - width) : i + width + 1]) for i in range(error.size)])
    turn = euler_to_matrix(0.0, 0.0, np.interp(clock, heard, slow))
    return Reference(
        "gps-yaw",
        _rotations_at(clock, turn @ rotation, rate, time_s),
        at_times(clock, rate, time_s),
        _near(clock, time_s, 3.0 * float(np.median(np.diff(clock)))),
        yaw_sigma_rad=math.radians(1.0),
        tilt_sigma_rad=smoothed.tilt_sigma_rad,
        notes=(
            "The yaw is that of the two-antenna receiver; a mounting error of about 1 degree is allowed.",
        ),
    )


def _attitude(track: Track, time_s: FloatArray) -> Reference | None:
    if track.attitude_rad is None or len(track.attitude_rad) < 8:
        return None
    series = track.attitude_rad
    clock, first = np.unique(series.time_s, return_index=True)
    roll, pitch, yaw = series.values[first].T
    angles = np.stack([roll, pitch, np.unwrap(yaw)], axis=1)
    interpolated = Series.of(clock, angles).at(time_s)
    rotation = euler_to_matrix(*interpolated.T)
    rate = body_rate(time_s, rotation)
    if track.gyro_radps is not None and len(track.gyro_radps) > 8:
        rate = track.gyro_radps.at(time_s)
    note = (
        "The attitude is the autopilot's own: its roll and pitch are trusted within a degree, its yaw was"
        " made from a compass and may be bent, which is solved for and widens every interval."
    )
    return Reference(
        "attitude",
        rotation,
        rate,
        _near(clock, time_s, 3.0 * float(np.median(np.diff(clock)))),
        yaw_sigma_rad=math.radians(10.0),
        bent_sigma_rad=math.radians(5.0),
        notes=(note,),
    )
