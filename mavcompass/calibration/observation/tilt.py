"""The tilt of a still position, and the accelerometer's part in it: in the lean that turns with the vehicle.

Standing at several headings shows two tilts: the ground's, which stays, and one that turns along.
The latter is how the vehicle stands, or the accelerometer's own error, and no reading parts the two:

    roll = r + u cos t + v sin t,   pitch = p - u sin t + v cos t                                        (A1)

with the lean (r, p), the ground's slope (u, v) and the angle t turned. Where hardly any lean is seen there is
hardly any error either; a lean is the accelerometer's as far as that is likely beforehand.
"""

from __future__ import annotations

import itertools
import math

import numpy as np

from mavcompass.attitude import Levels, levels
from mavcompass.frames import FloatArray
from mavcompass.track import Track

# What the ground, the suspension and the accelerometer's vibration add to a tilt averaged over a dwell.
TILT_FLOOR_RAD = math.radians(0.02)
# What the accelerometer's calibration leaves: one thousandth of gravity, the same at every position.
TILT_BIAS_SIGMA_RAD = 0.001
# What an accelerometer is off by, each axis, and how often: calibrated, to a thousandth of gravity (as
# autopilots ask for); or not, by a tenth of a metre per second squared (datasheets: 20 to 60 mg).
_ACCELEROMETERS = ((0.8, TILT_BIAS_SIGMA_RAD), (0.2, 0.1 / 9.81))
# Where nothing shows which of them it is.
UNSEEN_BIAS_RAD = math.sqrt(sum(often * own**2 for often, own in _ACCELEROMETERS))
# How vehicles stand, float or hover, averaged over a turn: upright, or as wheels, skids and hulls have it.
_STANCES = ((0.5, math.radians(0.15)), (0.5, math.radians(1.5)))
# Ground is rarely steeper.
_SLOPE_RAD = math.radians(5.0)


def tilt_during(
    track: Track, time_s: FloatArray, lag_sigma_s: float = 0.0, level: Levels | None = None
) -> tuple[float, float, float]:
    """Return roll, pitch and their sigma over the stretch of some readings.

    `lag_sigma_s` is what is not known of the readings' times: it matters while the tilt changes.
    """
    level = level or levels(track)
    downs = level.at(time_s)
    x, y, z = downs.mean(axis=0)
    sigma = float(level.sigma_rad.at(time_s).mean())
    # The mean of a swing is that of other moments where the times are off.
    lasts_s = max(float(time_s[-1] - time_s[0]), 1e-3)
    moved = float(np.linalg.norm(downs[-1] - downs[0])) * lag_sigma_s / lasts_s
    sigma = math.hypot(sigma, TILT_FLOOR_RAD, moved)
    return math.atan2(y, z), math.atan2(-x, math.hypot(y, z)), sigma


def accelerometer_sigma_rad(
    turned_rad: FloatArray, roll_rad: FloatArray, pitch_rad: FloatArray, sigma_rad: FloatArray
) -> float:
    """Return what the accelerometer adds to roll and pitch all along, 1 sigma of each, radians.

    Args:
        turned_rad: angle of each stand, (K,). roll_rad, pitch_rad: as measured there, (K,), and their noise
            `sigma_rad`.
    """
    cos, sin = np.cos(turned_rad), np.sin(turned_rad)
    one, none = np.ones_like(cos), np.zeros_like(cos)
    design = np.concatenate(
        [np.stack([one, none, cos, sin], axis=1), np.stack([none, one, -sin, cos], axis=1)]
    )
    weight = np.tile(sigma_rad**-2.0, 2)
    prior = np.diag([1e-6, 1e-6, _SLOPE_RAD**-2.0, _SLOPE_RAD**-2.0])
    covariance = np.linalg.inv(design.T @ (design * weight[:, np.newaxis]) + prior)
    tilts = np.concatenate([roll_rad, pitch_rad])
    found = covariance @ design.T @ (weight * tilts)
    lean = found[:2]
    # What sways stands otherwise each time: its residuals tell by how much.
    swaying = float(weight @ (tilts - design @ found) ** 2) / max(len(tilts) - 4, 1)
    noise2 = 0.5 * float(np.trace(covariance[:2, :2])) * max(swaying, 1.0)
    size2 = float(lean @ lean)
    shares, squares = [], []
    for (often, own), (usual, stance) in itertools.product(_ACCELEROMETERS, _STANCES):
        spread2 = own**2 + stance**2 + noise2
        part = own**2 / spread2
        shares.append(math.log(often * usual / spread2) - 0.5 * size2 / spread2)
        squares.append(0.5 * part**2 * size2 + own**2 * (1.0 - part))
    share = np.exp(np.array(shares) - max(shares))
    return math.sqrt(float(share @ np.array(squares)) / float(share.sum()))
