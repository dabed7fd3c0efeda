"""Find where a vehicle stood still: in a recording at once, or live, reading by reading.

Still means: turned slowly enough that the field can be averaged. A rover whose heading hold is closed
on a bent compass creeps by one to three degrees per second while it "stands"; that is still enough,
because the gyro knows the creep and a dwell's average accounts for it.
"""

from __future__ import annotations

import math
from bisect import insort
from collections import deque
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from mavcompass.calibration.observation.dwells import (
    Dwell,
    FourPositionData,
    Step,
    dwell_between,
    field_lag_s,
)
from mavcompass.calibration.observation.turning import GYRO_SCALE_SIGMA, TurnRecord, turn_record
from mavcompass.errors import PoorCalibration
from mavcompass.frames import FloatArray
from mavcompass.track import Track
from mavcompass.units import STANDARD_GRAVITY_MPS2

STILL_RATE_RADPS = math.radians(3.0)
STILL_TILT_RATE_RADPS = math.radians(6.0)
# Hunting inside these limits can be averaged over; more of it makes a new position.
LONGEST_SWING_RAD = math.radians(14.0)
SHORTEST_DWELL_S = 1.0
_RATE_SMOOTHING_S = 0.5
# After the vehicle has come to rest the compass still averages the turn.
_SETTLE_S = 0.25
# Half the arc of a position cut from a continuous turn: wide averages a hand's wobble, and the
# coherence accounts for the width exactly.
_CUT_HALF_WIDTH_RAD = math.radians(20.0)
_MOST_DWELLS = 48
_CURRENT_STEP_A = 4.0
# White noise of the tilt rate has a mean of its own: the length of two noisy components.
_TILT_FLOOR = 1.3
# Two readings of a noisy compass lie so many sigmas of one component apart once in a hundred thousand.
_FIELD_CHANCE = 7.5


def find_dwells(
    track: Track,
    instance: int = 1,
    turn: TurnRecord | None = None,
    shortest_s: float = SHORTEST_DWELL_S,
    positions_per_turn: int = 4,
) -> list[Dwell]:
    """Find the still positions of a recording, in time order.

    Where a recording turns all the way round without ever standing still, short positions are cut out
    of the turn, `positions_per_turn` to a turn, evenly by the gyro.
    Raises PoorCalibration where the recording has no gyro, KeyError for an unknown compass.
    """
    compass = track.compasses[instance]
    record = turn if turn is not None else turn_record(track, instance)
    if record is None:
        raise PoorCalibration(
            "The recording has no gyro, so neither stillness nor the turned angles are known.",
            "Record the angular rate too (RAW_IMU, SCALED_IMU or IMU messages).",
        )
    windows = [
        part
        for window in _still_windows(record, shortest_s)
        for part in _steady_current(track, window, shortest_s)
    ]
    if len(compass.time_s):
        windows = [
            w for w in windows if np.ptp(np.searchsorted(compass.time_s, w)) >= 4 and w[1] > compass.time_s[0]
        ]
    if _spread(record, windows) < math.radians(150.0):
        cut = _cut_from_turn(record, compass.time_s, positions_per_turn)
        windows = cut if len(cut) >= 3 else windows
    windows = sorted(sorted(windows, key=lambda w: w[0] - w[1])[:_MOST_DWELLS])
    return [dwell_between(track, instance, start, end, record) for start, end in windows]


def _still_windows(record: TurnRecord, shortest_s: float) -> list[tuple[float, float]]:
    """List (start, end) of the stretches with little rotation, split where their swing grows too long."""
    time = record.time_s
    rate = _centred_mean(time, record.rate_radps)
    tilt = _centred_mean(time, record.tilt_rate_radps)
    tilt_floor = _TILT_FLOOR * record.noise_radps
    quiet = (np.abs(rate) < STILL_RATE_RADPS) & (tilt < STILL_TILT_RATE_RADPS + tilt_floor)
    edges = np.flatnonzero(np.diff(np.concatenate([[False], quiet, [False]]).astype(np.int8)))
    windows = []
    for first, end in zip(edges[::2], edges[1::2], strict=True):
        start = first
        while start < end:
            angles = record.angle_rad[start:end]
            low, high = np.minimum.accumulate(angles), np.maximum.accumulate(angles)
            beyond = np.flatnonzero(high - low > LONGEST_SWING_RAD)
            stop = int(start + beyond[0]) if beyond.size else int(end)
            stop = max(stop, int(start) + 1)
            begins = float(time[start]) + (_SETTLE_S if start > 0 else 0.0)
            ends = float(time[min(stop, time.size - 1)])
            if ends - begins >= shortest_s:
                windows.append((begins, ends))
            start = stop
    return windows


def _steady_current(
    track: Track, window: tuple[float, float], shortest_s: float
) -> list[tuple[float, float]]:
    """Split a still stretch where the battery current jumps (a take-off): the motors' field jumps with it."""
    current = track.current_a
    if current is None:
        return [window]
    rows = slice(*np.searchsorted(current.time_s, window))
    time, load = current.time_s[rows], current.values[rows]
    if time.size < 3 or not np.isfinite(load).all():
        return [window]
    parts: list[tuple[float, float]] = []
    start, ordered = window[0], [float(load[0])]  # kept in order, so that the median is at hand
    for k in range(1, time.size + 1):
        level = 0.5 * (ordered[(len(ordered) - 1) // 2] + ordered[len(ordered) // 2])
        if k < time.size and abs(load[k] - level) <= max(_CURRENT_STEP_A, 0.25 * abs(level)):
            insort(ordered, float(load[k]))
            continue
        end = float(time[k]) if k < time.size else window[1]
        if end - start >= shortest_s:
            parts.append((start, end))
        start, ordered = end, load[k : k + 1].tolist()
    return parts


def _centred_mean(time: FloatArray, values: FloatArray) -> FloatArray:
    total = np.concatenate([[0.0], np.cumsum(values)])
    first = np.searchsorted(time, time - _RATE_SMOOTHING_S / 2.0, side="left")
    last = np.searchsorted(time, time + _RATE_SMOOTHING_S / 2.0, side="right")
    return np.asarray((total[last] - total[first]) / (last - first))


def _spread(record: TurnRecord, windows: list[tuple[float, float]]) -> float:
    """Return how much of the circle the windows reach over: 2 pi less the largest empty arc."""
    if not windows:
        return 0.0
    middles = record.angle_at(np.array([0.5 * (a + b) for a, b in windows])) % (2.0 * math.pi)
    ordered = np.sort(middles)
    gaps = np.diff(np.concatenate([ordered, [ordered[0] + 2.0 * math.pi]]))
    return 2.0 * math.pi - float(gaps.max())


def _cut_from_turn(record: TurnRecord, compass_time: FloatArray, per_turn: int) -> list[tuple[float, float]]:
    """Cut short positions out of a continuous turn, evenly spaced by the gyro's angle."""
    if compass_time.size < 2:
        return []
    span = slice(*np.searchsorted(record.time_s, [compass_time[0], compass_time[-1]]))
    time, angle = record.time_s[span], record.angle_rad[span]
    if time.size < 4 or abs(float(angle[-1] - angle[0])) < math.radians(200.0):
        return []
    sense = math.copysign(1.0, float(angle[-1] - angle[0]))
    progress = np.maximum.accumulate(sense * (angle - angle[0]))
    spacing = 2.0 * math.pi / per_turn
    middles = np.arange(_CUT_HALF_WIDTH_RAD, progress[-1] - _CUT_HALF_WIDTH_RAD + 1e-9, spacing)
    windows = []
    for middle in middles:
        start, end = np.searchsorted(progress, [middle - _CUT_HALF_WIDTH_RAD, middle + _CUT_HALF_WIDTH_RAD])
        window = (float(time[start]), float(time[min(end, time.size - 1)]))
        if np.ptp(np.searchsorted(compass_time, window)) >= 4:
            windows.append(window)
    return windows


def turns_between(
    track: Track, dwells: list[Dwell], instance: int = 1, turn: TurnRecord | None = None
) -> list[Step]:
    """Measure the turns between dwells with the gyro: from the mean angle of one to that of the next.

    Raises PoorCalibration where the recording has no gyro.
    """
    record = turn if turn is not None else turn_record(track, instance)
    if record is None:
        raise PoorCalibration(
            "The recording has no gyro, so the turned angles are not known.",
            "Record the angular rate too (RAW_IMU, SCALED_IMU or IMU messages).",
        )
    lag = field_lag_s(track)
    times = track.compasses[instance].time_s
    angles = []
    for dwell in dwells:
        rows = slice(*np.searchsorted(times, [dwell.start_s, dwell.end_s + 1e-9]))
        inside = record.angle_at(times[rows] - lag)
        middle = float(np.median(inside))
        angles.append(middle + float(np.angle(np.exp(1j * (inside - middle)).mean())))
    steps = []
    for first, second, a, b in zip(dwells[:-1], dwells[1:], angles[:-1], angles[1:], strict=True):
        start, end = 0.5 * (first.start_s + first.end_s), 0.5 * (second.start_s + second.end_s)
        gyro = record.independent_sigma_rad(first.end_s, second.start_s)
        sigma = math.sqrt(gyro**2 + first.turned_sigma_rad**2 + second.turned_sigma_rad**2)
        steps.append(Step(b - a, sigma, end - start))
    return steps


def observe(track: Track, instance: int = 1, turn: TurnRecord | None = None) -> FourPositionData:
    """Find the dwells of a recording and measure the turns between them.

    Raises PoorCalibration where the recording has no gyro or hardly turns, KeyError for an unknown compass.
    """
    record = turn if turn is not None else turn_record(track, instance)
    dwells = find_dwells(track, instance, record)
    if len(dwells) < 3 and record is not None:
        turned = math.degrees(float(np.ptp(record.angle_rad)))
        if turned < 200.0:
            raise PoorCalibration(
                f"Too little motion: the vehicle's heading changed by only {turned:.0f} degrees in all.",
                "Turn it on the level in four steps of about 90 degrees and stop after each.",
            )
    return assemble(track, dwells, instance, record)


def assemble(
    track: Track, dwells: list[Dwell], instance: int = 1, turn: TurnRecord | None = None
) -> FourPositionData:
    """Put dwells that the caller chose together with the turns between them.

    Raises PoorCalibration where the recording has no gyro.
    """
    record = turn if turn is not None else turn_record(track, instance)
    steps = turns_between(track, dwells, instance, record) if dwells else []
    return FourPositionData(
        dwells=tuple(dwells),
        steps=tuple(steps),
        gyro_scale_sigma=GYRO_SCALE_SIGMA,
        gyro_bias_sigma_radps=record.bias_sigma_radps if record is not None else 0.0,
        source=track.source,
    )


# What `Stillness.why_not` means, for a person.
UNREST = {
    "rotating": "it still turns",
    "hunting": "its nose still swings",
    "tilting": "it still rocks",
    "field changing": "the magnetic field changes; is iron or a current moving near it?",
    "starting": "the first readings",
}


@dataclass(frozen=True, slots=True)
class Stillness:
    """Say whether a vehicle stands still.

    Attributes:
        still: True once it has been quiet for the detector's hold time.
        since_s: the time since when it has been quiet (nan while it is not).
        why_not: "rotating", "hunting", "tilting", "field changing", "starting", or "" when still.
        rate_radps: mean rate about the vertical over the last half second, clockwise positive.
        turned_rad: the angle turned since the detector was made.
    """

    still: bool
    since_s: float
    why_not: str
    rate_radps: float
    turned_rad: float


class WhiteNoise:
    """Follow the white noise of a vector, per component, by the second differences of its latest samples.

    Smooth motion hardly shows in these, and the median is not moved by a few that are no noise. Samples that
    are repeated show none.
    """

    def __init__(self, samples: int = 40) -> None:
        self._before: deque[tuple[float, ...]] = deque(maxlen=2)
        self._bends: deque[tuple[float, ...]] = deque(maxlen=samples)

    def hear(self, values: tuple[float, ...]) -> None:
        """Take the next sample."""
        if len(self._before) == 2:
            first, second = self._before
            self._bends.append(
                tuple(abs(a - 2.0 * b + c) for a, b, c in zip(first, second, values, strict=True))
            )
        self._before.append(values)

    @property
    def sigma(self) -> float:
        """Return the root of the mean square of the components' sigmas; 0 while too little was heard."""
        if len(self._bends) < 8:
            return 0.0
        medians = [sorted(column)[len(column) // 2] for column in zip(*self._bends, strict=True)]
        return math.hypot(*medians) / math.sqrt(len(medians)) / (0.6745 * math.sqrt(6.0))


class StillnessDetector:
    """Tell, reading by reading, whether the vehicle stands still enough to average the compass.

    It has no clock: the time comes with the readings. `hold_s` is how long quiet must last before the
    vehicle counts as still; `swing_rad` how far it may creep meanwhile.
    """

    def __init__(
        self,
        hold_s: float = 1.0,
        rate_radps: float = STILL_RATE_RADPS,
        swing_rad: float = LONGEST_SWING_RAD,
        field_step_mgauss: float = 60.0,
    ) -> None:
        self._hold_s = hold_s
        self._limit = rate_radps
        self._swing = swing_rad
        self._field_step = field_step_mgauss
        self._window: deque[tuple[float, float, float]] = deque()
        self._tilt_noise, self._force_noise, self._field_noise = WhiteNoise(), WhiteNoise(), WhiteNoise()
        self._turned = 0.0
        self._last: tuple[float, float] | None = None
        self._quiet_since = math.nan
        self._quiet_from = (0.0, (0.0, 0.0, 0.0))
        self._down = (0.0, 0.0, 1.0)
        self._reason = "starting"

    def update(
        self, time_s: float, gyro_radps: ArrayLike, acc_mps2: ArrayLike, mag_mgauss: ArrayLike
    ) -> Stillness:
        """Take one reading of each sensor, body FRD, and judge.

        A reading older than the one before (a late or repeated packet) changes nothing.
        """
        gx, gy, gz = (float(v) for v in np.asarray(gyro_radps, dtype=np.float64))
        ax, ay, az = (float(v) for v in np.asarray(acc_mps2, dtype=np.float64))
        mx, my, mz = (float(v) for v in np.asarray(mag_mgauss, dtype=np.float64))
        if self._last is not None and time_s <= self._last[0]:
            return self._state(self._last[0])
        self._follow_gravity(time_s, (ax, ay, az))
        dx, dy, dz = self._down
        rate = gx * dx + gy * dy + gz * dz
        tilt_rate = math.hypot(gx - rate * dx, gy - rate * dy, gz - rate * dz)
        if self._last is not None:
            self._turned += 0.5 * (rate + self._last[1]) * (time_s - self._last[0])
        self._last = (time_s, rate)
        self._tilt_noise.hear((gx - rate * dx, gy - rate * dy, gz - rate * dz))
        self._force_noise.hear((ax, ay, az))
        self._field_noise.hear((mx, my, mz))
        self._window.append((time_s, rate, tilt_rate))
        while self._window[0][0] < time_s - _RATE_SMOOTHING_S:
            self._window.popleft()
        self._judge(time_s, (mx, my, mz))
        return self._state(time_s)

    def averaging_s(self, tilt_rad: float, field_mgauss: float) -> float:
        """Return how long to average until white noise leaves so little of the tilt and of the field.

        Both are sigmas of the mean, of one component.
        """
        if len(self._window) < 2:
            return 0.0
        interval_s = (self._window[-1][0] - self._window[0][0]) / (len(self._window) - 1)
        tilt = self._force_noise.sigma / (STANDARD_GRAVITY_MPS2 * tilt_rad)
        field = self._field_noise.sigma / field_mgauss
        return max(tilt, field) ** 2 * interval_s

    def _follow_gravity(self, time_s: float, acc: tuple[float, float, float]) -> None:
        length = math.hypot(*acc)
        if not math.isfinite(length) or length < 1.0:
            return
        down = tuple(-a / length for a in acc)
        if self._last is None:
            self._down = (down[0], down[1], down[2])
            return
        gain = min((time_s - self._last[0]) / 0.5, 1.0)
        mixed = [old + gain * (new - old) for old, new in zip(self._down, down, strict=True)]
        size = math.hypot(*mixed) or 1.0
        self._down = (mixed[0] / size, mixed[1] / size, mixed[2] / size)

    def _judge(self, time_s: float, mag: tuple[float, float, float]) -> None:
        rate = self._mean(1)
        tilt = self._mean(2)
        if abs(rate) > 3.0 * self._limit:
            self._stir("rotating")
        elif abs(rate) > self._limit:
            self._stir("hunting")
        elif tilt > STILL_TILT_RATE_RADPS + _TILT_FLOOR * self._tilt_noise.sigma:
            self._stir("tilting")
        elif math.isnan(self._quiet_since):
            self._begin(time_s, mag)
        else:
            turned, field = self._quiet_from
            if abs(self._turned - turned) > self._swing:
                self._begin(time_s, mag)
                self._reason = "hunting"
            elif math.dist(mag, field) > self._field_limit(abs(self._turned - turned)):
                self._begin(time_s, mag)
                self._reason = "field changing"

    def _field_limit(self, turned_rad: float) -> float:
        """Return how far one reading may lie from another at rest, by chance and by so small a turn, mG."""
        chance = _FIELD_CHANCE * self._field_noise.sigma
        return math.hypot(self._field_step, chance) + 300.0 * turned_rad

    def _mean(self, column: int) -> float:
        return sum(row[column] for row in self._window) / len(self._window)

    def _stir(self, reason: str) -> None:
        self._quiet_since = math.nan
        self._reason = reason

    def _begin(self, time_s: float, mag: tuple[float, float, float]) -> None:
        self._quiet_since = time_s
        self._quiet_from = (self._turned, mag)

    def _state(self, time_s: float) -> Stillness:
        still = not math.isnan(self._quiet_since) and time_s - self._quiet_since >= self._hold_s
        return Stillness(
            still=still,
            since_s=self._quiet_since,
            why_not="" if still else self._reason,
            rate_radps=self._mean(1) if self._window else 0.0,
            turned_rad=self._turned,
        )
