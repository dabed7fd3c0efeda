"""How far a heading may be off: the one reckoning, of a recording and live.

A calibration that is off by the iron d, in the vehicle's level axes, lengthens the horizontal field along it,

    h = H + u . d + noise,    u the direction of the field,                                            (D1)

and turns the heading by d across u, over H. So strengths that were seen all round tell d, one strength tells
one component of it, and what they do not tell stays what it was before: the calibration's own sigma; of one
that nobody judged, a few degrees; of a compass that was never calibrated, the iron that vehicles have.
A reading that a compass repeats is late, by what the vehicle turned since it was new.
"""

from __future__ import annotations

import math

import numpy as np

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
# Seen over and over again at one heading, a strength is one observation, not a thousand.
_SECTORS = 24
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
        # By sector: weight, and weighed strength, direction, vertical, strength squared.
        self._sums = np.zeros((_SECTORS, 6))

    def add(self, along_mgauss: float, across_mgauss: float, down_mgauss: float, keep: float = 1.0) -> None:
        """Take one level field; `keep` is the share that older ones of the same sector retain."""
        strength = math.hypot(along_mgauss, across_mgauss)
        if strength < 1.0:
            return
        row = self._sums[int(math.atan2(across_mgauss, along_mgauss) / (2.0 * math.pi) * _SECTORS)]
        row *= keep
        row += (1.0, strength, along_mgauss / strength, across_mgauss / strength, down_mgauss, strength**2)

    def add_all(self, level_mgauss: FloatArray) -> None:
        """Take level fields, (N, 3): along the nose, to the right, down."""
        strength = np.hypot(level_mgauss[:, 0], level_mgauss[:, 1])
        along, across, down = level_mgauss[strength >= 1.0].T
        strength = strength[strength >= 1.0]
        place = (np.arctan2(across, along) / (2.0 * math.pi) * _SECTORS).astype(np.intp) % _SECTORS
        values = (np.ones(along.size), strength, along / strength, across / strength, down, strength**2)
        for column, weights in enumerate(values):
            self._sums[:, column] += np.bincount(place, weights, _SECTORS)

    @property
    def scatter_mgauss(self) -> float:
        """Tell how far single strengths are from their sector's: by noise, and by tilt times the vertical.

        Neither knows the nose, so the field across, which turns the heading, is off by as much.
        """
        weight, strength, square = self._sums[:, 0], self._sums[:, 1], self._sums[:, 5]
        within = square - strength**2 / np.maximum(weight, 1e-9)
        return math.sqrt(max(float(within.sum()), 0.0) / max(float(weight.sum()), 1e-9))

    def iron(self) -> tuple[FloatArray, FloatArray, float]:
        """Return the iron (2,) by (D1), its covariance (2, 2), and the strength of the field, milligauss."""
        seen = self._sums[self._sums[:, 0] > 0.0]
        mean = seen[:, 1:] / seen[:, :1]
        usual, sigma, expected = _ANYWHERE_MGAUSS, _ANYWHERE_SIGMA_MGAUSS, self.sigma_mgauss
        if self.world is not None and len(mean):
            usual, sigma = self.world.horizontal_mgauss, math.hypot(*self.world.sigma_mgauss, _SITE_MGAUSS)
            # Iron is alike on all axes: what shows of it tells how much of it there may be unseen.
            shown = np.append(mean[:, 0] - usual, mean[:, 3].mean() - self.world.ned_mgauss[2])
            beyond = max(float((shown**2).sum()) / (shown.size - 1) - sigma**2, 0.0)
            expected = math.sqrt(expected**2 / (1.0 + shown.size) + beyond)
        design, off = np.column_stack([np.ones(len(mean)), mean[:, 1:3]]), mean[:, 0] - usual
        prior = np.array([sigma, max(expected, 1e-3), max(expected, 1e-3)]) ** -2.0
        noise, found, covariance = _SITE_MGAUSS, np.zeros(3), np.diag(1.0 / prior)
        for _ in range(2 if len(mean) else 0):
            covariance = np.asarray(np.linalg.inv(design.T @ design / noise**2 + np.diag(prior)))
            found = covariance @ (design.T @ off) / noise**2
            noise = max(_SITE_MGAUSS, float(np.sqrt(((off - design @ found) ** 2).mean())))
        return found[1:], covariance[1:, 1:], max(usual + float(found[0]), 1.0)

    def sigma_rad(self, along_mgauss: FloatArray, across_mgauss: FloatArray) -> FloatArray:
        """Return the heading's sigma by the calibration, (N,), where the level field points so."""
        iron, covariance, strength = self.iron()
        length = np.maximum(np.hypot(along_mgauss, across_mgauss), 1e-9)
        turn = np.stack([-across_mgauss / length, along_mgauss / length], axis=-1)
        square = (turn @ iron) ** 2 + np.einsum("ni,ij,nj->n", turn, covariance, turn)
        return np.asarray(np.sqrt(square) / strength)


def heading_sigma_rad(
    calibration_rad: FloatArray | float,
    horizontal_mgauss: FloatArray | float,
    vertical_mgauss: FloatArray | float,
    tilt_sigma_rad: FloatArray | float,
    noise_mgauss: FloatArray | float = 0.0,
    late_rad: FloatArray | float = 0.0,
) -> FloatArray:
    """Combine what a heading may be off by, (...): calibration, noise, tilt by the dip, lateness."""
    horizontal = np.maximum(horizontal_mgauss, 1e-9)
    tilt = np.asarray(vertical_mgauss) / horizontal * tilt_sigma_rad
    noise = np.asarray(noise_mgauss) / horizontal
    square = np.square(calibration_rad) + noise**2 + tilt**2 + np.square(late_rad)
    return np.asarray(np.minimum(np.sqrt(square), math.pi))


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
