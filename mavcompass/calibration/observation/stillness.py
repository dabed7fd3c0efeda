"""Find where a vehicle stood still in a recording, and how far it turned between.

Still means: turned slowly enough that the field can be averaged. A rover whose heading hold is closed
on a bent compass creeps by one to three degrees per second while it "stands"; that is still enough,
because the gyro knows the creep and a dwell's average accounts for it.
"""

from __future__ import annotations

import math
from bisect import insort
from collections.abc import Sequence
from itertools import pairwise

import numpy as np

from mavcompass.attitude import levels, moving_average
from mavcompass.calibration.observation.detector import (
    LONGEST_SWING_RAD,
    RATE_SMOOTHING_S,
    STILL_RATE_RADPS,
    STILL_TILT_RATE_RADPS,
    TILT_FLOOR,
)
from mavcompass.calibration.observation.dwells import (
    UNSEEN_BIAS_RAD,
    Dwell,
    FourPositionData,
    Step,
    accelerometer_sigma_rad,
    dwell_between,
)
from mavcompass.calibration.observation.turning import (
    GYRO_SCALE_SIGMA,
    TurnRecord,
    require_turn,
    stretches,
    too_sparse,
    turn_record,
)
from mavcompass.errors import PoorCalibration
from mavcompass.frames import NO_HEADING_RAD, FloatArray, circle_covered_rad
from mavcompass.track import Track

_SHORTEST_DWELL_S = 1.0
# Slower, by the receiver's own noise, a vehicle is on the spot.
_STANDS_MPS = 0.5
# After the vehicle has come to rest the compass still averages the turn.
_SETTLE_S = 0.25
# Half the arc of a position cut from a continuous turn: wide averages a hand's wobble, and a dwell's
# swing accounts for the width exactly.
_CUT_HALF_WIDTH_RAD = math.radians(20.0)
_CUT_PER_TURN = 4
_MOST_DWELLS = 48
_CURRENT_STEP_A = 4.0


def find_dwells(
    track: Track,
    instance: int = 1,
    turn: TurnRecord | None = None,
    cut: bool = True,
) -> list[Dwell]:
    """Find the still positions of a recording, in time order.

    Where a recording turns all the way round without ever standing still, short positions are `cut` out
    of the turn, four to a turn, evenly by the gyro.
    Raises PoorCalibration where the recording has no gyro, KeyError for an unknown compass.
    """
    compass = track.compasses[instance]
    record = turn or require_turn(track, instance)
    windows = [part for window in _still_windows(record) for part in _steady_current(track, window)]

    def heard(found: list[tuple[float, float]]) -> list[tuple[float, float]]:
        return [
            w for w in found if not len(compass.time_s) or np.ptp(np.searchsorted(compass.time_s, w)) >= 4
        ]

    windows = heard(windows)
    middles = record.angle_at(np.array([0.5 * (a + b) for a, b in windows]))
    if cut and (not windows or circle_covered_rad(middles) < math.radians(150.0)):
        parts = heard(_cut_from_turn(record, compass.time_s))
        windows = parts if len(parts) >= 3 else windows
    windows = sorted(sorted(windows, key=lambda w: w[0] - w[1])[:_MOST_DWELLS])
    return [dwell_between(track, instance, start, end, record) for start, end in windows]


def _still_windows(record: TurnRecord) -> list[tuple[float, float]]:
    """List (start, end) of the stretches with little rotation, split where their swing grows too long."""
    time = record.time_s
    rates = np.stack([record.rate_radps, record.tilt_rate_radps], axis=1)
    rate, tilt = moving_average(time, rates, RATE_SMOOTHING_S).T
    tilt_floor = TILT_FLOOR * record.noise_radps
    quiet = (np.abs(rate) < STILL_RATE_RADPS) & (tilt < STILL_TILT_RATE_RADPS + tilt_floor)
    windows = []
    for start, end in stretches(quiet):
        while start < end:
            angles = record.angle_rad[start:end]
            low, high = np.minimum.accumulate(angles), np.maximum.accumulate(angles)
            beyond = np.flatnonzero(high - low > LONGEST_SWING_RAD)
            stop = max(start + int(beyond[0]), start + 1) if beyond.size else end
            begins = float(time[start]) + (_SETTLE_S if start > 0 else 0.0)
            ends = float(time[min(stop, time.size - 1)])
            if ends - begins >= _SHORTEST_DWELL_S:
                windows.append((begins, ends))
            start = stop
    return windows


def _steady_current(track: Track, window: tuple[float, float]) -> list[tuple[float, float]]:
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
        if end - start >= _SHORTEST_DWELL_S:
            parts.append((start, end))
        start, ordered = end, load[k : k + 1].tolist()
    return parts


def _cut_from_turn(record: TurnRecord, compass_time: FloatArray) -> list[tuple[float, float]]:
    """Cut short positions out of a continuous turn, evenly spaced by the gyro's angle."""
    if compass_time.size < 2:
        return []
    span = slice(*np.searchsorted(record.time_s, [compass_time[0], compass_time[-1]]))
    time, angle = record.time_s[span], record.angle_rad[span]
    if time.size < 4 or abs(float(angle[-1] - angle[0])) < math.radians(200.0):
        return []
    sense = math.copysign(1.0, float(angle[-1] - angle[0]))
    progress = np.maximum.accumulate(sense * (angle - angle[0]))
    spacing = 2.0 * math.pi / _CUT_PER_TURN
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
    """Measure the turns between dwells of one recording with the gyro, from mean angle to mean angle.

    Raises PoorCalibration where the recording has no gyro.
    """
    record = turn or require_turn(track, instance)
    steps = []
    for first, second in pairwise(dwells):
        start, end = 0.5 * (first.start_s + first.end_s), 0.5 * (second.start_s + second.end_s)
        gyro = record.independent_sigma_rad(first.end_s, second.start_s)
        sigma = math.sqrt(gyro**2 + first.turned_sigma_rad**2 + second.turned_sigma_rad**2)
        steps.append(Step(second.turned_rad - first.turned_rad, sigma, end - start))
    return steps


def observe(
    track: Track, instance: int = 1, turn: TurnRecord | None = None, fewest: int = 3
) -> FourPositionData:
    """Find the dwells of a recording, `fewest` of them wanted, and measure the turns between them.

    Raises PoorCalibration where the recording has no gyro, one that tells nothing of the turns, or hardly any
    turn, KeyError for an unknown compass.
    """
    record = turn or require_turn(track, instance)
    dwells = find_dwells(track, instance, record)
    turned = math.degrees(float(np.ptp(record.angle_rad)))
    if len(dwells) < fewest and turned < 200.0:
        raise PoorCalibration(
            f"Too little motion: the vehicle's heading changed by only {turned:.0f} degrees in all.",
            "Turn it on the level in four steps of about 90 degrees and stop after each.",
        )
    data = assemble(track, dwells, instance, record)
    sigma_rad = np.array([step.sigma_rad for step in data.steps])
    if nothing_known := too_sparse(np.diff(data.turned_rad), sigma_rad, record.rate_hz, NO_HEADING_RAD):
        raise nothing_known
    return data


def assemble(
    track: Track, dwells: list[Dwell], instance: int = 1, turn: TurnRecord | None = None
) -> FourPositionData:
    """Put dwells that the caller chose together with the turns between them.

    Raises PoorCalibration where the recording has no gyro.
    """
    record = turn or turn_record(track, instance)
    steps = turns_between(track, dwells, instance, record) if dwells else []
    return FourPositionData(
        dwells=tuple(dwells),
        steps=tuple(steps),
        gyro_scale_sigma=GYRO_SCALE_SIGMA,
        gyro_bias_sigma_radps=record.bias_sigma_radps if record is not None else 0.0,
        tilt_bias_sigma_rad=accelerometer_of(track, dwells),
        source=track.source,
    )


def accelerometer_of(track: Track, dwells: Sequence[Dwell]) -> float:
    """Return what roll and pitch are off by all along, 1 sigma of each, radians.

    Only what stands, or hovers on the spot, leans as it does at rest, for the accelerometer to be judged by:
    of what travels it may be any. Its level is moved by a vertical gyro's bias, too.
    """
    velocity = track.receiver_velocity_mps or track.gps_velocity_mps
    if velocity is not None and len(velocity):
        middles = np.array([0.5 * (d.start_s + d.end_s) for d in dwells])
        speed = np.linalg.norm(velocity.at(middles)[:, :2], axis=1)
        dwells = [d for d, mps in zip(dwells, speed, strict=True) if not mps > _STANDS_MPS]
    if len(dwells) < 3 or not all(math.isfinite(d.turned_rad) for d in dwells):
        return math.hypot(UNSEEN_BIAS_RAD, levels(track).lasting_rad)
    columns = np.array([(d.turned_rad, d.roll_rad, d.pitch_rad, d.tilt_sigma_rad) for d in dwells])
    return accelerometer_sigma_rad(*columns.T)
