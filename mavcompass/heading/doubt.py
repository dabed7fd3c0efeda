"""How far a heading may be off: the one reckoning, of a recording and live.

A calibration that is off by the iron d, in the vehicle's level axes (complex: along + i across), shows

    |m - d| = H + noise                                                                              (D1)

of the level field m, and a heading that is off by the angle from m - d to m. So strengths that were seen all
round tell d, one strength and the dip tell how much of it there must be, and what they do not tell stays what
it was before: the calibration's own sigma; of one that nobody judged, a few degrees; of a compass that was
never calibrated, the iron that vehicles have.
A reading that a compass repeats is late, by what the vehicle turned since it was new.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from mavcompass.earth_field import EarthField
from mavcompass.frames import FloatArray
from mavcompass.track import Track

# Where no calibration of this compass is on record, this much is assumed of whatever is in force.
UNKNOWN_CALIBRATION_SIGMA_RAD = math.radians(5.0)
# Iron of vehicles whose compass was never calibrated, each axis.
_IRON_MGAUSS = 100.0
# Strength of the horizontal field where people drive, for a place that is not known; and what rocks, steel in
# the ground and the calibration's gains leave of it where the place is.
_ANYWHERE_MGAUSS, _ANYWHERE_SIGMA_MGAUSS, _SITE_MGAUSS = 220.0, 80.0, 5.0
# What an accelerometer, as it is mounted, is off by in roll and pitch, each, beside what motion hides.
TILT_SIGMA_RAD = math.radians(0.3)
# Seen over and over again in one direction, and about as strong, a field is one observation, not a thousand.
_SECTORS, _RINGS, _RING = 24, 24, math.log(1.25)
# Of a direction's readings less are what it showed before, or noise.
_LEAST_SHARE = 0.05
# Where iron may be is looked for on a grid, finer each time.
_GRID, _TIMES = np.linspace(-1.0, 1.0, 17), 7
# What turns slower may be the gyro's bias: over minutes on a bench that adds up to a circle.
_BIAS_RADPS = math.radians(3.0)


def prior_sigma_mgauss(calibrated: bool, horizontal_mgauss: float) -> float:
    """Return the iron to be expected under what is in force, each axis, before any look at the field.

    `calibrated` is False, too, where that is not known.
    """
    return UNKNOWN_CALIBRATION_SIGMA_RAD * horizontal_mgauss if calibrated else _IRON_MGAUSS


def prior_sigma_rad(calibrated: bool) -> float:
    """Return the same as a heading's sigma, in the field of a usual place."""
    return prior_sigma_mgauss(calibrated, _ANYWHERE_MGAUSS) / _ANYWHERE_MGAUSS


class CalibrationDoubt:
    """Keep what the strength of the field told of a calibration.

    Attributes:
        sigma_mgauss: of the iron that is left, each axis, beforehand.
        world: the Earth's field at the place, None where that is not known.
    """

    def __init__(self, sigma_mgauss: float, world: EarthField | None = None) -> None:
        self.sigma_mgauss = sigma_mgauss
        self.world = world
        # By direction and strength: weight, and weighed field, strength, strength squared.
        self._sums = np.zeros((_SECTORS, _RINGS, 6))

    def add(self, along_mgauss: float, across_mgauss: float, down_mgauss: float, keep: float = 1.0) -> None:
        """Take one level field; `keep` is the share that older ones of the same direction retain."""
        strength = math.hypot(along_mgauss, across_mgauss)
        if strength < 1.0:
            return
        sector, ring = divmod(int(_place(complex(along_mgauss, across_mgauss))), _RINGS)
        self._sums[sector] *= keep
        self._sums[sector, ring] += (1.0, along_mgauss, across_mgauss, down_mgauss, strength, strength**2)

    def add_all(self, level_mgauss: FloatArray) -> None:
        """Take level fields, (N, 3): along the nose, to the right, down."""
        strength = np.hypot(level_mgauss[:, 0], level_mgauss[:, 1])
        (along, across, down), strength = level_mgauss[strength >= 1.0].T, strength[strength >= 1.0]
        place = _place(along + 1j * across)
        values = (np.ones(along.size), along, across, down, strength, strength**2)
        sums = [np.bincount(place, weights, _SECTORS * _RINGS) for weights in values]
        self._sums += np.stack(sums, axis=1).reshape(self._sums.shape)

    @property
    def scatter_mgauss(self) -> float:
        """Tell how far single strengths are from their direction's: by noise, and by tilt times the vertical.

        Neither knows the nose, so the field across, which turns the heading, is off by as much.
        """
        weight, strength, square = self._sums[..., (0, 4, 5)].sum(axis=1).T
        within = square - strength**2 / np.maximum(weight, 1e-9)
        return math.sqrt(max(float(within.sum()), 0.0) / max(float(weight.sum()), 1e-9))

    def iron(self) -> tuple[NDArray[np.complex128], FloatArray]:
        """Return where the iron may be by (D1), (P,), and how probable that is, once a field was seen."""
        weight = self._sums[..., 0]
        seen = self._sums[weight > np.maximum(_LEAST_SHARE * weight.sum(axis=1, keepdims=True), 1e-9)]
        field, strength = (seen[:, 1] + 1j * seen[:, 2]) / seen[:, 0], seen[:, 4] / seen[:, 0]
        usual, sigma, expected2 = _ANYWHERE_MGAUSS, _ANYWHERE_SIGMA_MGAUSS, max(self.sigma_mgauss, 1e-3) ** 2
        shown, chance = strength - usual, 2.0 * sigma  # which reach all places where people drive
        if self.world is not None:
            usual, sigma = self.world.horizontal_mgauss, math.hypot(*self.world.sigma_mgauss, _SITE_MGAUSS)
            vertical = float((seen[:, 3] / seen[:, 0]).mean()) - self.world.ned_mgauss[2]
            shown, chance = np.append(strength - usual, vertical), sigma
            expected2 /= 1.0 + shown.size
        # Iron is alike on all axes: what shows of it tells how much of it there may be unseen.
        expected2 += max(float((shown**2).sum()) / max(shown.size - 1, 1) - chance**2, 0.0)
        centre, noise = 0.0 + 0.0j, _SITE_MGAUSS
        reach = np.full(2, np.abs(field).max() + usual + 3.0 * sigma)
        for _ in range(_TIMES):
            iron = (centre + reach[0] * _GRID[:, np.newaxis] + 1j * reach[1] * _GRID).ravel()
            # What is finer than the grid must not fall through it.
            spacing = float(reach.max()) * (_GRID[1] - _GRID[0])
            off = np.abs(field - iron[:, np.newaxis]) - usual
            mean, left2 = off.mean(axis=1), off.var(axis=1) * len(seen)
            noise2 = max(noise, 0.5 * spacing) ** 2
            log_share = -0.5 * (
                left2 / noise2
                + len(seen) * mean**2 / (noise2 + len(seen) * sigma**2)
                + np.abs(iron) ** 2 / (expected2 + spacing**2 / 12.0)
            )
            share = np.exp(log_share - log_share.max())
            share /= share.sum()
            if spacing < 0.5 * _SITE_MGAUSS:
                break
            # Soft iron leaves more than the site does.
            noise = max(_SITE_MGAUSS, math.sqrt(float(left2[np.argmax(share)]) / len(seen)))
            centre = complex(share @ iron)
            away = np.stack([iron.real - centre.real, iron.imag - centre.imag])
            reach = np.minimum(3.0 * np.sqrt(away**2 @ share) + spacing, reach)
        return iron, share

    def sigma_rad(self, along_mgauss: FloatArray, across_mgauss: FloatArray) -> FloatArray:
        """Return the heading's sigma by the calibration, (N,), where the level field is so, milligauss."""
        level = np.asarray(along_mgauss) + 1j * np.asarray(across_mgauss)
        _, first, same = np.unique(_place(level), return_index=True, return_inverse=True)
        return self._sigma_rad(level[first])[same]

    def by_direction(self, strength_mgauss: float) -> list[float]:
        """Return the same of a field so strong, of directions from ahead clockwise, equally far apart."""
        middles = (np.arange(_SECTORS) + 0.5) / _SECTORS
        return self._sigma_rad(strength_mgauss * np.exp(2j * math.pi * middles)).tolist()

    def _sigma_rad(self, level_mgauss: NDArray[np.complex128]) -> FloatArray:
        if not self._sums.any():
            return np.full(level_mgauss.shape, self.sigma_mgauss / _ANYWHERE_MGAUSS)
        iron, share = self.iron()
        turned = np.angle((level_mgauss[:, np.newaxis] - iron) * np.conj(level_mgauss)[:, np.newaxis])
        return np.asarray(np.sqrt(turned**2 @ share))


def _place(level_mgauss: NDArray[np.complex128] | complex) -> NDArray[np.intp]:
    """Return which direction and strength level fields, (...), are of."""
    sector = np.angle(level_mgauss) / (2.0 * math.pi) * _SECTORS
    ring = np.log(np.maximum(np.abs(level_mgauss), 1e-9) / _ANYWHERE_MGAUSS) / _RING + _RINGS // 2
    ring = np.clip(np.floor(ring), 0, _RINGS - 1).astype(np.intp)
    return np.asarray(np.floor(sector).astype(np.intp) % _SECTORS * _RINGS + ring)


def turned_vector(track: Track, time_s: FloatArray, usual: bool = True) -> FloatArray:
    """Return the sum of the gyro's turns up to some times, (N, 3), radians; zeros without a gyro.

    `usual` False leaves out the rate that most of the recording has, which may be the gyro's bias, too.
    """
    gyro = track.gyro_radps
    if gyro is None or len(gyro) < 3:
        return np.zeros((len(time_s), 3))
    rate = np.nan_to_num(np.asarray(gyro.values))
    rate -= 0.0 if usual else np.median(rate, axis=0)
    rate[np.abs(rate) < _BIAS_RADPS] = 0.0
    turned = np.zeros_like(rate)
    np.cumsum(rate[:-1] * np.diff(gyro.time_s)[:, np.newaxis], axis=0, out=turned[1:])
    return np.stack([np.interp(time_s, gyro.time_s, column) for column in turned.T], axis=1)


def turned_since_new(track: Track, instance: int) -> FloatArray:
    """Return how far the vehicle turned since each reading of a compass was new, (N,), radians.

    Autopilots repeat a reading until the next, and whole numbers repeat at rest; a frozen compass repeats for
    ever. Raises KeyError for a compass that the recording does not have.
    """
    compass = track.compasses[instance]
    values = np.asarray(compass.reported.values)
    new = np.ones(len(values), dtype=bool)
    new[1:] = (values[1:] != values[:-1]).any(axis=1)
    since = np.maximum.accumulate(np.where(new, np.arange(len(values)), 0))
    # The rate that most of it has is the gyro's bias, or that of what turns more than it stands.
    ways = (turned_vector(track, compass.time_s, usual) for usual in (True, False))
    apart = [np.linalg.norm(turned - turned[since], axis=1) for turned in ways]
    return np.asarray(np.min(apart, axis=0))
