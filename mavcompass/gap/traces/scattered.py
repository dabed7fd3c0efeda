"""Scatter from reading to reading: how much more than the baseline's, and whether it is noise."""

from __future__ import annotations

import math

import numpy as np

from mavcompass.frames import FloatArray
from mavcompass.gap.replay.integrity import Readings
from mavcompass.gap.tables import usual

# Second differences of white noise so many readings apart have no reading in common. Their correlation is
# zero but for chance (within three sigmas), whose variance over their number is 1 + 2 (4/6)^2 + 2 (1/6)^2
# (Bartlett, Suppl. J. Royal Stat. Soc. 8, 1946).
_OF_NEIGHBOURS = 35.0 / 18.0
_LAGS, _BY_CHANCE = (3, 4, 5), 3.0 * math.sqrt(_OF_NEIGHBOURS)


def quiet_variance(readings: Readings, values: FloatArray) -> float:
    """Return the mean square of columns (M, 3) over the quieter readings."""
    return float(np.mean(values[readings.quiet] ** 2)) if readings.quiet.any() else 0.0


def excess_variance(readings: Readings, baseline: Readings, repeats: bool = False) -> float:
    """Return the variance of white scatter in excess of the baseline's, mG^2, while the field hardly turns.

    What `repeats` is read at uneven times, and scatters by nature. 0 where it is not much more, and where it
    is no noise: fast changes that follow each other, or come in bursts.
    """
    now, before = quiet_scatter(readings), quiet_scatter(baseline)
    excess = now**2 - before**2
    quiet = float(readings.quiet.mean()) > usual.scatter.least_quiet and not repeats
    least = usual.scatter.doubtful if quiet else usual.scatter.never_quiet
    if excess <= least * max(before, 1e-9) ** 2:
        return 0.0
    # White noise scatters as much between readings further apart. Of the two estimates the larger one is
    # nearer: what wanders in the baseline is taken off both.
    further = quiet_scatter(readings, 2) ** 2 - quiet_scatter(baseline, 2) ** 2
    white = excess / usual.scatter.unlike < further < usual.scatter.unlike * excess
    noise = white and _unrelated(readings) and _steady(readings, excess) and _of_each_axis(readings)
    along = (
        _usual(_along_field(readings)[readings.quiet]) ** 2
        - _usual(_along_field(baseline)[baseline.quiet]) ** 2
    )
    return max(excess, further) if noise and along > usual.scatter.along * excess else 0.0


def burst_mgauss(readings: Readings, baseline: Readings) -> float:
    """Return what scatters from reading to reading and is no noise of the sensor, rms, in mG.

    Single readings that stand far off both neighbours; or, where the vehicle hardly swings in either
    recording, a scatter whose variance along the field is more than twice the baseline's. 0 where there are
    not far more such readings than in the baseline, or than a few that went wrong.
    """
    (now, along), (before, beside) = _off_neighbours(readings), _off_neighbours(baseline)
    share, size = _standing_off(now)
    burst = size if share > max(usual.bursts.few_wrong, usual.bursts.more * _standing_off(before)[0]) else 0.0
    if min(len(now) / len(readings.valid), len(before) / len(baseline.valid)) < usual.bursts.even:
        return burst
    if np.mean(along**2) <= (1.0 + usual.scatter.doubtful) * np.mean(beside**2):
        return burst
    return max(burst, math.sqrt(max(float(np.mean(now**2) - np.mean(before**2)), 0.0)))


def _off_neighbours(readings: Readings) -> tuple[FloatArray, FloatArray]:
    """Return by how much readings are off both neighbours, (M, 3) and along the field (M,), of those while
    the field turns evenly: late readings stand off where a turn begins and ends."""
    both = readings.valid.copy()
    both[1:-1] &= readings.valid[:-2] & readings.valid[2:]
    both[[0, -1]] = False
    off = np.abs(neighbours(readings.error_mgauss))
    swings = np.linalg.norm(neighbours(readings.nominal_mgauss), axis=1)
    beside = np.max(
        [np.roll(swings, shift) for shift in range(-usual.bursts.beside, usual.bursts.beside + 1)], axis=0
    )
    both &= beside < float(np.linalg.norm(_usual(off[both])))
    return off[both], _along_field(readings)[both]


def _standing_off(off: FloatArray) -> tuple[float, float]:
    """Return the share of readings (M, 3) that are off by many times what most are, on any axis, and what
    they add to the rms of all, in mG."""
    if len(off) <= usual.scatter.fewest:
        return 0.0, 0.0
    most = _usual(off)
    # Of coarse numbers most differ by nothing.
    far = np.any(off > np.where(most > 0.0, usual.bursts.far_off * most, np.inf), axis=1)
    return float(far.mean()), float(np.sqrt(np.mean((off * far[:, None]) ** 2)))


def quiet_doubt(readings: Readings) -> float:
    """Return how far the square of `quiet_scatter` may be off, 1 sigma, as a share of it.

    A median tells a normal deviation as well as 0.37 times as many squares would; of second differences.
    """
    count = 3.0 * float(readings.quiet.sum())
    return math.sqrt(2.0 * _OF_NEIGHBOURS / (0.37 * max(count, 1.0)))


def quiet_scatter(readings: Readings, apart: int = 1) -> float:
    """Return the scatter between readings some steps apart in mG, robustly, on the quieter ones."""
    both = readings.quiet.copy()
    both[:apart] = both[both.size - apart :] = False
    if both.sum() <= usual.scatter.fewest:
        return 0.0
    return float(np.sqrt(np.mean(_usual(neighbours(readings.error_mgauss, apart)[both]) ** 2)))


def neighbours(error_mgauss: FloatArray, apart: int = 1) -> FloatArray:
    """Return second differences of columns (N, 3), scaled to white noise's deviation; zero at the ends."""
    out = np.zeros_like(error_mgauss)
    k = apart
    if len(out) > 2 * k:
        out[k:-k] = error_mgauss[2 * k :] - 2.0 * error_mgauss[k:-k] + error_mgauss[: -2 * k]
    return out / math.sqrt(6.0)


def _usual(values: FloatArray) -> FloatArray:
    """Return the deviation of columns (M, ...), robustly; 0 where there are none."""
    return (
        np.asarray(1.4826 * np.median(np.abs(values), axis=0)) if len(values) else np.zeros(values.shape[1:])
    )


def _along_field(readings: Readings) -> FloatArray:
    """Return second differences along the field, (N,), scaled to white noise's deviation.

    An attitude that shakes faster than its gyro is read turns the field, and leaves nothing there.
    """
    field = readings.nominal_mgauss
    product = np.einsum("ij,ij->i", neighbours(readings.error_mgauss), field)
    return np.asarray(product / np.maximum(np.linalg.norm(field, axis=1), 1e-9))


def _unrelated(readings: Readings) -> bool:
    """Tell whether no reading's scatter follows others': a vehicle's swing, seen by a slow compass, does."""
    second, quiet = neighbours(readings.error_mgauss), readings.quiet
    for lag in _LAGS:
        both = quiet[lag:] & quiet[:-lag]
        one, other = second[lag:][both], second[:-lag][both]
        size = math.sqrt(float(np.sum(one**2) * np.sum(other**2)))
        related = max(usual.scatter.related, _BY_CHANCE / math.sqrt(max(one.size, 1)))
        if both.sum() > usual.scatter.fewest and abs(float(np.sum(one * other))) > related * size:
            return False
    return True


def _of_each_axis(readings: Readings) -> bool:
    """Tell whether each axis scatters by itself: what changes all of them together is one thing's field."""
    second = neighbours(readings.error_mgauss)[readings.quiet]
    square = second.T @ second
    size = np.sqrt(np.maximum(np.diag(square), 1e-300))
    return bool(np.abs(np.triu(square / np.outer(size, size), 1)).max() < usual.scatter.together)


def _steady(readings: Readings, excess: float) -> bool:
    """Tell whether the scatter stays alike all the time."""
    square = np.mean(neighbours(readings.error_mgauss)[readings.quiet] ** 2, axis=1)
    spans = [
        float(np.mean(part))
        for part in np.array_split(square, usual.scatter.spans)
        if part.size >= usual.scatter.fewest
    ]
    return not spans or max(spans) < usual.scatter.unsteady * max(min(spans), 0.25 * excess)
