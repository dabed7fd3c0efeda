"""How far the vehicle has turned, by the gyro alone.

The turned angle is the integral of the angular rate about the vertical, minus the gyro's bias. The
autopilot's yaw is never used: it is fused with the compass that is being calibrated.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from mavcompass.attitude import Levels, levels, moving_average
from mavcompass.calibration.observation.wire import white_noise
from mavcompass.errors import PoorCalibration
from mavcompass.frames import FloatArray, tilt_from_acceleration, wrap_pi
from mavcompass.track import Track, uncut

# Autopilots zero their gyros at power-up; what is left drifts with temperature.
BOOT_BIAS_SIGMA_RADPS = math.radians(0.2)
# A bare gyro in a file of unknown origin: its datasheet's zero-rate level.
BARE_BIAS_SIGMA_RADPS = math.radians(3.0)
# Sensitivity of MEMS gyros as they come and after the autopilot's temperature has settled.
GYRO_SCALE_SIGMA = 0.01
_WINDOW_S = 3.0
# How fast a MEMS gyro's bias drifts while it warms up, and for how long the same way.
DRIFT_RADPS2, DRIFTS_FOR_S = math.radians(0.0007), 100.0
_MOST_STRETCHES = 300
# Windows share their errors (a creep below the compass's resolution): no more than two count as independent.
_INDEPENDENT_WINDOWS = 2.0
_GAP_S = 0.5
# The angle is held against roll and pitch after this time; both share what the gyro itself walks in a second.
_WALK_S, _FEWEST_WALKS, _UNSEEN_WALK_RAD = 2.0, 10, math.radians(0.02)
# A gyro that turns faster than so many sigmas of what its bias may be is turning.
_TURNING_SIGMAS = 5.0
_STEADY_RADPS = math.radians(1.0)
_SHORTEST_S, _SMOOTHING_S = 1.0, 0.5
# A turn known no better shows nothing of the compass; one of less is none.
SPARSE_RAD, _LEAST_TURN_RAD = math.radians(5.0), math.radians(10.0)
# A field that moves by more than this many sigmas shows a vehicle that turns.
_MOVING_SIGMAS = 4.0


@dataclass(frozen=True, slots=True, eq=False)
class TurnRecord:
    """Hold the angle that the nose turned over a recording, (N,), clockwise seen from above.

    Attributes:
        time_s, angle_rad: bias removed. rate_radps: about the vertical, bias removed.
        tilt_rate_radps: length of the horizontal part of the angular rate.
        bias_radps, bias_sigma_radps: the vertical bias taken out (its mean) and what is not known of it.
        noise_radps: noise of one rate sample.
        walk_rad: what noise adds to the angle in one second.
        interval_s: usual time between samples.
    """

    time_s: FloatArray
    angle_rad: FloatArray
    rate_radps: FloatArray
    tilt_rate_radps: FloatArray
    bias_radps: float = 0.0
    bias_sigma_radps: float = 1e-9
    noise_radps: float = 0.0
    walk_rad: float = 0.0
    interval_s: float = 0.0

    @property
    def rate_hz(self) -> float:
        """Return how many times a second the gyro was told; clocks may stand still for most of it."""
        return 1.0 / max(self.interval_s, 1e-6)

    def angle_at(self, time_s: FloatArray) -> FloatArray:
        """Return the turned angle at other times, radians."""
        return np.interp(time_s, self.time_s, self.angle_rad)

    def rate_at(self, time_s: FloatArray) -> FloatArray:
        """Return the rate of turn at other times, radians per second."""
        return np.interp(time_s, self.time_s, self.rate_radps)

    def independent_sigma_rad(self, start_s: float, end_s: float) -> float:
        """Return what white noise, sparse sampling and gaps add to the angle between two times.

        Bias and scale are common to all turns and kept apart (`bias_sigma_radps`, GYRO_SCALE_SIGMA).
        """
        first, last = np.searchsorted(self.time_s, [start_s, end_s])
        rows = slice(max(int(first) - 1, 0), int(last) + 1)
        time, rate = self.time_s[rows], self.rate_radps[rows]
        if time.size < 3:
            return math.inf
        steps = np.diff(time)
        white = self.walk_rad * math.sqrt(max(end_s - start_s, 0.0))
        # The trapezoid's error shows in the second difference of the rate: h^2/12 rate'' per step.
        bend = np.diff(rate, 2) * 0.5 * (steps[1:] + steps[:-1]) / 12.0
        sampling = math.sqrt(float(np.sum(bend**2)))
        gaps = steps > _GAP_S
        lost = float(np.sum(np.abs(np.diff(rate))[gaps] * steps[gaps])) if gaps.any() else 0.0
        return math.sqrt(white**2 + sampling**2 + lost**2 + self._wandered_rad2(steps[gaps]))

    def _wandered_rad2(self, gaps_s: FloatArray) -> float:
        """Return the variance of what was turned unheard: there the rate wanders, as it does elsewhere.

        It is known at both ends, a Brownian bridge, whose integral over T has the variance q T^3 / 12.
        """
        if not gaps_s.size:
            return 0.0
        wandered = self.rate_at(self.time_s + _GAP_S) - self.rate_radps
        return float((wandered**2).mean() / _GAP_S * (gaps_s**3).sum() / 12.0)


def turn_record(track: Track, instance: int = 1, level: Levels | None = None) -> TurnRecord | None:
    """Integrate the gyro about the vertical; None where the recording has no gyro.

    The bias comes from stretches in which the magnetometer `instance` shows that nothing turned. `level` is
    the recording's, where the caller has it already.
    """
    gyro = track.gyro_radps
    if gyro is None or len(gyro) < 3:
        return None
    usable = np.isfinite(gyro.values).all(axis=1)
    time, rates = gyro.time_s[usable], np.asarray(gyro.values)[usable]
    if time.size < 3:
        return None
    rates = uncut(rates, track.gyro_truncation_radps)
    down = (level or levels(track)).at(time)
    vertical = np.einsum("ij,ij->i", rates, down)
    horizontal = np.linalg.norm(rates - vertical[:, np.newaxis] * down, axis=1)
    known_autopilot = track.autopilot in ("ardupilot", "px4")
    prior = BOOT_BIAS_SIGMA_RADPS if known_autopilot else BARE_BIAS_SIGMA_RADPS
    bias, sigma = _vertical_bias(track, instance, time, vertical, prior)
    rate = vertical - bias
    steps = np.diff(time)
    turns = 0.5 * (rate[1:] + rate[:-1]) * steps + _turned_by_rolling(down)
    angle = np.concatenate([[0.0], np.cumsum(turns)])
    jumps = np.abs(np.diff(rate, 2))
    noise = float(np.percentile(jumps, 25)) / (0.3186 * math.sqrt(6.0)) if jumps.size else 0.0
    walking = max(noise, float(white_noise(time, rate[:, np.newaxis], quantile=0.25)[0]))
    return TurnRecord(
        time_s=time,
        angle_rad=angle,
        rate_radps=rate,
        tilt_rate_radps=horizontal,
        bias_radps=float(np.mean(bias)),
        bias_sigma_radps=sigma,
        noise_radps=noise,
        walk_rad=min(walking * math.sqrt(float(np.median(steps))), _witnessed_walk_rad(track, time, rates)),
        interval_s=float(np.median(steps)),
    )


def require_turn(track: Track, instance: int = 1) -> TurnRecord:
    """Return the turn by the gyro. Raises PoorCalibration where the recording has none."""
    record = turn_record(track, instance)
    if record is None:
        raise PoorCalibration(
            "The recording has no gyro, so neither stillness nor the turned angles are known.",
            "Record the angular rate too (RAW_IMU, SCALED_IMU or IMU messages).",
        )
    return record


def too_sparse(
    turns_rad: FloatArray, sigma_rad: FloatArray, rate_hz: float, least_rad: float = SPARSE_RAD
) -> PoorCalibration | None:
    """Say that a gyro told at a rate did not follow turns (N,): they are known to their sigmas (N,).

    None where there is no turn, or half of them are known better than `least_rad`.
    """
    turning = np.abs(turns_rad) > _LEAST_TURN_RAD
    if not turning.any() or (usual := float(np.median(sigma_rad[turning]))) < least_rad:
        return None
    return PoorCalibration(
        f"The gyro was recorded too seldom to follow the turns: {rate_hz:.1f} times a second, so that a turn"
        f" is known to {math.degrees(min(usual, math.pi)):.0f} degrees.",
        "Record it 10 times a second or more, or turn slower.",
    )


def _turned_by_rolling(down: FloatArray) -> FloatArray:
    """Return what the roll of a pitched vehicle turns its nose between samples, (N - 1,): roll' sin(pitch).

    No rate about the vertical shows it: a copter that leans by 15 degrees, all round, turns by twelve.
    """
    roll, pitch = tilt_from_acceleration(-down)
    return np.asarray(wrap_pi(np.diff(roll)) * 0.5 * (np.sin(pitch[1:]) + np.sin(pitch[:-1])))


def _witnessed_walk_rad(track: Track, time: FloatArray, rates: FloatArray) -> float:
    """Return how far the rates' sum walks from the autopilot's roll and pitch, as in one second.

    Vibration is not white: single rates show it, their sum hardly does. The estimator sums every reading of
    the gyro, of which a recording has some. Infinity where there is no attitude to tell.
    """
    if track.attitude_rad is None or time[-1] - time[0] < _FEWEST_WALKS * _WALK_S:
        return math.inf
    tilt = np.asarray(track.attitude_rad.at(time))[:, :2]
    roll, pitch = tilt.T
    upright = np.maximum(np.cos(pitch), 0.2)
    p, q, r = rates.T
    leaning = q * np.sin(roll) + r * np.cos(roll)
    turned = np.stack([p + leaning * np.sin(pitch) / upright, q * np.cos(roll) - r * np.sin(roll)], axis=1)
    steps = 0.5 * (turned[1:] + turned[:-1]) * np.diff(time)[:, np.newaxis]
    off = np.concatenate([np.zeros((1, 2)), np.cumsum(steps, axis=0)]) - np.unwrap(tilt, axis=0)
    edges = np.searchsorted(time, np.arange(time[0], time[-1], _WALK_S))
    walked = np.diff(off[edges], axis=0)
    walked = np.abs(walked - np.median(walked, axis=0))
    return math.hypot(float(np.median(walked)) / (0.6745 * math.sqrt(_WALK_S)), _UNSEEN_WALK_RAD)


def _vertical_bias(
    track: Track, instance: int, time: FloatArray, vertical: FloatArray, prior_sigma: float
) -> tuple[FloatArray, float]:
    """Estimate the vertical gyro bias, (N,), and its sigma from stretches without turning.

    The bias drifts with the gyro's temperature, so a stretch tells less of what is further away in time.

    In each window the magnetometer bounds the true rate: a field that moves by u mG/s in a horizontal
    field of H mG turns with u / H rad/s at most. That bound, and the noise of u, is the window's sigma.
    """
    compass = track.compasses.get(instance)
    if compass is None or len(compass.reported) < 8:
        return np.zeros(time.size), prior_sigma
    field_time, field = compass.time_s, np.asarray(compass.reported.values)
    swing = np.percentile(field, 98, axis=0) - np.percentile(field, 2, axis=0)
    amplitude = max(0.5 * float(np.sort(swing)[-2:].max()), 50.0)
    # Autopilots take the bias out at power-up: what turns much faster than that leaves is a turn.
    turning = _TURNING_SIGMAS * prior_sigma
    seen: list[tuple[float, float, float]] = []
    for start, end in _quiet_stretches(time, vertical, turning):
        rows = slice(*np.searchsorted(time, [start, end]))
        mags = slice(*np.searchsorted(field_time, [start, end]))
        if rows.stop - rows.start < 4 or mags.stop - mags.start < 4:
            continue
        slope, slope_sigma = _slope(field_time[mags], field[mags], compass.quantum_mgauss)
        if float(slope @ slope) > (_MOVING_SIGMAS * slope_sigma) ** 2:
            continue
        bound = math.sqrt(float(slope @ slope) + 2.0 * slope_sigma**2) / amplitude
        rate = vertical[rows]
        sigma = math.hypot(bound, float(rate.std()) / math.sqrt(rate.size))
        sigma = max(sigma, math.radians(0.01))
        seen.append((0.5 * (start + end), float(rate.mean()), sigma))
    return _drifting(time, seen, prior_sigma)


def _drifting(
    time: FloatArray, seen: list[tuple[float, float, float]], prior_sigma: float
) -> tuple[FloatArray, float]:
    """Find the bias at each time, (N,), and its usual sigma, from stretches (middle, rate, sigma).

    It is a smooth curve about an unknown constant, a Gaussian process: a gyro that warms up drifts for a
    minute and more the same way, so that stretches near in time tell its course, those far off its size.
    """
    if not seen:
        return np.zeros(time.size), prior_sigma
    middle, rate, sigma = _grouped(np.array(seen)).T
    apart = (middle[:, np.newaxis] - middle) / DRIFTS_FOR_S
    drifting = min(DRIFT_RADPS2 * DRIFTS_FOR_S, prior_sigma) ** 2
    believed = prior_sigma**2 - drifting * (1.0 - np.exp(-0.5 * apart**2))
    gain = np.linalg.solve(believed + np.diag(sigma**2), believed).T
    left = np.diag(believed) - np.einsum("ij,ji->i", gain, believed)
    usual = math.sqrt(max(float(np.median(left)), 0.0))
    best = min(float(sigma.min()), prior_sigma)
    bias = np.interp(time, middle, gain @ rate)
    return bias, max(usual, best / math.sqrt(_INDEPENDENT_WINDOWS))


def _grouped(seen: FloatArray) -> FloatArray:
    """Average neighbouring stretches (M, 3) of a long recording, so that few enough are left."""
    if len(seen) <= _MOST_STRETCHES:
        return seen
    groups = np.array_split(seen, _MOST_STRETCHES)
    rows = [np.average(group, axis=0, weights=group[:, 2] ** -2) for group in groups]
    return np.array(
        [[*row[:2], (group[:, 2] ** -2).sum() ** -0.5] for row, group in zip(rows, groups, strict=True)]
    )


def _quiet_stretches(time: FloatArray, rate: FloatArray, limit_radps: float) -> list[tuple[float, float]]:
    """List stretches of at most `_WINDOW_S` in which the gyro shows what it shows most, below a limit.

    A window across the end of a turn would show a turn as bias: its field moves too, but a few readings of
    noise hide that. What is shown most, by the shortest half of the readings, is standing.
    """
    mean = moving_average(time, rate[:, np.newaxis], _SMOOTHING_S)[:, 0]
    slow = np.sort(mean[np.abs(mean) < limit_radps])
    if slow.size < 4:
        return []
    half = slow.size // 2
    narrowest = int(np.argmin(slow[half:] - slow[:-half]))
    usual = float(slow[narrowest : narrowest + half + 1].mean())
    quiet = (np.abs(mean - usual) < _STEADY_RADPS) & (np.abs(mean) < limit_radps)
    out: list[tuple[float, float]] = []
    for first, end in stretches(quiet):
        start, length = float(time[first]), float(time[end - 1] - time[first])
        if length < _SHORTEST_S:
            continue
        cuts = np.linspace(start, start + length, max(math.ceil(length / _WINDOW_S - 1e-6), 1) + 1)
        out += [(float(a), float(b)) for a, b in pairwise(cuts)]
    return out


def stretches(marked: NDArray[np.bool_]) -> list[tuple[int, int]]:
    """List where each run of marked samples, (N,), begins, and where it has ended."""
    edges = np.flatnonzero(np.diff(np.concatenate([[False], marked, [False]]).astype(np.int8)))
    return [(int(first), int(end)) for first, end in edges.reshape(-1, 2)]


def _slope(time: FloatArray, field: FloatArray, quantum: float) -> tuple[FloatArray, float]:
    """Fit a straight line to each axis: the slopes (3,) and their common sigma, mG/s."""
    t = time - time.mean()
    power = float(t @ t)
    if power <= 0.0:
        return np.zeros(3), math.inf
    slope = t @ field / power
    residual = field - field.mean(axis=0) - t[:, np.newaxis] * slope
    noise = math.sqrt(float((residual**2).mean()) * 1.5)
    # Repeated readings are not new evidence: a compass is read about ten times a second.
    fresh = min(time.size, max(10.0 * float(time[-1] - time[0]), 4.0))
    # Whole numbers hide a creep of up to a step in the window's length.
    hidden = quantum / (math.sqrt(12.0) * max(float(time[-1] - time[0]), 1e-3))
    return slope, math.hypot(noise / math.sqrt(power * fresh / time.size), hidden)
