"""Which way is down for something that sways: a hovering copter.

A hovering copter's accelerometer shows its thrust, which leans exactly as the vehicle does: it reads level
whatever the tilt. The autopilot's own tilt is fused with the compass that is being calibrated and with
velocities turned by it, and is off by up to a degree while that is badly bent. What remains is Newton: in a
level frame that the gyro carries along, with its heading left open,

    v(t) = v(0) + integral of (R f + g) dt,    R = (1 + [phi]x) R_gyro,    phi' = R_gyro b        (T1)

and the velocity v is known: by the satellite receiver, whose north lies at an unknown angle in that frame,
or because what hovers stays where it is. (T1) is linear in the tilt error phi, the gyro's bias b, v(0)
and the cosine and sine of that angle. The vertical part of phi turns v only, and is in the angle.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from statistics import NormalDist

import numpy as np

from mavcompass.calibration.observation.wire import hidden_beside_noise
from mavcompass.frames import FloatArray
from mavcompass.heading.gravity import down_in_body
from mavcompass.track import Track, uncut
from mavcompass.units import STANDARD_GRAVITY_MPS2

# What is looked at before and after a dwell: several periods of a position loop.
_MARGIN_S = 10.0
LONGEST_GAP_S = 0.5
# Noise is told by means over this time.
_MEAN_S = 0.025
_KNOT_S = 1.0
_FEWEST = 20
# Of one velocity of a satellite receiver; its error lasts for about a second. And its delay.
_RECEIVER_SIGMA_MPS, _RECEIVER_MEMORY_S, _RECEIVER_LAG_S = 0.1, 1.0, 0.11
# How far a hovering vehicle's velocity is from zero, where nothing measures it.
_HOVER_SIGMA_MPS = 0.3
_BIAS_SIGMA_RADPS = math.radians(0.2)
_TILT_SIGMA_RAD = math.radians(5.0)
# What (T1) leaves out: sensors that are not quite square to each other, rates of 25 Hz.
_FLOOR_RAD = math.radians(0.05)
# So many headings of the level frame are weighed against each other.
_ANGLES = 72
# A mean over a part of a sway misses its amplitude by this many times what the part itself shows of it.
_SWAY_BEYOND = 8.0


@dataclass(frozen=True, slots=True, eq=False)
class Sway:
    """Hold the tilt over a stretch by (T1).

    Attributes:
        down: mean direction of down in body axes, (3,). sigma_rad: of it, each angle.
        swing_rad: what the accelerometer's mean may be off by, because the vehicle accelerates.
    """

    down: FloatArray
    sigma_rad: float
    swing_rad: float


@dataclass(frozen=True, slots=True, eq=False)
class Levelled:
    """Hold the tilt by (T1) at every sample of a stretch.

    Attributes:
        time_s: (N,). level_mps2: specific force in the level frame, (N, 3).
        rotation: of the gyro alone, body to level, (N, 3, 3). leaning: its tilt error per unknown, (N, 2, U).
        state, covariance: of these unknowns, (U,), (U, U).
    """

    time_s: FloatArray
    level_mps2: FloatArray
    rotation: FloatArray
    leaning: FloatArray
    state: FloatArray
    covariance: FloatArray

    def error_rad(self) -> FloatArray:
        """Return what the rotation's tilt is off by, about the level axes, (N, 3)."""
        x, y = (self.leaning @ self.state).T
        return np.stack([x, y, np.zeros_like(x)], axis=1)

    def down(self) -> FloatArray:
        """Return the direction of down in body axes, (N, 3)."""
        # R true transposed, times down.
        upright = np.array([0.0, 0.0, 1.0]) - np.cross(self.error_rad(), [0.0, 0.0, 1.0])
        return np.einsum("nji,nj->ni", self.rotation, upright)

    def sigma_rad(self) -> FloatArray:
        """Return the sigma of each angle, (N,)."""
        variance = np.einsum("nij,jk,nik->n", self.leaning, self.covariance, self.leaning, optimize=True)
        return np.hypot(np.sqrt(variance / 2.0), _FLOOR_RAD)


def sway(track: Track, start_s: float, end_s: float) -> Sway | None:
    """Find down between two times from gyro, accelerometer and velocity; None where these do not tell it."""
    found = level_by_newton(track, start_s, end_s, hovers=track.vehicle == "copter")
    if found is None:
        return None
    average = found.leaning.mean(axis=0)
    variance = average @ found.covariance @ average.T
    down = found.down().mean(axis=0)
    return Sway(
        down=down / np.linalg.norm(down),
        sigma_rad=math.hypot(math.sqrt(float(np.trace(variance)) / 2.0), _FLOOR_RAD),
        swing_rad=_swing(found.level_mps2 + np.cross(found.error_rad(), found.level_mps2)),
    )


def level_by_newton(track: Track, start_s: float, end_s: float, hovers: bool = False) -> Levelled | None:
    """Solve (T1) for what lies between two times, with a margin; None where nothing tells the velocity.

    `hovers`: where none was measured it is near zero.
    """
    samples = _samples(track, start_s, end_s, hovers)
    if samples is None:
        return None
    time, rate, force = samples
    known = _velocity(track, time, hovers)
    if known is None:
        return None
    middle = int(np.searchsorted(time, 0.5 * (start_s + end_s)))
    rotation = _carried(time, rate, down_in_body(track, time[[middle]])[0], middle)
    level = np.einsum("nij,nj->ni", rotation, force)
    phi, prior = _tilt_errors(time, rotation, rate, middle, track.gyro_truncation_radps)
    up = -level[:, 2][:, np.newaxis, np.newaxis]
    leaning = integral(time, up * np.stack([-phi[:, 1], phi[:, 0]], axis=1))
    pushing, push_sigma = _walks(time, rotation, white_noise(time, force), track.acc_truncation_mps2)
    mean, covariance = _solve(
        time,
        known,
        np.concatenate([leaning, pushing], axis=2),
        np.concatenate([prior, push_sigma]),
        integral(time, level[:, :2]),
    )
    inside = (time >= start_s) & (time <= end_s)
    unknown = phi.shape[2]
    return Levelled(
        time[inside],
        level[inside],
        rotation[inside],
        phi[inside],
        mean[:unknown],
        covariance[:unknown, :unknown],
    )


def _samples(
    track: Track, start_s: float, end_s: float, hovers: bool = False
) -> tuple[FloatArray, FloatArray, FloatArray] | None:
    """Return time, angular rate and specific force around a stretch, as far as nothing is missing."""
    gyro, acc = track.gyro_radps, track.acc_mps2
    if gyro is None or acc is None or len(acc) < 2:
        return None
    before_s = _MARGIN_S
    if hovers:  # of a stretch that has just ended, what comes after it is not there yet
        before_s = max(_MARGIN_S, 2.0 * _MARGIN_S - max(float(gyro.time_s[-1]) - end_s, 0.0))
    around = gyro.between(start_s - before_s, end_s + _MARGIN_S)
    time, rate = around.time_s, np.asarray(around.values)
    force = np.asarray(acc.at(time))
    usable = np.asarray(np.isfinite(rate).all(axis=1) & np.isfinite(force).all(axis=1), dtype=np.bool_)
    usable[1:] &= np.diff(time) > 0.0
    time, rate, force = time[usable], rate[usable], force[usable]
    gaps = np.flatnonzero(np.diff(time) > LONGEST_GAP_S)
    before = gaps[time[gaps] <= start_s]
    after = gaps[time[gaps] >= end_s]
    if before.size + after.size < gaps.size:
        return None
    first, last = int(before.max(initial=-1)) + 1, int(after.min(initial=time.size - 1)) + 1
    time = time[first:last]
    if time.size < _FEWEST or time[0] > start_s + LONGEST_GAP_S or time[-1] < end_s - LONGEST_GAP_S:
        return None
    rate = uncut(rate[first:last], track.gyro_truncation_radps)
    return time, rate, uncut(force[first:last], track.acc_truncation_mps2)


def _carried(time: FloatArray, rate: FloatArray, down: FloatArray, middle: int) -> FloatArray:
    """Carry a level frame along by the gyro, (N, 3, 3): level <- body, level at `middle`."""
    turns = _rotations(0.5 * (rate[1:] + rate[:-1]) * np.diff(time)[:, np.newaxis])
    forward = np.cross(np.cross(down, [1.0, 0.0, 0.0]), down)
    forward /= np.linalg.norm(forward)
    out = np.empty((time.size, 3, 3))
    out[middle] = np.stack([forward, np.cross(down, forward), down])
    for k in range(middle + 1, time.size):
        out[k] = out[k - 1] @ turns[k - 1]
    for k in range(middle - 1, -1, -1):
        out[k] = out[k + 1] @ turns[k].T
    return out


def _rotations(vector: FloatArray) -> FloatArray:
    """Turn small rotation vectors (N, 3) into matrices (N, 3, 3), to the third order."""
    x, y, z = vector.T
    o = np.zeros_like(x)
    cross = np.moveaxis(np.array([[o, -z, y], [z, o, -x], [-y, x, o]]), 2, 0)
    square = (vector**2).sum(axis=1)[:, np.newaxis, np.newaxis]
    return np.asarray(np.eye(3) + (1.0 - square / 6.0) * cross + (0.5 - square / 24.0) * (cross @ cross))


def integral(time: FloatArray, values: FloatArray) -> FloatArray:
    """Integrate over time from the first sample on by the trapezoid's rule, along axis 0."""
    steps = np.diff(time).reshape(-1, *[1] * (values.ndim - 1))
    parts = 0.5 * (values[1:] + values[:-1]) * steps
    return np.concatenate([np.zeros((1, *values.shape[1:])), np.cumsum(parts, axis=0)])


def _tilt_errors(
    time: FloatArray, rotation: FloatArray, rate: FloatArray, middle: int, quantum_radps: float
) -> tuple[FloatArray, FloatArray]:
    """Build phi(t) over its unknowns, (N, 2, 5 + 2 K), and their sigmas: phi at `middle`, bias, K steps.

    The gyro's noise makes phi a random walk: steps of it, knot by knot.
    """
    drifting = integral(time, rotation[:, :2, :])
    walking, step_sigma = _walks(time, rotation, white_noise(time, rate), quantum_radps)
    still = np.broadcast_to(np.eye(2), (time.size, 2, 2))
    phi = np.concatenate([still, drifting - drifting[middle], walking - walking[middle]], axis=2)
    return phi, np.concatenate([[_TILT_SIGMA_RAD] * 2, [_BIAS_SIGMA_RADPS] * 3, step_sigma])


def _walks(
    time: FloatArray, rotation: FloatArray, noise: FloatArray, quantum: float
) -> tuple[FloatArray, FloatArray]:
    """Build what white noise of the body's x and y, (>= 2,), integrates to in the level frame, knot by knot.

    Returns (N, 2, 2 K) and the sigmas (2 K,). Each axis has its own noise, which turns with the vehicle; what
    the step of whole numbers hides lasts for a knot.
    """
    count = max(round(float(time[-1] - time[0]) / _KNOT_S), 1)
    width_s = float(time[-1] - time[0]) / count
    knot = np.minimum(((time - time[0]) / width_s).astype(int), count - 1)
    inside = (knot[:, np.newaxis] == np.arange(count)) / width_s
    walks = integral(time, rotation[:, :2, :2, np.newaxis] * inside[:, np.newaxis, np.newaxis, :])
    white = noise[:2] * math.sqrt(float(np.median(np.diff(time))) * width_s)
    step = np.hypot(white, hidden_beside_noise(noise[:2], quantum) * width_s)
    return walks.reshape(time.size, 2, -1), np.repeat(step, count)


def white_noise(time: FloatArray, values: FloatArray, quantile: float = 0.5) -> FloatArray:
    """Return each axis's noise of one of (N, M) samples, as far as it adds up like white noise: (M,).

    By second differences, which smooth motion hardly shows, and of means: a filter ahead of a fast recording
    takes noise out of the difference of neighbours and leaves it in their sum. `quantile` of the differences
    tells; a smaller one looks at the calmer part of a motion.
    """
    interval_s = max(float(np.median(np.diff(time))), 1e-6)
    count = max(min(round(_MEAN_S / interval_s), len(values) // 8), 1)
    whole = len(values) // count
    means = values[: whole * count].reshape(whole, count, -1).mean(axis=1)
    bends = np.quantile(np.abs(np.diff(means, 2, axis=0)), quantile, axis=0)
    normal = NormalDist().inv_cdf(0.5 + 0.5 * quantile)
    return np.asarray(bends / normal * math.sqrt(count / 6.0) + 1e-9)


def _solve(
    time: FloatArray, known: _Velocity, leaning: FloatArray, prior: FloatArray, pushed: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Solve (T1) by least squares: the unknowns of `leaning` (U,) and their covariance."""
    at = np.clip(np.searchsorted(time, known.time_s), 0, time.size - 1)
    unknown = leaning.shape[2]
    design = np.zeros((at.size, 2, unknown + 4))
    design[:, :, :unknown] = leaning[at]
    design[:, :, unknown : unknown + 2] = np.eye(2)
    north, east = known.mps.T
    design[:, :, unknown + 2] = -known.mps
    design[:, :, unknown + 3] = np.stack([-east, north], axis=1)
    rows = design.reshape(-1, unknown + 4) / known.sigma_mps
    target = -pushed[at].reshape(-1) / known.sigma_mps
    # The velocity at the start may be any; cosine and sine are bound to their circle below.
    sigma = np.concatenate([prior, [100.0] * 4])
    covariance = np.asarray(np.linalg.inv(rows.T @ rows + np.diag(sigma**-2)))
    state, covariance = _on_the_circle(covariance @ (rows.T @ target), covariance)
    misfit = float(((rows @ state - target) ** 2).mean())
    return state[:unknown], np.asarray(covariance[:unknown, :unknown] * max(misfit, 1.0))


def _on_the_circle(state: FloatArray, covariance: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Bind the last two unknowns to be a cosine and a sine: a noisy velocity would shrink them to nothing.

    Every angle has its likelihood, and with it the others theirs: mean and covariance over all angles.
    """
    angles = np.linspace(0.0, 2.0 * math.pi, _ANGLES, endpoint=False)
    away = np.stack([np.cos(angles), np.sin(angles)], axis=1) - state[-2:]
    inverse = np.linalg.inv(covariance[-2:, -2:])
    cost = 0.5 * np.einsum("ni,ij,nj->n", away, inverse, away)
    share = np.exp(cost.min() - cost)
    share /= share.sum()
    moved = share @ away
    spread = (share[:, np.newaxis] * (away - moved)).T @ (away - moved)
    gain = covariance[:, -2:] @ inverse
    return state + gain @ moved, covariance + gain @ (spread - covariance[-2:, -2:]) @ gain.T


@dataclass(frozen=True, slots=True, eq=False)
class _Velocity:
    """Hold horizontal velocities (M, 2) and the sigma of one, as if their errors were independent."""

    time_s: FloatArray
    mps: FloatArray
    sigma_mps: float


def _velocity(track: Track, time: FloatArray, hovers: bool) -> _Velocity | None:
    """Return what is known of the velocity; None where that is nothing."""
    for measured in (track.receiver_velocity_mps, track.gps_velocity_mps):
        if measured is None:
            continue
        inside = measured.between(float(time[0]) + _RECEIVER_LAG_S, float(time[-1]) + _RECEIVER_LAG_S)
        horizontal = np.asarray(inside.values)[:, :2]
        finite = np.isfinite(horizontal).all(axis=1)
        when, horizontal = inside.time_s[finite] - _RECEIVER_LAG_S, horizontal[finite]
        span = float(time[-1] - time[0])
        if when.size >= 4 and when.size > 0.8 * span:
            crowd = max(when.size * _RECEIVER_MEMORY_S / span, 1.0)
            return _Velocity(when, horizontal, _RECEIVER_SIGMA_MPS * math.sqrt(crowd))
    if not hovers:
        return None
    when = np.arange(float(time[0]), float(time[-1]), 1.0)
    return _Velocity(when, np.zeros((when.size, 2)), _HOVER_SIGMA_MPS)


def _swing(level_mps2: FloatArray) -> float:
    """Judge by the change of the acceleration inside a stretch how far its mean may be from zero, radians.

    Where the force leans in the level frame, that is acceleration. Thirds are compared, so that shaking
    averages out.
    """
    horizontal = level_mps2[:, :2] / STANDARD_GRAVITY_MPS2
    if len(horizontal) < 6:
        return math.inf
    thirds = np.array([part.mean(axis=0) for part in np.array_split(horizontal, 3)])
    jumps = np.diff(horizontal, axis=0)
    chance = 2.0 * math.sqrt(float((jumps**2).mean()) / 2.0 * 3.0 / len(horizontal))
    seen = float(np.ptp(thirds, axis=0).max())
    return _SWAY_BEYOND * math.sqrt(max(seen**2 - chance**2, 0.0))
