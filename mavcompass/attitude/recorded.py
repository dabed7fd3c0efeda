"""Roll and pitch of what a vehicle says: message by message where it is live, and all through a recording.

Through a recording the live filter is run forward and backward.
"""

from __future__ import annotations

import math
from collections import deque
from copy import copy
from dataclasses import dataclass
from functools import lru_cache

import numpy as np

from mavcompass import messages as mav
from mavcompass.attitude.level import (
    BIAS_SIGMA_RADPS,
    ESTIMATOR_SIGMA_RAD,
    FLOOR_RAD,
    LASTS_S,
    RECEIVER_LAG_S,
    UNKNOWN_RAD,
    Level,
)
from mavcompass.frames import FloatArray
from mavcompass.gravity import no_gravity
from mavcompass.messages import telemetry
from mavcompass.track import Series, Track, uncut
from mavcompass.units import MPS2_PER_MILLI_G, RADPS_PER_MILLIRADPS

# No fix is older; some send the time of day with their position.
_OTHER_CLOCK_S = 2.0
# No vehicle is faster; and no finite number that a wire may bring beyond it does harm.
_FASTEST_MPS = 400.0


def hear(level: Level, message: mav.Message) -> None:
    """Take one message of a vehicle; those that tell nothing of its level are passed over."""
    if isinstance(message, mav.ScaledImu2 | mav.ScaledImu3):
        return  # of another sensor, or of none
    if isinstance(message, mav.RawImu | mav.ScaledImu):
        g, w = MPS2_PER_MILLI_G, RADPS_PER_MILLIRADPS
        level.update(
            telemetry.imu_time_s(message),
            (_uncut(message.xacc) * g, _uncut(message.yacc) * g, _uncut(message.zacc) * g),
            (_uncut(message.xgyro) * w, _uncut(message.ygyro) * w, _uncut(message.zgyro) * w),
        )
    elif isinstance(message, mav.Attitude):
        if math.isfinite(message.roll) and math.isfinite(message.pitch):
            level.hear_attitude(message.time_boot_ms * 1e-3, message.roll, message.pitch)
    elif isinstance(message, mav.GpsRawInt):
        north, east, _ = telemetry.ground_velocity_mps(message).tolist()
        moment_s = message.time_usec * 1e-6
        if abs(moment_s - level.time_s) > _OTHER_CLOCK_S:
            moment_s = level.time_s
        if math.hypot(north, east) < _FASTEST_MPS:  # which nan is not
            level.hear_velocity(moment_s - RECEIVER_LAG_S, north, east)


def _uncut(number: int) -> float:
    """Put a number that was cut toward zero into the middle of its step."""
    return number + 0.5 * ((number > 0) - (number < 0))


# More readings a second say no more of roll and pitch.
_STEP_S = 0.04
# Between readings further apart nothing is bridged.
_LONGEST_GAP_S = 0.5
_SMOOTHING_S, _PUSHES_FOR_S = 0.6, 2.0
# How often the filter is kept, and of how long a run: of a look at what is near, not of a whole recording.
_KEPT_EVERY, _KEPT_ROWS = 16, 2048


@dataclass(frozen=True, slots=True, eq=False)
class Levels:
    """Hold which way is down, in body axes, (N, 3), and the sigma of roll and of pitch, (N,)."""

    down: Series
    sigma_rad: Series

    @property
    def lasting_rad(self) -> float:
        """Return what roll and pitch are off by all along while it travels, in body axes, 1 sigma.

        The filter does not follow a vertical gyro's bias. What leans, as a plane in its bend, feels the sine
        of its lean of it about the horizon, for as long as the filter remembers; leaning to both sides
        averages it out (ArduPlane 4.5.7 circling to one side for six minutes: 0.32 degrees, 0.58 claimed).
        """
        lean = np.asarray(self.down.values)[:, :2].mean(axis=0)
        return BIAS_SIGMA_RADPS * LASTS_S * float(np.hypot(*lean))

    def at(self, time_s: FloatArray) -> FloatArray:
        """Return down at other times, unit vectors, (M, 3)."""
        down = np.asarray(self.down.at(time_s))
        return np.asarray(down / np.maximum(np.linalg.norm(down, axis=1, keepdims=True), 1e-9))


def levels(track: Track, from_s: float = -math.inf) -> Levels:
    """Tell roll and pitch by all that was recorded; where nothing was, level, with the sigma of that.

    Beside an accelerometer that shows no gravity nothing is known of them, by an autopilot's word neither.
    Before `from_s` they are as they were known then: what came after it is not asked once more.
    """
    return _levels(
        track.acc_mps2,
        track.gyro_radps,
        track.attitude_rad,
        track.receiver_velocity_mps or track.gps_velocity_mps,
        track.vehicle,
        track.autopilot in ("ardupilot", "px4"),
        (track.acc_truncation_mps2, track.gyro_truncation_radps),
        from_s,
    )


def down_in_body(track: Track, time_s: FloatArray) -> FloatArray:
    """Return the unit vector that points down, in body axes, (N, 3), without using any yaw."""
    return levels(track).at(time_s)


# Series are told apart by identity: every door that asks about one recording gets one answer.
@lru_cache(maxsize=4)
def _levels(
    acc: Series | None,
    gyro: Series | None,
    attitude: Series | None,
    velocity: Series | None,
    vehicle: str,
    flown: bool,
    steps: tuple[float, float],
    from_s: float,
) -> Levels:
    trouble = no_gravity(acc)
    acc, gyro, attitude = _finite(acc), _finite(gyro), _finite(attitude)
    if trouble:
        found = _without_gyro(acc, attitude)
        time = found.down.time_s
        return Levels(found.down, Series.of(time, np.full(time.size, UNKNOWN_RAD)))
    if acc is None or gyro is None:
        return _without_gyro(acc, attitude)
    time, rate, force = _thinned(
        gyro.time_s, uncut(gyro.values, steps[1]), uncut(acc.at(gyro.time_s), steps[0])
    )
    if not flown and _contradicts(time, rate, force):
        return _without_gyro(acc, attitude)
    told = _told(time, attitude)
    speed = _finite(None if velocity is None else Series(velocity.time_s, velocity.values[:, :2]))
    ahead = _run(vehicle, time, rate, force, told, speed, 1.0)
    # From the step before it, so that what is asked for lies between two.
    first = max(int(np.searchsorted(time, from_s, side="right")) - 1, 0)
    back = np.full((time.size, 4), math.inf)
    back[:, :3] = 0.0
    late = None if told is None else (told[0][first:], told[1][first:])
    back[first:] = _run(vehicle, time[first:], rate[first:], force[first:], late, speed, -1.0)
    weight, other = 1.0 / ahead[:, 3], 1.0 / back[:, 3]
    down = weight[:, np.newaxis] * ahead[:, :3] + other[:, np.newaxis] * back[:, :3]
    down /= np.maximum(np.linalg.norm(down, axis=1, keepdims=True), 1e-9)
    # What an autopilot errs by is the same both ways.
    shared = ESTIMATOR_SIGMA_RAD**-2.0 if told is not None else 0.0
    known = np.maximum(weight + other - shared, np.maximum(weight, other))
    return Levels(Series.of(time, down), Series.of(time, np.sqrt(1.0 / known + FLOOR_RAD**2)))


def _finite(series: Series | None) -> Series | None:
    if series is None or not len(series):
        return None
    usable = np.asarray(np.isfinite(series.values).all(axis=1), dtype=np.bool_)
    usable[1:] &= np.diff(series.time_s) > 0.0
    return Series(series.time_s[usable], series.values[usable]) if usable.any() else None


def _thinned(
    time: FloatArray, rate: FloatArray, force: FloatArray
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Average neighbours of what came faster than `_STEP_S`."""
    many = int(_STEP_S / max(float(np.median(np.diff(time))), 1e-4)) if time.size > 1 else 1
    if many < 2:
        return time, rate, force
    first = np.arange(0, time.size, many)
    count = np.diff(first, append=time.size)
    sums = [np.add.reduceat(values, first, axis=0) for values in (time, rate, force)]
    return sums[0] / count, sums[1] / count[:, np.newaxis], sums[2] / count[:, np.newaxis]


def _contradicts(time: FloatArray, rate: FloatArray, force: FloatArray) -> bool:
    """Tell whether a gyro turns the other way than gravity does: no autopilot has seen to its axes."""
    if time.size < 3:
        return False
    down = -force / np.maximum(np.linalg.norm(force, axis=1, keepdims=True), 1e-9)
    turns = np.cross(down, rate)
    return bool((np.gradient(down, time, axis=0) * turns).sum() < 0.0)


def _told(time: FloatArray, attitude: Series | None) -> tuple[FloatArray, FloatArray] | None:
    """Return the autopilot's time, roll and pitch nearest to each step; nan where none is near."""
    if attitude is None:
        return None
    near = attitude.nearest_rows(time)
    at, angles = attitude.time_s[near], np.array(attitude.values[near, :2])
    fresh = np.abs(at - time) <= np.minimum(np.gradient(time), 0.1) if time.size > 1 else np.ones(1, bool)
    angles[~fresh] = np.nan
    return at, angles


@dataclass(frozen=True, slots=True, eq=False)
class _Run:
    """Hold a run of the filter: of what, what it gave, and the filter after so many rows and velocities."""

    of: tuple[str, float, float]
    rows: FloatArray
    speeds: FloatArray
    out: FloatArray
    kept: list[tuple[int, int, Level]]

    def until(self, of: tuple[str, float, float], rows: FloatArray, speeds: FloatArray) -> int:
        """Return which kept filter is the latest that saw the beginning of this and no more; -1 for none."""
        if self.of != of:
            return -1
        n, m = min(len(rows), len(self.rows)), min(len(speeds), len(self.speeds))
        same = _same_rows(rows[:n], self.rows[:n])
        heard = np.searchsorted(speeds[:, 0], rows[:n, 0], side="right")
        alike = _same_rows(speeds[:m], self.speeds[:m])
        fits = (k <= same and at == heard[k - 1] <= alike for k, at, _ in self.kept)
        return max((which for which, fit in enumerate(fits) if fit), default=-1)


def _same_rows(one: FloatArray, other: FloatArray) -> int:
    """Return how many first rows are alike."""
    alike = ((one == other) | (np.isnan(one) & np.isnan(other))).all(axis=1)
    return len(alike) if alike.all() else int(np.argmin(alike))


# A live session asks about what has only grown: such a run goes on from where the one before it was.
_runs: deque[_Run] = deque(maxlen=4)


def _run(
    vehicle: str,
    time: FloatArray,
    rate: FloatArray,
    force: FloatArray,
    told: tuple[FloatArray, FloatArray] | None,
    speed: Series | None,
    sign: float,
) -> FloatArray:
    """Run the filter along time (sign 1) or against it (-1): down and variance, (N, 4)."""
    interval = float(np.median(np.diff(time))) if time.size > 1 else 0.0
    longest_s = max(_LONGEST_GAP_S, 3.0 * interval)
    order = slice(None, None, int(sign))
    attitudes = (
        np.full((time.size, 3), np.nan) if told is None else np.column_stack([sign * told[0], told[1]])
    )
    rows = np.column_stack([sign * time, force, sign * rate, attitudes])[order]
    speeds = np.empty((0, 3))
    if speed is not None:
        speeds = sign * np.column_stack([speed.time_s - RECEIVER_LAG_S, speed.values])[order]
    of, out, level = (vehicle, longest_s, sign), np.empty((time.size, 4)), Level(vehicle, longest_s)
    start, place, kept = 0, 0, list[tuple[int, int, Level]]()
    for run in tuple(_runs):
        which = run.until(of, rows, speeds)
        if which >= 0 and run.kept[which][0] > start:
            kept = run.kept[: which + 1]
            start, place, level = kept[-1]
            out[:start] = run.out[:start]
    level, moments = copy(level), speeds[:, 0].tolist()
    moved, found = speeds[:, 1:].tolist(), []
    for k, row in enumerate(rows[start:].tolist(), start + 1):
        now = row[0]
        level.update(now, row[1:4], row[4:7])
        if row[8] == row[8]:
            level.hear_attitude(row[7], row[8], row[9])
        while place < len(moments) and moments[place] <= now:
            level.hear_velocity(moments[place], *moved[place])
            place += 1
        found.append((*level.down, level.variance))
        if sign > 0.0 and k % _KEPT_EVERY == 0 and len(rows) <= _KEPT_ROWS:
            kept.append((k, place, copy(level)))
    out[start:] = np.reshape(found, (-1, 4))
    if kept:
        _runs.append(_Run(of, rows, speeds, out, kept))
    return out[order]


def _without_gyro(acc: Series | None, attitude: Series | None) -> Levels:
    """Take the autopilot's word, or the smoothed accelerometer's; where neither was recorded, it is level."""
    if attitude is not None:
        time, (roll, pitch) = attitude.time_s, attitude.values[:, :2].T
        down = np.stack([-np.sin(pitch), np.cos(pitch) * np.sin(roll), np.cos(pitch) * np.cos(roll)], axis=1)
        return Levels(Series.of(time, down), Series.of(time, np.full(time.size, ESTIMATOR_SIGMA_RAD)))
    if acc is None:
        return Levels(Series.of([0.0], [[0.0, 0.0, 1.0]]), Series.of([0.0], [0.0]))
    time, force = acc.time_s, np.asarray(acc.values)
    mean = moving_average(time, force, _SMOOTHING_S)
    jumps = np.abs(np.diff(force, axis=0)) if time.size > 1 else np.zeros((1, 3))
    noise2 = float(np.mean((np.median(jumps, axis=0) / (0.6745 * math.sqrt(2.0))) ** 2))
    readings = max(_SMOOTHING_S / max(float(np.median(np.diff(time))), 1e-3), 1.0) if time.size > 1 else 1.0
    # Noise averages out. A push shows in the length of the force, as much of it as stands along it.
    g = np.maximum(np.linalg.norm(mean, axis=1), 1e-9)
    pushed2 = moving_average(time, ((g - np.median(g)) ** 2)[:, np.newaxis], _PUSHES_FOR_S)[:, 0]
    sigma = np.hypot(np.sqrt(noise2 / readings + pushed2) / g, FLOOR_RAD)
    return Levels(Series.of(time, -mean / g[:, np.newaxis]), Series.of(time, sigma))


def moving_average(time_s: FloatArray, values: FloatArray, width_s: float) -> FloatArray:
    """Average columns, (N, k), over a centred window of a fixed length in time."""
    total = np.vstack([np.zeros(values.shape[1]), np.cumsum(values, axis=0)])
    first = np.searchsorted(time_s, time_s - width_s / 2.0, side="left")
    last = np.searchsorted(time_s, time_s + width_s / 2.0, side="right")
    return np.asarray((total[last] - total[first]) / (last - first)[:, np.newaxis])
