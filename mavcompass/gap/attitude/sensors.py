"""What gyro, accelerometer and receiver say: what is white in them, what is off, how fast the vehicle moves.

A receiver's axes lie at an unknown yaw in the frame of a levelled gyro.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from mavcompass.chance import chance_above, chi_square_of
from mavcompass.earth_field import middle_place
from mavcompass.frames import FloatArray
from mavcompass.gap.attitude.kinematics import averaged, interpolated
from mavcompass.gap.result import Cause
from mavcompass.gap.tables import usual
from mavcompass.simulation.effects import detected_by
from mavcompass.simulation.effects.effect import Detector
from mavcompass.simulation.physics.world import EARTH_RADIUS_M
from mavcompass.track import Series, Track

# Readings of a window that a spectrum is taken of, and frequencies that a window spreads a constant over.
_WINDOW, _WINDOWED = 32, 3
# The median of squares of normal deviates.
MEDIAN_OF_SQUARES = 0.455
# Three axes together, in squared sigmas: as improbable as six sigmas on one of three.
_IMPROBABLE = chi_square_of(6.0 * chance_above(6.0), 3)


def white_floor(values: FloatArray) -> FloatArray:
    """Return the standard deviation of what is white in columns (N, k), (k,): the floor of their spectrum.

    The lower quartile over frequencies of the median over Hann windows (Welch 1967). A vehicle that rocks or
    shakes does so in a band, which may lie at the end of the spectrum, where differences look.
    """
    size = min(_WINDOW, len(values))
    window = np.sin(np.pi * (np.arange(size) + 0.5) / size) ** 2
    window /= math.sqrt(float(window @ window))
    starts = np.arange(0, len(values) - size + 1, max(size // 2, 1))
    pieces = values[starts[:, None] + np.arange(size)]
    pieces = (pieces - pieces.mean(axis=1, keepdims=True)) * window[:, None]
    power = np.median(np.abs(np.fft.rfft(pieces, axis=1)) ** 2, axis=0) / math.log(2.0)
    # The window spreads a constant and a slow turn over the lowest ones.
    return np.asarray(np.sqrt(np.quantile(power[_WINDOWED : size // 2], 0.25, axis=0)))


@dataclass(frozen=True, slots=True, eq=False)
class Bias:
    """Hold a sensor's bias and its standard deviation, (3,) each, in the sensor's unit."""

    mean: FloatArray
    sigma: FloatArray


def bias_at_rest(clock: FloatArray, rate: FloatArray, acc: FloatArray) -> Bias:
    """Return the bias (3,) that the stretches at rest show; wide about zero where nothing rests.

    Parts of a rest differ by what still moves (a hovering copter drifts about): that is its sigma.
    """
    parts = [
        rate[rows].mean(axis=0) for stretch in rests(clock, rate, acc) for rows in _parts(clock, stretch)
    ]
    if not parts:
        return Bias(np.zeros(3), np.full(3, usual.gyro.unknown_bias_radps))
    if len(parts) < usual.rest.fewest_parts:
        return Bias(np.mean(parts, axis=0), np.full(3, usual.gyro.unknown_bias_radps))
    # Slow motion makes neighbouring parts alike: two of them count as one.
    spread = np.std(parts, axis=0, ddof=1) / math.sqrt(0.5 * len(parts))
    return Bias(np.median(parts, axis=0), np.maximum(spread, usual.gyro.least_bias_radps))


def sensor_faults(now: Mapping[Detector, Bias], before: Mapping[Detector, Bias]) -> tuple[Cause, ...]:
    """Name what gyro and accelerometer are off by, and were not in the vehicle's baseline.

    Every sensor is off by something: a fault is what the vehicle did not have when it was good.
    """
    out = []
    for shown in now.keys() & before.keys():
        effect, here, there = detected_by(shown), now[shown], before[shown]
        change, sigma = here.mean - there.mean, np.hypot(here.sigma, there.sigma)
        if np.abs(change).max() >= effect.daily and float(np.sum((change / sigma) ** 2)) >= _IMPROBABLE:
            values, doubts = (dict(zip("xyz", column.tolist(), strict=True)) for column in (change, sigma))
            out.append(Cause.detected(effect.id, values, doubts))
    return tuple(sorted(out, key=lambda cause: cause.effect))


def rests(clock: FloatArray, rate: FloatArray, acc: FloatArray) -> list[slice]:
    """Return the stretches of some seconds in which neither gyro nor accelerometer changes."""
    still = _still(clock, rate, acc)
    edges = np.flatnonzero(np.diff(np.concatenate([[0], still.astype(np.int8), [0]])))
    found = [slice(int(a), int(b)) for a, b in zip(edges[::2], edges[1::2], strict=True)]
    return [s for s in found if clock[s.stop - 1] - clock[s.start] >= usual.rest.shortest_s]


def _parts(clock: FloatArray, stretch: slice) -> list[slice]:
    count = max(int((clock[stretch.stop - 1] - clock[stretch.start]) / usual.rest.part_s), 1)
    edges = np.linspace(stretch.start, stretch.stop, count + 1).round().astype(np.int64)
    return [slice(int(a), int(b)) for a, b in pairwise(edges) if b > a]


def _still(clock: FloatArray, rate: FloatArray, acc: FloatArray) -> NDArray[np.bool_]:
    width = max(3, int(usual.rest.smoothing_s / max(float(np.median(np.diff(clock))), 1e-3))) | 1
    smooth, force = averaged(rate, width), averaged(acc, width)
    slow = np.abs(smooth).max(axis=1) < usual.rest.largest_radps
    if not slow.any():
        return slow
    # The quietest stretch tells the bias; whatever turns no faster than that is still.
    size = np.where(slow, np.abs(smooth).max(axis=1), np.inf)
    bias = np.median(smooth[size <= size.min() + usual.rest.same_radps], axis=0)
    still = slow & (np.abs(smooth - bias).max(axis=1) < usual.rest.same_radps)
    change = np.zeros(clock.size)
    change[width:] = np.abs(force[width:] - force[:-width]).max(axis=1)
    return np.asarray(still & (change < usual.rest.same_mps2))


_STEP_S = 0.2
_TURN_STEP_RAD = 0.25


@dataclass(frozen=True, slots=True, eq=False)
class Velocity:
    """Hold velocities north, east, down and how fast they change, (N, 3) each, with their scatter (3,)."""

    time_s: FloatArray
    mean_mps: FloatArray
    change_mps2: FloatArray
    sigma_mps: FloatArray

    def at(self, time_s: FloatArray) -> Velocity:
        """Return the velocity at other times."""
        mean, change = (
            interpolated(self.time_s, values, time_s) for values in (self.mean_mps, self.change_mps2)
        )
        return Velocity(time_s, mean, change, self.sigma_mps)

    def bearing(
        self, clock: FloatArray, rotation: FloatArray, force: FloatArray, absorbed_s: float
    ) -> FloatArray | None:
        """Return the yaw (N,) of the receiver's axes in a level frame, by the forces (N, 3) that are felt.

        `rotation` (N, 3, 3) goes from body axes to that frame, which was levelled by means of the force over
        triangles of half width `absorbed_s`: the same means of an acceleration do not show in it. 0 where the
        acceleration had been taken away before. None where no yaw explains what is felt.
        """
        level = np.einsum("nij,nj->ni", rotation, force)
        width = max(round(usual.receiver.compared_s / max(float(np.median(np.diff(clock))), 1e-3)), 1)
        smooth = averaged(averaged(level, width, True), width, True)
        felt = smooth[:, 0] + 1j * smooth[:, 1]
        compared = self.acceleration(clock, usual.receiver.compared_s)
        shown = compared - triangle_means(clock, compared, absorbed_s)
        said = shown[:, 0] + 1j * shown[:, 1]
        middle = clock - 0.5 * (clock[0] + clock[-1])
        step = _TURN_STEP_RAD / max(float(np.ptp(clock)), 1.0)
        most = math.ceil(usual.receiver.drift_radps / step)
        drifts = step * np.arange(-most, most + 1)
        product = np.conj(said) * felt
        sums = np.array([np.sum(product * np.exp(-1j * drift * middle)) for drift in drifts])
        best = int(np.argmax(np.abs(sums)))
        angle = np.asarray(drifts[best] * middle + np.angle(sums[best]))
        left = float(np.mean(np.abs(felt - said * np.exp(1j * angle)) ** 2))
        # Of so many drifts one explains a share of mere noise by chance.
        independent = max(float(np.ptp(clock)) / usual.receiver.compared_s, 1.0)
        believed = max(
            usual.receiver.believed_share, (usual.receiver.sure + math.log(drifts.size)) / independent
        )
        return angle if left <= (1.0 - believed) * float(np.mean(np.abs(felt) ** 2)) else None

    def acceleration(self, clock: FloatArray, smoothing_s: float = usual.receiver.taken_s) -> FloatArray:
        """Return the acceleration north, east, down at some times, (N, 3).

        It is the exact derivative of a smooth curve: averaged over T, its noise falls with T.
        """
        grid = np.arange(clock[0], clock[-1] + _STEP_S, _STEP_S)
        width = round(smoothing_s / _STEP_S)
        curve = averaged(averaged(self.at(grid).mean_mps, width, True), width, True)
        change = np.gradient(curve, _STEP_S, axis=0)
        return interpolated(grid, change, clock)


def triangle_means(clock: FloatArray, values: FloatArray, half_s: float) -> FloatArray:
    """Return means of columns (N, k) over triangles of a half width, cut at the ends; 0 for no width."""
    half = min(round(half_s / max(float(np.median(np.diff(clock))), 1e-3)), clock.size)
    if half < 1:
        return np.zeros_like(values)
    kernel = np.concatenate([np.arange(1, half + 1), np.arange(half - 1, 0, -1)]).astype(np.float64)
    weight = _convolved(np.ones(clock.size), kernel)
    return np.stack([_convolved(column, kernel) / weight for column in values.T], axis=1)


def _convolved(values: FloatArray, kernel: FloatArray) -> FloatArray:
    """Return the centred convolution, as long as the values, by the Fourier transform."""
    size = 1 << (values.size + kernel.size).bit_length()
    product = np.fft.irfft(np.fft.rfft(values, size) * np.fft.rfft(kernel, size), size)
    first = (kernel.size - 1) // 2
    return np.asarray(product[first : first + values.size])


def receiver_velocity(track: Track, clock: FloatArray) -> Velocity | None:
    """Return what a receiver says of the velocity; None where it does not speak all the time.

    Its own word comes first: what the autopilot makes of it leans as a bent compass has it.
    """
    for series, of_positions in (
        (_own_velocity(track), False),
        (track.gps_velocity_mps, False),
        (track.position_ned_m, True),
        (local_position(track.place), True),
    ):
        if series is None:
            continue
        finite = np.isfinite(series.values).all(axis=1)
        when, values = series.time_s[finite], series.values[finite]
        if when.size < usual.receiver.fewest or float(np.max(np.diff(when))) > usual.receiver.gap_s:
            continue
        if when[0] > clock[0] + usual.receiver.gap_s or when[-1] < clock[-1] - usual.receiver.gap_s:
            continue
        if of_positions:
            grid = np.arange(when[0], when[-1], _STEP_S)
            curve = averaged(interpolated(when, values, grid), usual.receiver.smoothed, True)
            when, values = grid, np.gradient(curve, _STEP_S, axis=0)
        if when.size < usual.receiver.fewest:
            continue
        change = np.gradient(averaged(values, usual.receiver.smoothed, True), when, axis=0)
        return Velocity(when, values, change, np.maximum(white_floor(values), usual.receiver.least_mps))
    return None


def _own_velocity(track: Track) -> Series | None:
    """Return the velocity that the receiver itself told often enough, its vertical by the autopilot where
    the receiver tells none."""
    own, filtered = track.receiver_velocity_mps, track.gps_velocity_mps
    if own is None or filtered is None or len(own) < usual.receiver.fewest:
        return None
    if float(np.median(np.diff(own.time_s))) > usual.receiver.often_s:
        return None
    down = own.values[:, 2]
    if not np.isfinite(down).all():
        down = filtered.at(own.time_s)[:, 2]
    return Series.of(own.time_s, np.column_stack([own.values[:, :2], down]))


def local_position(place: Series | None) -> Series | None:
    """Return north, east, down in metres about the middle of some places."""
    if place is None or not np.isfinite(place.values).all(axis=1).any():
        return None
    lat, lon, alt = place.values.T
    lat_0, lon_0, _ = middle_place(place.values)
    north, east = north_east_m(lat, lon, lat_0, lon_0)
    return Series.of(place.time_s, np.stack([north, east, -alt], axis=1))


def north_east_m(
    lat_deg: FloatArray | float, lon_deg: FloatArray | float, about_lat_deg: float, about_lon_deg: float
) -> tuple[FloatArray, FloatArray]:
    """Return how far north and east of a place others lie, in metres, on the plane that touches there."""
    north = np.radians(lat_deg - about_lat_deg) * EARTH_RADIUS_M
    off_deg = np.asarray(lon_deg - about_lon_deg)
    off_deg = np.where(np.abs(off_deg) > 180.0, off_deg - np.copysign(360.0, off_deg), off_deg)
    east = np.radians(off_deg) * EARTH_RADIUS_M * math.cos(math.radians(about_lat_deg))
    return north, east
