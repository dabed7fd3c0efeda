"""The scatter that a correction leaves, seen as a heading: the compass against the gyro, second by second."""

from __future__ import annotations

import math

import numpy as np

from mavcompass.calibration.model import HORIZONTAL, LAG, MOTOR, VERTICAL
from mavcompass.calibration.motion.fit import MotionFit
from mavcompass.calibration.motion.sections import Sections, unsettled
from mavcompass.calibration.observation import field_lag_s
from mavcompass.calibration.observation.turning import TurnRecord
from mavcompass.frames import FloatArray, wrap_pi
from mavcompass.heading.compute import tilt_compensated_heading
from mavcompass.track import Track

# While turning or tilting the lag of the field and of the tilt would be seen, not the compass's error.
_SLOW_RADPS = math.radians(5.0)
_FEWEST_S = 5
# Where the tilt is known no better than this the compass is not seen either: that must not excuse the rest.
_TILT_KNOWN_RAD = math.radians(1.5)
# Leaning more than this, a nose has hardly a heading.
_LEAST_UPRIGHT = math.cos(math.radians(45.0))
# What counts as chance: so many standard deviations of the noise's own variance.
_CHANCE = 4.0


def scatter_left_rad(
    track: Track,
    instance: int,
    field_mgauss: FloatArray,
    down: FloatArray,
    record: TurnRecord,
    sections: Sections,
    fit: MotionFit,
) -> float:
    """Return the rms scatter of a corrected compass's heading about the gyro's, beyond noise; radians.

    Args:
        track: the recording.
        instance: the compass.
        field_mgauss: its corrected field, (N, 3). down: which way is down in the body, (N, 3).
        record: the gyro's turn.
        sections: of the motion.
        fit: tells the lag, the gyro's drift, and which sections are disturbed: these do not count.
    """
    time = track.compasses[instance].time_s
    usable = np.isfinite(field_mgauss).all(axis=1)
    usable &= (time >= sections.start_s[0]) & (time <= sections.end_s[-1])
    usable &= ~unsettled(track, instance)
    section = np.clip(np.searchsorted(sections.start_s, time, side="right") - 1, 0, len(sections) - 1)
    usable &= (time <= sections.end_s[section]) & (sections.tilt_sigma_rad[section] < _TILT_KNOWN_RAD)
    late = field_lag_s(track) + float(fit.state[LAG])
    tilting = np.interp(time - late, record.time_s, record.tilt_rate_radps) - 1.3 * record.noise_radps
    slow = usable & (down[:, 2] > _LEAST_UPRIGHT)
    slow &= np.hypot(record.rate_at(time - late), np.maximum(tilting, 0.0)) < _SLOW_RADPS
    if int(slow.sum()) < 2:
        return 0.0
    time, section = time[slow], section[slow]
    heading = np.asarray(tilt_compensated_heading(field_mgauss[slow], -down[slow]))
    drift = np.interp(time, sections.middle_s, fit.headings_rad - sections.turned_rad)
    off = np.asarray(wrap_pi(heading - drift - record.angle_at(time - late)))
    sound = fit.sound[section]
    lasted = np.maximum(sections.end_s - sections.start_s, 1.0)
    visit = sound / (sections.repeats * lasted)[section]
    off = np.asarray(wrap_pi(off - np.angle((visit * np.exp(1j * off)).sum())))
    _, second = np.unique(np.floor(time), return_inverse=True)
    weight = np.bincount(second, sound)
    readings = np.bincount(second)
    kept = weight > 0.3 * readings
    if int(kept.sum()) < _FEWEST_S:
        return 0.0
    mean = np.bincount(second, sound * off)[kept] / weight[kept]
    fresh = float(sections.samples.sum() / max((sections.end_s - sections.start_s).sum(), 1e-9))
    dip = float(fit.state[VERTICAL] / fit.state[HORIZONTAL])
    tilt = np.bincount(second, sections.tilt_sigma_rad[section])[kept] / readings[kept]
    noise = (sections.noise_mgauss / float(fit.state[HORIZONTAL])) ** 2 / np.minimum(
        readings[kept], max(fresh, 1.0)
    ) + (tilt * dip) ** 2
    # Long standing must not hide what the turns show, nor the turns what long standing shows.
    by_visit = (np.bincount(second, visit)[kept] / readings[kept]).clip(1e-12)
    return max(_beyond_noise(mean, noise, share) for share in (by_visit, np.ones_like(by_visit)))


def _beyond_noise(off_rad: FloatArray, variance: FloatArray, weights: FloatArray) -> float:
    """Return the weighted rms of what noise of a given variance does not explain."""
    share = weights / weights.sum()
    chance = float(share @ variance) * (1.0 + _CHANCE * math.sqrt(2.0 * float(share @ share)))
    return math.sqrt(max(float(share @ off_rad**2) - chance, 0.0))


def motors_left_rad(sections: Sections, fit: MotionFit, left_mgauss: FloatArray) -> float:
    """Return the heading scatter by a motor field (3,) per unit of load that is not taken out, radians.

    What chance gives the fit is not counted.
    """
    sigma = np.diag(fit.covariance)[MOTOR]
    beyond = np.maximum(left_mgauss**2 - _CHANCE * sigma, 0.0)[:2].sum()
    swing = float(np.average((sections.load) ** 2, weights=1.0 / sections.repeats))
    horizontal = float(fit.state[HORIZONTAL]) * float(np.trace(fit.gain[:2, :2])) / 2.0
    return math.sqrt(0.5 * float(beyond) * swing) / abs(horizontal)
