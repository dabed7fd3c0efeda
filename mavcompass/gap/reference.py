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
from mavcompass.simulation.effects.sampling import at_times
from mavcompass.track import Series, Track
from mavcompass.units import STANDARD_GRAVITY_MPS2

ReferenceKind = Literal["columns", "gps-yaw", "gyro", "attitude"]
Choice = Literal["auto", "gyro", "gps-yaw", "attitude", "columns"]

# Integrating the gyro needs samples closer together than this; slower recordings use ATTITUDE.
SLOWEST_GYRO_S = 0.15
_LEVELLING_S = 12.0
_STILL_RATE_RADPS = math.radians(1.0)
_GRAVITY_TOLERANCE_MPS2 = 0.6
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
        notes: what a reader of the result must know.
    """

    kind: ReferenceKind
    rotation: FloatArray
    rate_radps: FloatArray
    known: NDArray[np.bool_]
    yaw_sigma_rad: float = 0.0
    drift_sigma_radps: float = 0.0
    bent_sigma_rad: float = 0.0
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
    smoothed = _smoothed(track)
    if smoothed is None:
        return None
    clock, rotation, rate, drift = smoothed
    notes = (
        "The attitude is the smoothed gyro and accelerometer; its initial yaw is solved with the field.",
    )
    return Reference(
        "gyro",
        _rotations_at(clock, rotation, rate, time_s),
        at_times(clock, rate, time_s),
        _near(clock, time_s, 3.0 * float(np.median(np.diff(clock)))),
        yaw_sigma_rad=math.radians(60.0),
        drift_sigma_radps=drift,
        notes=notes,
    )


def _rotations_at(
    clock: FloatArray, rotation: FloatArray, rate: FloatArray, time_s: FloatArray
) -> FloatArray:
    """Carry rotations to other times with the rate at the nearest sample before."""
    left = np.clip(np.searchsorted(clock, time_s, side="right") - 1, 0, clock.size - 1)
    middle_rate = at_times(clock, rate, 0.5 * (time_s + clock[left]))
    return np.asarray(rotation[left] @ _exponentials(middle_rate * (time_s - clock[left])[:, None]))


def _exponentials(vectors: FloatArray) -> FloatArray:
    """Return the rotations (N, 3, 3) by rotation vectors (N, 3)."""
    angle = np.sqrt(np.einsum("ni,ni->n", vectors, vectors))
    safe = np.where(angle > 1e-9, angle, 1.0)
    k = np.zeros((len(vectors), 3, 3))
    k[:, 0, 1], k[:, 0, 2], k[:, 1, 2] = -vectors[:, 2], vectors[:, 1], -vectors[:, 0]
    k[:, 1, 0], k[:, 2, 0], k[:, 2, 1] = vectors[:, 2], -vectors[:, 1], vectors[:, 0]
    first = np.where(angle > 1e-9, np.sin(safe) / safe, 1.0)[:, None, None]
    second = np.where(angle > 1e-9, (1.0 - np.cos(safe)) / safe**2, 0.5)[:, None, None]
    return np.asarray(np.eye(3) + first * k + second * (k @ k))


def _smoothed(track: Track) -> tuple[FloatArray, FloatArray, FloatArray, float] | None:
    """Integrate the gyro and level it; return times, rotations, rates, and the yaw drift's sigma."""
    if track.gyro_radps is None or track.acc_mps2 is None or len(track.gyro_radps) < 20:
        return None
    finite = np.isfinite(track.gyro_radps.values).all(axis=1)
    clock, raw = track.gyro_radps.time_s[finite], track.gyro_radps.values[finite]
    clock, first = np.unique(clock, return_index=True)
    raw = raw[first]
    acc = track.acc_mps2.at(clock)
    still = _still(clock, raw)
    # At rest the median is the bias; without rest it stays in, and the drift is solved with the field.
    resting = float(np.diff(clock, append=clock[-1])[still].sum())
    rate = raw - (np.median(raw[still], axis=0) if resting > 1.0 else 0.0)
    drift = math.radians(0.02) if resting > 1.0 else math.radians(0.5)
    down = acc / -np.maximum(np.linalg.norm(acc, axis=1, keepdims=True), 1e-6)
    steady = np.abs(np.linalg.norm(acc, axis=1) - STANDARD_GRAVITY_MPS2) < _GRAVITY_TOLERANCE_MPS2
    return clock, _with_down(clock, rate, _smoothed_down(clock, rate, down, steady)), rate, drift


def _smoothed_down(
    clock: FloatArray, rate: FloatArray, down: FloatArray, steady: NDArray[np.bool_]
) -> FloatArray:
    """Return the down vector in body axes, (N, 3), from gyro and accelerometer over both sides of each time.

    Turned by the integrated gyro into the axes of the start, down stands still but for the gyro's drift:
    there it is averaged over some seconds before and after, and turned back.
    """
    rotation = _integrated(clock, rate)
    there = np.einsum("nij,nj->ni", rotation, down) * steady[:, None]
    step = max(float(np.median(np.diff(clock))), 1e-3)
    half = max(1, round(_LEVELLING_S / step))
    kernel = np.concatenate([np.arange(1, half + 1), np.arange(half - 1, 0, -1)]).astype(np.float64)
    total = np.stack([_convolved(there[:, i], kernel) for i in range(3)], axis=1)
    # Where nothing was steady nearby, the average of all is the best there is.
    total += 1e-3 * there.sum(axis=0)
    total /= np.maximum(np.linalg.norm(total, axis=1, keepdims=True), 1e-12)
    return np.asarray(np.einsum("nji,nj->ni", rotation, total))


def _convolved(values: FloatArray, kernel: FloatArray) -> FloatArray:
    """Return the centred convolution, as long as the values, by the Fourier transform."""
    size = 1 << (values.size + kernel.size).bit_length()
    product = np.fft.irfft(np.fft.rfft(values, size) * np.fft.rfft(kernel, size), size)
    first = (kernel.size - 1) // 2
    return np.asarray(product[first : first + values.size])


def _integrated(clock: FloatArray, rate: FloatArray) -> FloatArray:
    """Integrate body rates to rotations (N, 3, 3) from the identity."""
    step = np.diff(clock, prepend=clock[0])
    increments = _exponentials(0.5 * (rate + np.vstack([rate[:1], rate[:-1]])) * step[:, None])
    out = np.empty((clock.size, 3, 3))
    rotation = np.eye(3)
    for i in range(clock.size):
        rotation = rotation @ increments[i]
        out[i] = rotation
    return out


def _still(clock: FloatArray, raw: FloatArray) -> NDArray[np.bool_]:
    window = max(3, int(0.7 / max(float(np.median(np.diff(clock))), 1e-3)))
    kernel = np.ones(window) / window
    smooth = np.stack([np.convolve(raw[:, i], kernel, mode="same") for i in range(3)], axis=1)
    size = np.abs(smooth).max(axis=1)
    # The quietest stretch tells the bias; whatever turns no faster than that is still.
    bias = np.median(smooth[size <= size.min() + _STILL_RATE_RADPS], axis=0)
    return np.asarray(np.abs(smooth - bias).max(axis=1) < _STILL_RATE_RADPS)


def _with_down(clock: FloatArray, rate: FloatArray, down: FloatArray) -> FloatArray:
    """Build rotations with the given down vector (body axes) and the yaw that the rate integrates to."""
    roll = np.arctan2(down[:, 1], down[:, 2])
    pitch = np.arcsin(np.clip(-down[:, 0], -1.0, 1.0))
    cosine = np.maximum(np.cos(pitch), 0.05)
    yaw_rate = (rate[:, 1] * np.sin(roll) + rate[:, 2] * np.cos(roll)) / cosine
    if float(cosine.min()) > 0.3:
        middle = 0.5 * (yaw_rate[1:] + yaw_rate[:-1])
        yaw = np.concatenate([[0.0], np.cumsum(middle * np.diff(clock))])
        return euler_to_matrix(roll, pitch, yaw)
    return _without_euler(clock, rate, down)


def _without_euler(clock: FloatArray, rate: FloatArray, down: FloatArray) -> FloatArray:
    """Do the same where the vehicle points straight up: carry the whole attitude, then set its level."""
    step = np.diff(clock, prepend=clock[0])
    increments = _exponentials(0.5 * (rate + np.vstack([rate[:1], rate[:-1]])) * step[:, None])
    rotation = euler_to_matrix(math.atan2(down[0, 1], down[0, 2]), math.asin(-float(down[0, 0])), 0.0)
    out = np.empty((clock.size, 3, 3))
    for i in range(clock.size):
        rotation = rotation @ increments[i]
        # The smallest rotation that takes the third row to the known down vector adds no yaw.
        x = rotation[0] - down[i] * float(rotation[0] @ down[i])
        x /= math.sqrt(float(x @ x))
        rotation = np.stack([x, np.cross(down[i], x), down[i]])
        out[i] = rotation
    return out


def _gps_yaw(track: Track, time_s: FloatArray) -> Reference | None:
    smoothed = _smoothed(track)
    if smoothed is None or track.gps_yaw_rad is None:
        return None
    clock, rotation, rate, _ = smoothed
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
