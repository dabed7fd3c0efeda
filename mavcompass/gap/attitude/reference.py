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
from collections.abc import Mapping
from dataclasses import dataclass, field, fields, replace
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from mavcompass.errors import BadRecording
from mavcompass.frames import (
    FloatArray,
    euler_to_matrix,
    matrix_to_euler,
    matrix_to_rotvec,
    quaternion_to_matrix,
)
from mavcompass.gap.attitude.kinematics import carried
from mavcompass.gap.attitude.navigation import (
    Doubt,
    doubt_of,
    sensed_by,
    smoothed_attitude,
    started,
    wandering_yaw,
)
from mavcompass.gap.attitude.sensors import Bias, bias_at_rest, receiver_velocity
from mavcompass.gap.attitude.smoother import Witness
from mavcompass.gap.tables import usual
from mavcompass.gravity import require_gravity
from mavcompass.simulation.effects.effect import Detector
from mavcompass.simulation.effects.sampling import at_times, rotation_at
from mavcompass.simulation.physics.signals import Turning
from mavcompass.steering import steering_source
from mavcompass.track import Series, Track

ReferenceKind = Literal["columns", "fused", "gps-yaw", "gyro", "attitude"]
Steering = Literal["own", "other", "unknown"]
Choice = Literal["auto", "gyro", "gps-yaw", "attitude", "columns"]

_EVERY = slice(None)
_REMEDY = "Record RAW_IMU or IMU messages at 10 Hz or more, or an attitude (ATTITUDE, ATT)."


@dataclass(frozen=True, slots=True, eq=False)
class Reference(Doubt):
    """Hold the believed attitude at the times of the magnetometer's readings.

    Attributes:
        kind: where it comes from.
        rotation: body to NED, (N, 3, 3); rate_radps: its body rate, (N, 3).
        known: where there is one, (N,).
        doubted: the times, of all (N,), at which its doubt stands, (M,).
        errors: what gyro and accelerometer are off by, where that was estimated.
        witnessed: whether anything but the compass under test tells the yaw.
        notes: what a reader of the result must know.
    """

    kind: ReferenceKind
    rotation: FloatArray
    rate_radps: FloatArray
    known: NDArray[np.bool_]
    doubted: slice = field(default_factory=lambda: _EVERY)
    errors: Mapping[Detector, Bias] = field(default_factory=dict)
    witnessed: bool = True
    notes: tuple[str, ...] = ()

    @property
    def yaw_unknown(self) -> bool:
        """Tell whether nothing but the compass itself fixes the constant of the yaw."""
        return self.yaw_sigma_rad > usual.yaw.unknown_rad

    def wander_rad(self, amplitudes: FloatArray) -> FloatArray:
        """Return what curves with some amplitudes (k,) turn the yaw by, (N,), radians."""
        return np.asarray(self.curves_rad[:, 2] @ amplitudes)

    def alone(self, time_s: FloatArray) -> Reference:
        """Return the reference of a recording that has no baseline, at its own times (N,).

        What such a recording is held against holds more than an attitude leaves: only the largest curves
        count. A yaw without a witness may wander.
        """
        small = self.curves_rad[:, :, usual.curves.most_alone :]
        rest = np.einsum("nik,njk->ij", small, small) / max(len(small), 1)
        curves = self.curves_rad[:, :, : usual.curves.most_alone]
        if not self.witnessed:
            more = wandering_yaw(time_s)
            curves = np.concatenate([curves if curves.size else more[:, :, :0], more], axis=2)
        return replace(self, curves_rad=curves, rest_rad2=self.rest_rad2 + rest)

    def earlier(self, time_s: FloatArray, by_s: float) -> Reference:
        """Return the reference some seconds before its own times (N,)."""
        if by_s == 0.0:
            return self
        turning = Turning(time_s, self.rotation, self.rate_radps, self.rotation)
        rate = at_times(time_s, self.rate_radps, time_s - by_s)
        return replace(self, rotation=rotation_at(turning, time_s - by_s), rate_radps=rate)

    def thinned(self) -> Reference:
        """Return the reference at those times only at which it is doubted."""
        rows = self.doubted
        return replace(
            self, rotation=self.rotation[rows], rate_radps=self.rate_radps[rows], known=self.known[rows],
            doubted=_EVERY,
        )  # fmt: skip


def reference_attitude(
    track: Track, time_s: FloatArray, choice: Choice = "auto", instance: int = 1, doubted: slice = _EVERY
) -> Reference:
    """Choose and build the attitude reference of one compass at some times, and at some of these its doubt.

    Raises BadRecording where the recording does not hold what the choice needs, or its accelerometer is dead.
    """
    require_gravity(track.acc_mps2)
    if choice == "columns" or (
        choice == "auto" and track.reference_q is not None and len(track.reference_q) > 1
    ):
        reference = _columns(track, time_s)
    elif choice == "attitude" or (choice == "auto" and not _gyro_is_fast(track)):
        reference = _attitude(track, time_s, instance, doubted)
    else:
        reference = _fused(track, time_s, choice, instance, doubted)
    if reference is None:
        raise BadRecording(f"The recording has nothing for the attitude reference {choice!r}.", _REMEDY)
    return replace(reference, doubted=doubted)


def _gyro_is_fast(track: Track) -> bool:
    """Tell whether gyro and accelerometer were recorded, with numbers, often enough to be integrated."""
    sensed = sensed_by(track)
    return sensed is not None and float(np.median(np.diff(sensed.time_s))) <= usual.gyro.slowest_s


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
    near = matrix_to_rotvec(rotation[:-1].transpose(0, 2, 1) @ rotation[1:]) / np.diff(time_s)[:, None]
    rate = np.vstack([near[:1], 0.5 * (near[:-1] + near[1:]), near[-1:]])
    step = np.diff(time_s)
    even = np.ptp(np.stack([step[:-3], step[1:-2], step[2:-1], step[3:]]), axis=0) < 0.05 * step[1:-2]
    middle = rotation[2:-2].transpose(0, 2, 1)
    vectors = [matrix_to_rotvec(middle @ rotation[2 + j : n - 2 + j]) for j in (-2, -1, 1, 2)]
    span = (time_s[4:] - time_s[:-4])[:, None] / 4.0
    fine = (8.0 * (vectors[2] - vectors[1]) - (vectors[3] - vectors[0])) / (12.0 * span)
    rate[2:-2] = np.where(even[:, None], fine, rate[2:-2])
    return rate


def _fused(
    track: Track, time_s: FloatArray, choice: Choice, instance: int, doubted: slice, listening: bool = True
) -> Reference | None:
    """Smooth gyro and accelerometer with the receiver and the witnesses that the choice allows.

    What a receiver says of the velocity is left out where it is contradicted, or not `listening`.
    """
    sensed = sensed_by(track)
    if sensed is None:
        return None
    clock = sensed.time_s
    resting = bias_at_rest(clock, sensed.rate_radps, sensed.force_mps2)
    velocity = receiver_velocity(track, clock) if listening else None
    autopilot = _autopilot_rotation(track, clock) if choice == "auto" else None
    (rotation, bearing), level = started(sensed, resting, velocity, autopilot), autopilot
    if autopilot is not None and velocity is not None and not bearing:
        alone, bearing = started(sensed, resting, velocity, None)
        if bearing:
            # The receiver explains what is felt, but not as the autopilot leans: by a bent compass.
            rotation, level = alone, None
    antennas = _antennas_yaw(track, clock, rotation) if choice in ("auto", "gps-yaw") else None
    if choice == "gps-yaw" and antennas is None:
        return None
    told = ["the receiver's velocity"] if bearing else []
    witness = None
    if antennas is not None:
        leaning = rotation if level is None else level
        facing = euler_to_matrix(0.0, 0.0, antennas - matrix_to_euler(leaning)[2]) @ leaning
        witness = Witness(facing, usual.antennas.constant_rad, usual.antennas.slow_rad)
        told.append("the two-antenna receiver")
    elif level is not None:
        steered = steered_by(track, instance) == "other"
        witness = Witness(
            level, usual.autopilot.constant_rad if steered else math.inf, usual.autopilot.slow_rad
        )
        told += ["the autopilot's yaw, which another compass steers"] if steered else []
    if not bearing and witness is not None and math.isfinite(witness.constant_rad):
        ahead = float(np.median(_ahead(rotation, witness.rotation)))
        rotation = euler_to_matrix(0.0, 0.0, ahead) @ rotation
    heard = velocity if bearing else None
    found = smoothed_attitude(sensed, rotation, resting, heard, witness)
    if found is None:
        return _fused(track, time_s, choice, instance, doubted, listening=False)
    smoothed, healthy = found
    doubt = doubt_of(smoothed, time_s[doubted], bool(told) and choice != "gyro", healthy)
    by = f"; its yaw follows {' and '.join(told)}" if told else "; its initial yaw is solved with the field"
    return Reference(
        "fused" if choice == "auto" else choice,
        carried(clock, smoothed.rotation, smoothed.rate_radps, time_s),
        at_times(clock, smoothed.rate_radps, time_s),
        _near(clock, time_s, 3.0 * float(np.median(np.diff(clock)))),
        **{one.name: getattr(doubt, one.name) for one in fields(doubt)},
        errors=smoothed.errors,
        witnessed=bool(told),
        notes=(f"The attitude is the smoothed gyro and accelerometer{by}.",),
    )


def recorded_rotation(attitude_rad: Series, time_s: FloatArray) -> FloatArray:
    """Return the autopilot's attitude (roll, pitch, yaw) at other times, as rotations (N, 3, 3)."""
    when, first = np.unique(attitude_rad.time_s, return_index=True)
    roll, pitch, yaw = attitude_rad.values[first].T
    angles = Series.of(when, np.stack([roll, pitch, np.unwrap(yaw)], axis=1)).at(time_s)
    return euler_to_matrix(*angles.T)


def steered_by(track: Track, instance: int) -> Steering:
    """Tell from the parameters whether the compass under test steers the autopilot's yaw."""
    source = steering_source(track.autopilot, track.parameters)
    if source is None:
        return "unknown"
    return "own" if source == instance else "other"


def _autopilot_rotation(track: Track, clock: FloatArray) -> FloatArray | None:
    """Return the autopilot's attitude (N, 3, 3) at other times; None where it was recorded too slowly."""
    series = track.attitude_rad
    if series is None or len(series) < usual.gyro.fewest:
        return None
    when = np.unique(series.time_s)
    if (
        float(np.median(np.diff(when))) > usual.gyro.slowest_s
        or when[0] > clock[0] + 1.0
        or when[-1] < clock[-1] - 1.0
    ):
        return None
    return recorded_rotation(series, clock)


def _ahead(rotation: FloatArray, other: FloatArray) -> FloatArray:
    """Return the yaw (N,) by which other rotations are ahead, without Euler's angles, unwrapped."""
    e = np.einsum("nij,nkj->nik", other, rotation)
    return np.unwrap(np.arctan2(e[:, 1, 0] - e[:, 0, 1], e[:, 0, 0] + e[:, 1, 1]))


def _antennas_yaw(track: Track, clock: FloatArray, rotation: FloatArray) -> FloatArray | None:
    """Return the yaw of a two-antenna receiver at other times, (N,); None where it does not tell one.

    Between its readings, and where it lost sight, it turns as the gyro's rotations (N, 3, 3) do.
    """
    if track.gps_yaw_rad is None:
        return None
    finite = np.isfinite(track.gps_yaw_rad.values)
    if finite.sum() < usual.gyro.fewest:
        return None
    heard_s, told = track.gps_yaw_rad.time_s[finite], track.gps_yaw_rad.values[finite]
    turned = np.unwrap(matrix_to_euler(rotation)[2])
    ahead: FloatArray = np.interp(clock, heard_s, np.unwrap(told - np.interp(heard_s, clock, turned)))
    return turned + ahead


def _attitude(track: Track, time_s: FloatArray, instance: int, doubted: slice) -> Reference | None:
    if track.attitude_rad is None or len(track.attitude_rad) < 8:
        return None
    clock = np.unique(track.attitude_rad.time_s)
    rotation = recorded_rotation(track.attitude_rad, time_s)
    rate = body_rate(time_s, rotation)
    if track.gyro_radps is not None and len(track.gyro_radps) > 8:
        rate = track.gyro_radps.at(time_s)
    heading = np.arctan2(rotation[:, 1, 0], rotation[:, 0, 0])
    middle = 0.5 * (time_s[0] + time_s[-1])
    other = steered_by(track, instance) == "other"
    bent = math.radians(5.0)
    curves = np.zeros((time_s.size, 3, 3))
    curves[:, 2] = np.stack(
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
        curves_rad=curves[doubted],
        witnessed=other,
        notes=(note,),
    )
