"""A calibration that runs: section by section, in constant memory, with what it has not seen yet.

The state is that of the motion's fit without its past: hard iron, gains, motor field, the Earth's field, the
gyro's scale and bias, the lag, and the heading now. Each section turns the heading by the gyro (F2) and is
compared with what (S1) predicts: an extended Kalman filter, begun by the fit of the first sections that go
far enough round. A section far out is something that passes and is left out; where that lasts, the iron has
changed: the hard iron is forgotten, and the change dated.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np

from mavcompass.calibration.model import GYRO_BIAS, GYRO_SCALE, OFFSET, HeadingError
from mavcompass.calibration.motion.equations import FIRST, field_residual, section_variance
from mavcompass.calibration.motion.findings import circle_seen_rad
from mavcompass.calibration.motion.fit import MotionFit
from mavcompass.calibration.motion.sections import Sections
from mavcompass.frames import FloatArray

# Enough to begin with, and no more than this is ever kept.
_BEGIN_CIRCLE_RAD, _BEGIN_SECTIONS = math.radians(200.0), 12
_SECTORS = 12
# Chi-square of three beyond which a section is left out: by chance once in 2000.
_FAR_OUT = 17.7
# So many left out in a row are no passing magnet.
_CHANGED_AFTER = 5
_FORGOTTEN_MGAUSS = 300.0
# The iron's own drift, and the bias's, per root second.
_IRON_DRIFT_MGAUSS, _BIAS_DRIFT_RADPS = 0.02, math.radians(0.001)
# Over how many sections the model error is averaged.
_MODEL_MEMORY = 40.0


@dataclass(frozen=True, slots=True, eq=False)
class RunningFit:
    """Hold a running calibration: 18 numbers, their covariance, and a few more; always of the same size.

    Attributes:
        state: 16 numbers named by `model.NAMES`, the lag, and the heading now. covariance: of them.
        turned_rad, time_s: the gyro's angle and the time of the last section.
        model_mgauss: the size of what sections contradict each other by, beyond their noise.
        seen: sections that counted, per twelfth of the circle, (12,).
        left_out: how many in a row were far out, since `out_since_s`. changed_s: when the iron last changed
            (nan: never).
    """

    state: FloatArray
    covariance: FloatArray
    turned_rad: float
    time_s: float
    model_mgauss: float
    seen: FloatArray
    left_out: int = 0
    out_since_s: float = math.nan
    changed_s: float = math.nan

    @property
    def heading_error(self) -> HeadingError:
        """Return the heading's uncertainty as a function of heading and tilt."""
        return HeadingError(self.state[:11], self.covariance[:9, :9])

    @property
    def not_seen_deg(self) -> tuple[int, ...]:
        """List the twelfths of the circle that did not count yet, by their first magnetic heading."""
        return tuple(int(360 / _SECTORS * k) for k in np.flatnonzero(self.seen == 0.0))


def begin_at(sections: Sections) -> int | None:
    """Return how many of the first sections go far enough round to begin with; None where all do not."""
    for count in range(_BEGIN_SECTIONS, len(sections) + 1):
        if circle_seen_rad(sections.turned_rad[:count]) >= _BEGIN_CIRCLE_RAD:
            return count
    return None


def begin(sections: Sections, fit: MotionFit, widened: float = 1.0) -> RunningFit:
    """Begin with the fit of some sections; `widened` multiplies its covariance, as honesty asks."""
    kept = np.r_[0:FIRST, fit.state.size - 1]
    seen = np.bincount(_sector(fit.headings_rad), fit.sound, _SECTORS)
    return RunningFit(
        state=fit.state[kept],
        covariance=fit.covariance[np.ix_(kept, kept)] * widened,
        turned_rad=float(sections.turned_rad[-1]),
        time_s=float(sections.middle_s[-1]),
        model_mgauss=fit.model_mgauss,
        seen=np.asarray(seen, dtype=np.float64),
    )


def update(running: RunningFit, section: Sections, step_sigma_rad: float) -> RunningFit:
    """Take one more section (a `Sections` of length 1), `step_sigma_rad` of the turn before it."""
    predicted = _predicted(running, section, step_sigma_rad)
    residual, by = field_residual(section, predicted.state)
    away, jacobian = residual[0], by[0]
    plain = section_variance(section, predicted.state, 0.0)[0]
    # What the sections of one visit share counts once: the n-th brings a share of 1 / n^2.
    shared = plain - section.noise_mgauss**2 / section.samples[0] * np.eye(3)
    again = float(section.repeats[0]) ** 2 - 1.0
    model = running.model_mgauss**2 * np.eye(3)
    explained = jacobian @ predicted.covariance @ jacobian.T + plain + again * shared
    innovation = explained + (1.0 + again) * model
    if float(away @ np.linalg.solve(innovation, away)) > _FAR_OUT:
        return _left_out(predicted, section)
    gain = np.linalg.solve(innovation, jacobian @ predicted.covariance).T
    keep = np.eye(predicted.state.size) - gain @ jacobian
    noise = plain + again * shared + (1.0 + again) * model
    covariance = keep @ predicted.covariance @ keep.T + gain @ noise @ gain.T
    state = predicted.state + gain @ away
    excess = float(away @ away - np.trace(explained)) / 3.0
    variance = running.model_mgauss**2 + (excess - running.model_mgauss**2) / _MODEL_MEMORY
    seen = running.seen.copy()
    seen[_sector(state[FIRST:])] += 1.0
    return replace(
        predicted,
        state=state,
        covariance=covariance,
        model_mgauss=math.sqrt(max(variance, 0.0)),
        seen=seen,
        left_out=0,
        out_since_s=math.nan,
    )


def _predicted(running: RunningFit, section: Sections, step_sigma_rad: float) -> RunningFit:
    """Turn the heading by the gyro to the middle of the next section."""
    lasted = float(section.middle_s[0]) - running.time_s
    scale = 1.0 + running.state[GYRO_SCALE]
    turn = (float(section.turned_rad[0]) - running.turned_rad - running.state[GYRO_BIAS] * lasted) / scale
    state = running.state.copy()
    state[FIRST] += turn
    step = np.eye(state.size)
    step[FIRST, GYRO_SCALE], step[FIRST, GYRO_BIAS] = -turn / scale, -lasted / scale
    covariance = step @ running.covariance @ step.T
    covariance[FIRST, FIRST] += step_sigma_rad**2
    covariance[GYRO_BIAS, GYRO_BIAS] += _BIAS_DRIFT_RADPS**2 * lasted
    covariance[OFFSET, OFFSET] += _IRON_DRIFT_MGAUSS**2 * lasted * np.eye(3)
    return replace(
        running,
        state=state,
        covariance=covariance,
        turned_rad=float(section.turned_rad[0]),
        time_s=float(section.middle_s[0]),
    )


def _left_out(running: RunningFit, section: Sections) -> RunningFit:
    """Leave a section out; where that lasts, forget the hard iron and date the change."""
    since = float(section.start_s[0]) if running.left_out == 0 else running.out_since_s
    if running.left_out + 1 < _CHANGED_AFTER:
        return replace(running, left_out=running.left_out + 1, out_since_s=since)
    covariance = running.covariance.copy()
    covariance[OFFSET, :] = covariance[:, OFFSET] = 0.0
    covariance[OFFSET, OFFSET] = _FORGOTTEN_MGAUSS**2 * np.eye(3)
    return replace(
        running,
        covariance=covariance,
        seen=np.zeros(_SECTORS),
        left_out=0,
        out_since_s=math.nan,
        changed_s=since,
    )


def _sector(heading_rad: FloatArray) -> FloatArray:
    part = np.mod(heading_rad, 2.0 * math.pi) / (2.0 * math.pi) * _SECTORS
    return np.minimum(part.astype(np.intp), _SECTORS - 1)
