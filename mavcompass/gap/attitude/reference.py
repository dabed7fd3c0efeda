"""The attitude that the diagnosis believes, and how far: never the compass under test.

`columns` is an independent reference (optical, turntable). Otherwise the attitude is `fused`: the integrated
gyro, levelled with the accelerometer and the autopilot's roll and pitch, its yaw smoothed with every witness
that is independent of the compass under test: a two-antenna receiver, and the autopilot's yaw where another
compass steers it. What no witness tells (the constant, the drift) is left to be solved with the field.
`gyro`, `gps-yaw` and `attitude` take one source alone; `attitude` is also what remains where the gyro was
recorded too slowly.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field, replace
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from mavcompass.errors import BadRecording
from mavcompass.frames import FloatArray, euler_to_matrix, matrix_to_euler, quaternion_to_matrix
from mavcompass.gap.attitude.kinematics import exponentials
from mavcompass.gap.attitude.levelling import levelled
from mavcompass.gap.attitude.steering import steered_by
from mavcompass.gap.attitude.yaw import Witness, age_of, smoothed
from mavcompass.simulation.effects.sampling import at_times
from mavcompass.track import Series, Track

ReferenceKind = Literal["columns", "fused", "gps-yaw", "gyro", "attitude"]
Choice = Literal["auto", "gyro", "gps-yaw", "attitude", "columns"]

# Integrating the gyro needs samples closer together than this; slower recordings use ATTITUDE.
SLOWEST_GYRO_S = 0.15
# A constant of the yaw that may be off by more has no witness.
UNKNOWN_YAW_RAD = 0.3
_FEWEST = 20
_UNKNOWN_YAW_RAD = math.radians(60.0)
# What the level of a good attitude filter is off by.
_TILT_SIGMA_RAD = math.radians(0.3)
_REMEDY = "Record RAW_IMU or IMU messages at 10 Hz or more, or an attitude (ATTITUDE, ATT)."


@dataclass(frozen=True, slots=True, eq=False)
class Reference:
    """Hold the believed attitude at the times of the magnetometer's readings.

    Attributes:
        kind: where it comes from.
        rotation: body to NED, (N, 3, 3); rate_radps: its body rate, (N, 3).
        known: where there is one, (N,).
        yaw_sigma_rad: a priori standard deviation of a constant yaw error (0: none is solved for).
        yaw_curves_rad: what else the yaw may be off by, (N, k): each column has a standard normal amplitude.
        tilt_sigma_rad: what roll and pitch show themselves to be off by; 0 where nothing tells.
        notes: what a reader of the result must know.
    """

    kind: ReferenceKind
    rotation: FloatArray
    rate_radps: FloatArray
    known: NDArray[np.bool_]
    yaw_sigma_rad: float = 0.0
    yaw_curves_rad: FloatArray = field(default_factory=lambda: np.zeros((0, 0)))
    tilt_sigma_rad: float = 0.0
    notes: tuple[str, ...] = ()

    @property
    def yaw_unknown(self) -> bool:
        """Tell whether nothing but the compass itself fixes the constant of the yaw."""
        return self.yaw_sigma_rad > UNKNOWN_YAW_RAD

    def at(self, rows: slice) -> Reference:
        """Return the reference at some of its times."""
        curves = self.yaw_curves_rad[rows] if self.yaw_curves_rad.size else self.yaw_curves_rad
        return replace(
            self, rotation=self.rotation[rows], rate_radps=self.rate_radps[rows], known=self.known[rows],
            yaw_curves_rad=curves,
        )  # fmt: skip


def reference_attitude(
    track: Track, time_s: FloatArray, choice: Choice = "auto", instance: int = 1
) -> Reference:
    """Choose and build the attitude reference of one compass at some times.

    Raises BadRecording where the recording does not hold what the choice needs.
    """
    if choice == "columns" or (
        choice == "auto" and track.reference_q is not None and len(track.reference_q) > 1
    ):
        reference = _columns(track, time_s)
    elif choice == "attitude" or (choice == "auto" and not _gyro_is_fast(track)):
        reference = _attitude(track, time_s, instance)
    else:
        reference = _fused(track, time_s, choice, instance)
    if reference is None:
        raise BadRecording(f"The recording has nothing for the attitude reference {choice!r}.", _REMEDY)
    return reference


def _gyro_is_fast(track: Track) -> bool:
    return (
        track.gyro_radps is not None
        and track.acc_mps2 is not None
        and len(track.gyro_radps) > _FEWEST
        and float(np.median(np.diff(track.gyro_radps.time_s))) <= SLOWEST_GYRO_S
    )


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


def _fused(track: Track, time_s: FloatArray, choice: Choice, instance: int) -> Reference | None:
    """Integrate the gyro, level it, and smooth its yaw with the witnesses that the choice allows."""
    integral = levelled(track)
    if integral is None:
        return None
    clock, rotation = integral.clock, integral.rotation
    autopilot = _autopilot_rotation(track, clock) if choice == "auto" else None
    tilt_sigma = integral.tilt_sigma_rad
    if autopilot is not None:
        rotation, tilt_sigma = _levelled_by_both(rotation, autopilot, tilt_sigma)
    told, witnesses = [], []
    if choice in ("auto", "gps-yaw") and (witness := _receiver_witness(track, clock, rotation)) is not None:
        witnesses.append(witness)
        told.append("the two-antenna receiver")
    if choice == "gps-yaw" and not witnesses:
        return None
    if autopilot is not None and steered_by(track, instance) == "other":
        witnesses.append(_autopilot_witness(clock, rotation, autopilot))
        told.append("the autopilot's yaw, which another compass steers")
    turning = np.einsum("ni,ni->n", integral.rate_radps, rotation[:, 2])
    yaw = _integral(clock, turning)
    age = None
    if autopilot is not None:
        # Whatever steers the autopilot's yaw, it turns when the vehicle turns.
        age = age_of(clock, turning, clock, yaw + _ahead(rotation, autopilot))
    error = smoothed(clock, yaw, integral.drift_sigma_radps, witnesses, _UNKNOWN_YAW_RAD, age)
    turned = _turned_about_down(rotation, error.mean_rad)
    by = f"; its yaw follows {' and '.join(told)}" if told else "; its initial yaw is solved with the field"
    return Reference(
        "fused" if choice == "auto" else choice,
        _rotations_at(clock, turned, integral.rate_radps, time_s),
        at_times(clock, integral.rate_radps, time_s),
        _near(clock, time_s, 3.0 * float(np.median(np.diff(clock)))),
        yaw_sigma_rad=error.constant_sigma_rad,
        yaw_curves_rad=np.stack([np.interp(time_s, clock, c) for c in error.curves_rad.T], axis=1)
        if error.curves_rad.size
        else np.zeros((0, 0)),
        tilt_sigma_rad=tilt_sigma,
        notes=(f"The attitude is the smoothed gyro and accelerometer{by}.",),
    )


def _integral(clock: FloatArray, rate: FloatArray) -> FloatArray:
    return np.concatenate([[0.0], np.cumsum(0.5 * (rate[1:] + rate[:-1]) * np.diff(clock))])


def _turned_about_down(rotation: FloatArray, angle: FloatArray) -> FloatArray:
    """Turn rotations (N, 3, 3) to world axes by angles (N,) about the vertical."""
    c, d = np.cos(angle)[:, None], np.sin(angle)[:, None]
    out = rotation.copy()
    out[:, 0] = c * rotation[:, 0] - d * rotation[:, 1]
    out[:, 1] = d * rotation[:, 0] + c * rotation[:, 1]
    return out


def _autopilot_rotation(track: Track, clock: FloatArray) -> FloatArray | None:
    """Return the autopilot's attitude (N, 3, 3) at other times; None where it was recorded too slowly."""
    series = track.attitude_rad
    if series is None or len(series) < _FEWEST:
        return None
    when, first = np.unique(series.time_s, return_index=True)
    if (
        float(np.median(np.diff(when))) > SLOWEST_GYRO_S
        or when[0] > clock[0] + 1.0
        or when[-1] < clock[-1] - 1.0
    ):
        return None
    roll, pitch, yaw = series.values[first].T
    angles = Series.of(when, np.stack([roll, pitch, np.unwrap(yaw)], axis=1)).at(clock)
    return euler_to_matrix(*angles.T)


def _levelled_by_both(
    rotation: FloatArray, autopilot: FloatArray, tilt_sigma_rad: float
) -> tuple[FloatArray, float]:
    """Average the levels of two attitudes by what each may be off; return rotations and what that is then."""
    own, other = rotation[:, 2], autopilot[:, 2]
    apart = float(np.sqrt(np.mean(np.sum((own - other) ** 2, axis=1)) / 2.0))
    own_sigma = max(tilt_sigma_rad, _TILT_SIGMA_RAD)
    weight = own_sigma**-2 / (own_sigma**-2 + _TILT_SIGMA_RAD**-2)
    down = weight * own + (1.0 - weight) * other
    down /= np.linalg.norm(down, axis=1, keepdims=True)
    ahead = rotation[:, 0] - down * np.einsum("ni,ni->n", rotation[:, 0], down)[:, None]
    ahead /= np.linalg.norm(ahead, axis=1, keepdims=True)
    # Two errors of the same size are as far from their mean as they are from each other, over two.
    return np.stack([ahead, np.cross(down, ahead), down], axis=1), max(0.5 * apart, 0.5 * _TILT_SIGMA_RAD)


def _ahead(rotation: FloatArray, other: FloatArray) -> FloatArray:
    """Return the yaw (N,) by which other rotations are ahead, without Euler's angles, unwrapped."""
    e = np.einsum("nij,nkj->nik", other, rotation)
    return np.unwrap(np.arctan2(e[:, 1, 0] - e[:, 0, 1], e[:, 0, 0] + e[:, 1, 1]))


def _autopilot_witness(clock: FloatArray, rotation: FloatArray, autopilot: FloatArray) -> Witness:
    return Witness(
        clock, _ahead(rotation, autopilot), math.radians(3.0), math.radians(0.1), 8.0, math.radians(0.7)
    )


def _receiver_witness(track: Track, clock: FloatArray, rotation: FloatArray) -> Witness | None:
    if track.gps_yaw_rad is None:
        return None
    finite = np.isfinite(track.gps_yaw_rad.values)
    if finite.sum() < _FEWEST:
        return None
    heard, yaw = track.gps_yaw_rad.time_s[finite], np.unwrap(track.gps_yaw_rad.values[finite])
    own = np.interp(heard, clock, np.unwrap(matrix_to_euler(rotation)[2]))
    return Witness(heard, np.unwrap(yaw - own), math.radians(1.0), math.radians(0.5), 20.0)


def _rotations_at(
    clock: FloatArray, rotation: FloatArray, rate: FloatArray, time_s: FloatArray
) -> FloatArray:
    """Carry rotations to other times with the rate at the nearest sample before."""
    left = np.clip(np.searchsorted(clock, time_s, side="right") - 1, 0, clock.size - 1)
    middle_rate = at_times(clock, rate, 0.5 * (time_s + clock[left]))
    return np.asarray(rotation[left] @ exponentials(middle_rate * (time_s - clock[left])[:, None]))


def _attitude(track: Track, time_s: FloatArray, instance: int) -> Reference | None:
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
    heading = np.arctan2(rotation[:, 1, 0], rotation[:, 0, 0])
    middle = 0.5 * (time_s[0] + time_s[-1])
    other = steered_by(track, instance) == "other"
    bent = math.radians(5.0)
    curves = np.stack(
        [bent * np.sin(heading), bent * np.cos(heading), math.radians(0.02) * (time_s - middle)], axis=1
    )
    note = (
        "The attitude is the autopilot's own: its roll and pitch are trusted within a degree, its yaw was"
        " made from a compass and may be bent, which is solved for and widens every interval."
    )
    return Reference(
        "attitude",
        rotation,
        rate,
        _near(clock, time_s, 3.0 * float(np.median(np.diff(clock)))),
        yaw_sigma_rad=math.radians(5.0 if other else 10.0),
        yaw_curves_rad=curves,
        notes=(note,),
    )
