"""What else tells the heading of a recording, and how far that is from the heading by one compass.

The other compasses of the vehicle, a second antenna, the receiver's course and acceleration, the autopilot's
yaw where another source steers it: each as a `HeadingSource`, its deviations A, B, C counted from the heading
of the compass in question, for `fault_isolation` to weigh.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

from mavcompass.attitude import down_in_body
from mavcompass.correction import FieldCorrection
from mavcompass.earth_field import EarthField, earth_field_of
from mavcompass.frames import FloatArray, wrap_pi
from mavcompass.heading.fault_isolation import HeadingSource, isolate_faults
from mavcompass.heading.one_compass import UNKNOWN_YEAR, HeadingResult, heading_by_compass
from mavcompass.heading.true_north import (
    ANTENNA_RAD,
    MOUNTED_RAD,
    STEADY_RAD,
    NorthSeen,
    TrueNorth,
    north_seen,
)
from mavcompass.steering import steering_source
from mavcompass.track import Series, Track

# While it turns faster or leans further a heading is late, or hardly one.
_SLOW_RADPS, _LEAST_UPRIGHT = math.radians(20.0), math.cos(math.radians(45.0))
_MOST_ROWS, _NEAREST_S, _TOGETHER_S = 4000, 0.3, 1.0
_BINS = 24
# A compass that is read 10 times a second is up to 0.1 s old when it is told, each by its own time.
_AGE_S = 0.05
# A source whose calibration is not known is bent by as much as irons bend.
_BEND_RAD = math.radians(20.0)
# Of two headings that move against each other by more than this one does not turn with the vehicle.
_NO_HEADING_RAD = math.radians(30.0)
# Of a bin's readings so many are independent at the most.
_AVERAGED = 20
# Two headings from the same readings agree no better: the wire's whole numbers, and times.
FLOOR_RAD = math.radians(0.1)
# One sigma of A: antennas as they are aligned; a compass beside a course; an autopilot's yaw; an
# accelerometer beside a receiver.
_NORTH_RAD = {"gps-yaw": ANTENNA_RAD, "gps-course": MOUNTED_RAD}
_AUTOPILOT_RAD, _ACCELERATION_RAD = math.radians(3.0), math.radians(6.0)
# Of a declination that is not known: where people drive it is rarely beyond 20 degrees.
_DECLINATION_RAD = math.radians(12.0)
# The receiver's velocity is compared over steps of this length; fewer, or less alike, show nothing.
_STEP_S, _FEWEST_STEPS, _LEAST_COHERENCE = 1.0, 15, 0.5
# Receivers are 0.1 to 0.2 s late (GPS_DELAY_MS, EKF2_GPS_DELAY), by how much nobody tells.
_RECEIVER_LATE_S = 0.15


@dataclass(frozen=True, slots=True, eq=False)
class CompassHeading:
    """Hold the heading by one compass.

    Attributes:
        instance: the compass, from 1. heading: magnetic, radians.
        sigma_rad: of it, where the compass is sound.
        calibrated: whether that holds at every heading: its calibration is known to be good.
        by_itself: what else it shows, see `HeadingSource`.
    """

    instance: int
    heading: Series
    sigma_rad: float
    calibrated: bool = False
    by_itself: Mapping[str, float] = field(default_factory=dict)

    @classmethod
    def of(cls, instance: int, found: HeadingResult) -> CompassHeading:
        """Take a compass's heading with the sigma that it claims in the middle."""
        sigma_rad = float(np.median(found.magnetic_sigma_rad))
        return cls(instance, Series(found.time_s, found.magnetic_rad), sigma_rad)


@dataclass(frozen=True, slots=True, eq=False)
class Evidence:
    """Hold what was seen beside one compass.

    Attributes:
        sources: the compass itself first, then the others.
        scatter_rad: how much its heading moves against every other compass beyond A, B and C, rms.
        north: what true headings it gives; None where the declination is not known.
    """

    sources: tuple[HeadingSource, ...]
    scatter_rad: float
    north: TrueNorth | None = None


@dataclass(frozen=True, slots=True, eq=False)
class _Moments:
    """Hold the moments at which headings are compared: the compass's own readings, upright."""

    track: Track
    time_s: FloatArray
    heading_rad: FloatArray
    rate_radps: FloatArray
    declination_rad: float
    declination_sigma_rad: float

    def slow(self) -> _Moments:
        """Return those at which it turned slowly: what is late by more than a compass tells nothing else."""
        rows = np.abs(self.rate_radps) < _SLOW_RADPS
        time, heading, rate = self.time_s[rows], self.heading_rad[rows], self.rate_radps[rows]
        return replace(self, time_s=time, heading_rad=heading, rate_radps=rate)


def compare(
    track: Track,
    mine: CompassHeading,
    others: Iterable[CompassHeading],
    earth: EarthField | None,
    windows: Sequence[tuple[float, float]] | None = None,
) -> Evidence:
    """Compare the heading by a compass with all else that tells it.

    Args:
        track: the recording. mine: what is in question. others: the headings by the other compasses.
        earth: gives the declination, which sources of true headings need.
        windows: the stretches (start, end) that count; None takes all that is slow and upright. In a turn
            that was chosen compasses, which are late alike, are compared as it turns.
    """
    moments = _moments(track, mine, earth, windows)
    sources = [HeadingSource(f"compass {mine.instance}", (0.0, 0.0, 0.0), mine.sigma_rad, mine.by_itself)]
    if not len(moments.time_s):
        return Evidence(tuple(sources), 0.0, None if earth is None else TrueNorth.of(earth))
    scatters = []
    for other in others:
        found = _deviation(moments, _paired(other.heading, moments.time_s))
        if found is None:
            continue
        shown, sigma, left = found
        if left < _NO_HEADING_RAD and other.calibrated:
            scatters.append(left)
        elif left < _NO_HEADING_RAD:
            shown = (shown[0], math.nan, math.nan)
        elif other.calibrated:
            shown = (math.nan, math.nan, math.nan)
        else:
            continue
        name, sure = f"compass {other.instance}", math.hypot(other.sigma_rad, sigma)
        sources.append(HeadingSource(name, shown, sure, other.by_itself))
    moments = moments.slow()
    seen = _north_seen(moments)
    north = None if earth is None else TrueNorth.of(earth, seen)
    sources += _elsewhere(moments, mine.instance, seen)
    return Evidence(tuple(sources), min(scatters, default=0.0), north)


def _moments(
    track: Track,
    mine: CompassHeading,
    earth: EarthField | None,
    windows: Sequence[tuple[float, float]] | None,
) -> _Moments:
    time, values = mine.heading.time_s, np.asarray(mine.heading.values)
    down, rate = down_in_body(track, time), np.zeros((len(time), 3))
    if track.gyro_radps is not None and len(track.gyro_radps):
        rate = np.nan_to_num(track.gyro_radps.at(time - track.field_lag_s), nan=math.inf)
    usable = np.isfinite(values) & (down[:, 2] > _LEAST_UPRIGHT) & np.isfinite(rate).all(axis=1)
    if windows is None:
        usable &= np.linalg.norm(rate, axis=1) < _SLOW_RADPS
    else:
        usable &= np.any([(time >= start) & (time <= end) for start, end in windows], axis=0)
    rows = np.flatnonzero(usable)
    rows = rows[:: max(len(rows) // _MOST_ROWS, 1)]
    declination = (
        (0.0, _DECLINATION_RAD) if earth is None else (earth.declination_rad, earth.declination_sigma_rad)
    )
    return _Moments(track, time[rows], values[rows], (rate[rows] * down[rows]).sum(axis=1), *declination)


def _paired(other: Series, time_s: FloatArray) -> FloatArray:
    """Return each reading of another heading at the moment that is nearest to it, (N,); nan at the rest."""
    told = other.nearest(time_s, _NEAREST_S)
    if not len(other) or not time_s.size:
        return told
    place = other.nearest_rows(time_s)
    nearest_first = np.lexsort((np.abs(other.time_s[place] - time_s), place))
    _, first = np.unique(place[nearest_first], return_index=True)
    chosen = np.full(told.shape, np.nan)
    chosen[nearest_first[first]] = told[nearest_first[first]]
    return chosen


def _deviation(
    moments: _Moments, other_rad: FloatArray
) -> tuple[tuple[float, float, float], float, float] | None:
    """Fit A, B, C of another heading less mine; returns them, sigma of A, and what they leave, rms, radians.

    Every bin of the circle counts alike, however long the vehicle pointed there. How much later one of them
    is told than the other is fitted, too.
    """
    time_s, mine_rad = moments.time_s, moments.heading_rad
    known = np.flatnonzero(np.isfinite(mine_rad) & np.isfinite(other_rad))
    # A reading that is repeated says no more than once.
    known = known[np.diff(other_rad[known], prepend=math.nan) != 0.0]
    if known.size < 2:
        return None
    mine, off = mine_rad[known], np.exp(1j * (other_rad - mine_rad)[known])
    # A noisy reading is not to choose its own bin: what a second's readings show together does.
    _, second = np.unique(np.floor(time_s[known] / _TOGETHER_S), return_inverse=True)
    toward = np.angle(np.bincount(second, np.cos(mine)) + 1j * np.bincount(second, np.sin(mine)))[second]
    bins = np.floor(np.mod(toward, 2.0 * math.pi) / (2.0 * math.pi) * _BINS).astype(np.intp) % _BINS
    count = np.bincount(bins, minlength=_BINS)
    seen = count > 0

    def mean(phasor: NDArray[np.complex128]) -> NDArray[np.complex128]:
        sums = np.bincount(bins, phasor.real, _BINS) + 1j * np.bincount(bins, phasor.imag, _BINS)
        return np.asarray(sums[seen] / count[seen])

    middle, psi = mean(off), np.angle(mean(np.exp(1j * mine)))
    turns = np.bincount(bins, moments.rate_radps[known], _BINS)[seen] / count[seen]
    count = count[seen]
    centre = float(np.angle(middle.sum()))
    away = np.angle(middle * np.exp(-1j * centre))
    # The readings of a bin average out their noise, as far as they are independent.
    inside2 = float((count * (1.0 - np.abs(middle) ** 2)).sum()) / max(int(count.sum()) - count.size, 1)
    chance2 = inside2 / np.minimum(count, _AVERAGED) + FLOOR_RAD**2
    design = np.stack([np.ones(psi.size), np.sin(psi), np.cos(psi), turns], axis=1)
    beyond2 = 0.0
    for _ in range(3):
        weight = 1.0 / (chance2 + beyond2)
        prior = np.diag([0.0, _BEND_RAD**-2.0, _BEND_RAD**-2.0, _AGE_S**-2.0])
        covariance = np.linalg.inv(design.T @ (design * weight[:, np.newaxis]) + prior)
        found = covariance @ design.T @ (weight * away)
        left2 = (away - design @ found) ** 2
        chance = left2.size + 2.0 * math.sqrt(2.0 * left2.size)  # of a chi-square, two sigmas
        shows = float((left2 / chance2).sum()) > chance
        beyond2 = max(float(np.average(left2 - chance2, weights=weight)), 0.0) if shows else 0.0
    a, b, c, _ = found.tolist()
    return (float(wrap_pi(centre + a)), b, c), math.sqrt(float(covariance[0, 0])), math.sqrt(beyond2)


def _north_seen(moments: _Moments) -> tuple[NorthSeen, ...]:
    track = moments.track
    velocity, yaw = _receiver_velocity(track), track.gps_yaw_rad
    nothing, time_s = Series(np.zeros(0), np.zeros((0, 3))), moments.time_s - track.field_lag_s
    going = (velocity or nothing).nearest(time_s, _NEAREST_S)[:, :2]
    antenna = np.full(len(time_s), np.nan) if yaw is None else yaw.nearest(time_s, _NEAREST_S)
    return north_seen(track.vehicle, time_s, moments.heading_rad, going, antenna)


def _receiver_velocity(track: Track) -> Series | None:
    return track.receiver_velocity_mps or track.gps_velocity_mps


def _elsewhere(moments: _Moments, instance: int, north: Iterable[NorthSeen]) -> Iterator[HeadingSource]:
    """Yield what is no compass: by its name in the calibration JSON."""
    track, declination_rad = moments.track, moments.declination_rad
    for seen in north:
        doubt = math.hypot(_NORTH_RAD[seen.by], seen.chance_rad, moments.declination_sigma_rad)
        yield HeadingSource.elsewhere(seen.by, float(wrap_pi(seen.turn_rad - declination_rad)), doubt)
    steered_by = steering_source(track.autopilot, track.parameters)
    elsewhere = steered_by is not None and steered_by != instance and steered_by not in track.compasses
    attitude = track.attitude_rad
    if elsewhere and steered_by != "gps" and attitude is not None:
        yaw = Series(attitude.time_s, np.asarray(attitude.values)[:, 2])
        told = _paired(yaw, moments.time_s - track.field_lag_s) - declination_rad
        if (found := _deviation(moments, told)) is not None:
            doubt = math.hypot(_AUTOPILOT_RAD, found[1], moments.declination_sigma_rad)
            yield HeadingSource.elsewhere("autopilot", found[0][0], doubt)
    velocity = _receiver_velocity(track)
    if velocity is not None and track.vehicle not in STEADY_RAD:
        yield from _acceleration(moments, velocity)


def _acceleration(moments: _Moments, velocity: Series) -> Iterator[HeadingSource]:
    """Yield the heading at which the accelerometer's changes of velocity are those that the receiver saw.

    With the specific force f in level axes (forward, right), d(v_n + i v_e) = e^(i psi) (f_f + i f_r) dt, so
    the angle between both sides, summed over steps, is what psi is off by.
    """
    track = moments.track
    acc, attitude = track.acc_mps2, track.attitude_rad
    if acc is None or attitude is None or len(acc) < 2 or len(moments.time_s) < 2:
        return
    time = acc.time_s[np.isfinite(acc.values).all(axis=1)]
    force = np.asarray(acc.values)[np.isfinite(acc.values).all(axis=1)]
    down = down_in_body(track, time)
    ahead = np.array([1.0, 0.0, 0.0]) - down[:, :1] * down  # the nose, in the level
    ahead /= np.maximum(np.linalg.norm(ahead, axis=1, keepdims=True), 1e-9)
    level = (force * ahead).sum(axis=1) + 1j * (force * np.cross(down, ahead)).sum(axis=1)
    psi = np.interp(time, moments.time_s, np.unwrap(moments.heading_rad)) + moments.declination_rad
    pushed = level * np.exp(1j * psi)
    total = np.concatenate([[0.0], np.cumsum(0.5 * (pushed[1:] + pushed[:-1]) * np.diff(time))])
    known = np.isfinite(velocity.values[:, :2]).all(axis=1)
    at, (north, east) = velocity.time_s[known], np.asarray(velocity.values)[known, :2].T
    every = max(round(_STEP_S / max(float(np.median(np.diff(at))), 1e-3)), 1) if len(at) > 1 else 1
    at, seen = at[::every], (north + 1j * east)[::every]
    inside = (at >= time[0]) & (at <= time[-1])
    at, seen = at[inside], seen[inside]
    if len(at) <= _FEWEST_STEPS:
        return
    # Only steps in which the compass was heard: between them its heading is not known.
    heard = np.diff(np.searchsorted(moments.time_s, at)) > 0
    if int(heard.sum()) < _FEWEST_STEPS:
        return
    # What stays (a biased accelerometer, a lean that is not known) tells nothing.
    moved = np.diff(seen)[heard]
    moved -= moved.mean()

    def agreement(late_s: float) -> complex:
        then = at - late_s
        told = np.diff(np.interp(then, time, total.real) + 1j * np.interp(then, time, total.imag))[heard]
        told -= told.mean()
        power = float((np.abs(told) ** 2).sum() * (np.abs(moved) ** 2).sum())
        return complex((np.conj(told) * moved).sum()) / math.sqrt(max(power, 1e-12))

    both = agreement(0.0)
    coherence = abs(both) ** 2
    if coherence < _LEAST_COHERENCE:
        return
    sigma = math.sqrt((1.0 - coherence) / (2.0 * len(moved) * coherence))
    # What turns while it accelerates seems turned by as much as it turns within the receiver's delay.
    by_delay = float(np.angle(agreement(_RECEIVER_LATE_S) / agreement(-_RECEIVER_LATE_S))) / 2.0
    doubt = math.hypot(_ACCELERATION_RAD, sigma, by_delay, moments.declination_sigma_rad)
    yield HeadingSource.elsewhere("gps-acceleration", float(np.angle(both)), doubt)


def compass_heading(track: Track, instance: int, correction: FieldCorrection | None = None) -> CompassHeading:
    """Compute the heading by one compass, by the autopilot's calibration or another; see `HeadingResult`.

    Raises BadRecording where it has no readings.
    """
    return CompassHeading.of(instance, heading_by_compass(track.centred(instance), correction, instance))


def other_compasses(track: Track, instance: int) -> list[int]:
    """List the other compasses that have readings."""
    return [i for i in sorted(track.compasses) if i != instance and len(track.compasses[i].reported)]


def heading_of_track(
    track: Track, correction: FieldCorrection | None = None, instance: int = 1, *, two_axis: bool = False
) -> HeadingResult:
    """Compute a recording's tilt-compensated heading; what else tells it may widen its sigma or teach north.

    Args:
        track: the recording.
        correction: applied to the raw field; None leaves the autopilot's own correction in force.
        instance: the compass, counting from 1.
        two_axis: use X and Y only and estimate Z from the world model's field length.

    Raises BadRecording where the compass is missing, the accelerometer is dead, or two_axis is wanted and the
    place is unknown.
    """
    found = heading_by_compass(track, correction, instance, two_axis)
    others = [compass_heading(track, other) for other in other_compasses(track, instance)]
    earth = earth_field_of(track, UNKNOWN_YEAR)
    evidence = compare(track, CompassHeading.of(instance, found), others, earth)
    beyond_rad = isolate_faults(evidence.sources).beyond_rad(0)
    if (north := evidence.north) is None:
        return found.widened(beyond_rad)
    # What true north was learnt from is no witness against that; of the rest it is one as before.
    learnt = {one.by for one in north.learnt}
    rest = [source for source in evidence.sources if source.name not in learnt]
    return found.widened(beyond_rad, isolate_faults(rest).beyond_rad(0)).with_north(north)
