"""What a calibration by turning looks at: still positions and their tilt, and the turns between them.

Standing at several headings shows two tilts: the ground's, which stays, and one that turns along.
The latter is how the vehicle stands, or the accelerometer's own error, and no reading parts the two:

    roll = r + u cos t + v sin t,   pitch = p - u sin t + v cos t                                        (A1)

with the lean (r, p), the ground's slope (u, v) and the angle t turned. Where hardly any lean is seen there is
hardly any error either; a lean is the accelerometer's as far as that is likely beforehand.
"""

from __future__ import annotations

import itertools
import math
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from mavcompass.attitude import LASTS_S, Levels, levels
from mavcompass.calibration.observation.turning import GYRO_SCALE_SIGMA, TurnRecord, turn_record
from mavcompass.calibration.observation.wire import fresh_readings, hidden_in_runs, unquantise
from mavcompass.correction import FieldCorrection
from mavcompass.errors import PoorCalibration
from mavcompass.frames import FloatArray, level_to_body, tilt_from_acceleration
from mavcompass.heading.compute import tilt_compensated_heading
from mavcompass.track import MagSeries, Track

LAG_SIGMA_S = 0.03
_OUTLIER_SIGMAS = 5.0
# Before and after a stretch: several periods of a position loop, and longer than errors of the level last.
_NEAR_S = 20.0
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


@dataclass(frozen=True, slots=True, eq=False)
class Dwell:
    """Hold one still position of a vehicle.

    A vehicle may hunt and sway while it dwells. The average over a small swing is exact all the same: in the
    mean, level axes are taken to the body's by the tilt's rotation times `swing`.

    Attributes:
        start_s, end_s: the stretch of the recording.
        mean_mgauss: raw field in body axes, (3,): offsets, matrix and scale in force undone, motor
            compensation left in, whole-number conversion taken back.
        covariance_mgauss2: of that mean, (3, 3), by noise; repeated readings count once.
        quantisation_mgauss2: of that mean, (3, 3), by the wire's whole numbers.
        roll_rad, pitch_rad, tilt_sigma_rad: the tilt, and what is not known of it (each angle).
        samples: fresh readings in the mean.
        turned_rad: the gyro's angle about the vertical, counted from the recording's start; nan
            without a gyro. turned_sigma_rad: by the field's lag behind the gyro.
        swing: (3, 3), one for perfect stillness, see above.
        current_a: mean battery current, nan where not recorded.
        unsteady_mgauss: how much the field wandered inside the dwell beyond noise and turning.
    """

    start_s: float
    end_s: float
    mean_mgauss: FloatArray
    covariance_mgauss2: FloatArray
    quantisation_mgauss2: FloatArray = field(default_factory=lambda: np.zeros((3, 3)))
    roll_rad: float = 0.0
    pitch_rad: float = 0.0
    tilt_sigma_rad: float = TILT_FLOOR_RAD
    samples: int = 1
    turned_rad: float = math.nan
    turned_sigma_rad: float = 0.0
    swing: FloatArray = field(default_factory=lambda: np.eye(3))
    current_a: float = math.nan
    unsteady_mgauss: float = 0.0

    def heading_rad(self, correction: FieldCorrection) -> float:
        """Return the tilt-compensated magnetic heading under a correction."""
        field_mgauss = correction.apply(self.mean_mgauss)
        return float(tilt_compensated_heading(field_mgauss, roll_rad=self.roll_rad, pitch_rad=self.pitch_rad))

    def heading_sigma_rad(self, horizontal_mgauss: float, vertical_mgauss: float) -> float:
        """Return how far the heading by this position may be off in such a field: noise, tilt, unrest."""
        level = (self.covariance_mgauss2 + self.quantisation_mgauss2)[:2, :2]
        noise = math.sqrt(float(np.linalg.eigvalsh(level)[-1]))
        across_mgauss = math.hypot(noise, self.unsteady_mgauss, vertical_mgauss * self.tilt_sigma_rad)
        return across_mgauss / horizontal_mgauss


@dataclass(frozen=True, slots=True)
class Step:
    """Hold one turn between two dwells: clockwise positive, sigma without the gyro's scale and bias."""

    angle_rad: float
    sigma_rad: float
    duration_s: float = 0.0


@dataclass(frozen=True, slots=True, eq=False)
class FourPositionData:
    """Hold what a four-position calibration works on: K dwells and the K - 1 turns between them.

    Attributes:
        gyro_scale_sigma: relative, common to all steps.
        gyro_bias_sigma_radps: of the rate, common to all steps, in proportion to their duration.
        tilt_bias_sigma_rad: of roll and pitch, common to all dwells: the accelerometer's.
        source: the recording's name, for messages.
        first_heading: the first dwell's magnetic heading and its sigma, radians, where it is given.
    """

    dwells: tuple[Dwell, ...]
    steps: tuple[Step, ...]
    gyro_scale_sigma: float = GYRO_SCALE_SIGMA
    gyro_bias_sigma_radps: float = 0.0
    tilt_bias_sigma_rad: float = 0.0
    source: str = ""
    first_heading: tuple[float, float] | None = None

    def __post_init__(self) -> None:
        """Raise ValueError where dwells and steps do not alternate."""
        if len(self.steps) != max(len(self.dwells) - 1, 0):
            raise ValueError(f"{len(self.dwells)} dwells need {len(self.dwells) - 1} steps between them")

    @property
    def turned_rad(self) -> FloatArray:
        """Return each dwell's angle counted from the first, (K,)."""
        return np.concatenate([[0.0], np.cumsum([step.angle_rad for step in self.steps])])


def dwell_between(
    track: Track,
    instance: int,
    start_s: float,
    end_s: float,
    turn: TurnRecord | None = None,
    level: Levels | None = None,
) -> Dwell:
    """Average what one compass saw between two times in which the vehicle stood still.

    A change of the correction in force inside the stretch is honoured. `turn` and `level` are the
    recording's, where the caller has them already.
    Raises PoorCalibration where the stretch holds fewer than two readings, KeyError for an unknown compass.
    """
    compass = track.compasses[instance]
    rows = slice(*np.searchsorted(compass.time_s, [start_s, end_s]))
    time, reported = compass.time_s[rows], np.asarray(compass.reported.values[rows])
    usable = np.isfinite(reported).all(axis=1)
    time, reported = time[usable], reported[usable]
    if time.size < 2:
        raise PoorCalibration(
            f"Compass {instance} has {time.size} readings between {start_s:.1f} s and {end_s:.1f} s.",
            "Stand still longer, or ask for a higher message rate.",
        )
    in_force = compass.correction_at(float(time[-1]))
    if compass.correction_at(float(time[0])) != in_force:
        was = [compass.correction_at(float(t)) for t in time]
        reported = in_force.apply(np.array([c.undo(row) for c, row in zip(was, reported, strict=True)]))
    level = level or levels(track)
    turn = turn or turn_record(track, instance, level)
    return _dwell(track, level, compass, in_force, time, reported, turn)


def latest_dwells(track: Track, instances: tuple[int, ...], start_s: float, end_s: float) -> list[Dwell]:
    """Average what compasses saw in one of the last stretches of a long session; see `dwell_between`.

    A session is looked at again and again: its level is estimated once for all compasses, from so near that
    it is known as well, it goes on from what it was as long as that begins at the same reading, and what has
    come since is asked about the stretch alone. Turns count from there.
    """
    begins_s = LASTS_S * math.floor((start_s - _NEAR_S) / LASTS_S)
    near = track.between(begins_s, end_s + _NEAR_S)
    level = levels(near, start_s - near.field_lag_s)
    return [dwell_between(near, i, start_s, end_s, turn_record(near, i, level), level) for i in instances]


def _dwell(
    track: Track,
    level: Levels,
    compass: MagSeries,
    in_force: FieldCorrection,
    time: FloatArray,
    reported: FloatArray,
    record: TurnRecord | None,
) -> Dwell:
    felt_s = time - track.field_lag_s
    angles = record.angle_at(felt_s) if record is not None else np.zeros(time.size)
    down = level.at(felt_s)
    motion = np.column_stack([angles, down[:, :2]])
    fresh = fresh_readings(reported)
    keep = _inliers(reported, motion, compass.quantum_mgauss)
    counted = reported[keep]
    samples = max(int((fresh & keep).sum()), 1)
    line, shares = _carried(motion, reported, keep)
    residual = (reported - line)[keep]
    spread = np.sqrt((residual**2).sum(axis=0) / max(len(counted) - shares, 1.0))
    value, hidden = unquantise(counted.mean(axis=0), spread, compass.quantum_mgauss, compass.truncated)
    runs = hidden_in_runs(counted, np.zeros(1, dtype=np.intp), compass.quantum_mgauss)
    hidden = np.maximum(hidden, runs[0])
    inverse = in_force.inverse
    memory = _memory(residual[fresh[keep]])
    # Whole numbers that never change show no noise; their step's share is in `hidden`.
    covariance = inverse @ np.diag(np.maximum(spread**2, 1e-6) * memory / samples) @ inverse.T
    quantisation = inverse @ np.diag(hidden**2) @ inverse.T
    phasor = np.exp(1j * angles[keep]).mean()
    middle = float(np.median(angles))
    turned = middle + float(np.angle(phasor * np.exp(-1j * middle)))
    turning = abs(float(np.mean(record.rate_at(time)))) if record is not None else 0.0
    roll, pitch, tilt_sigma = tilt_during(track, felt_s, LAG_SIGMA_S, level)
    mapping = level_to_body(*tilt_from_acceleration(-down[keep]), angles[keep] - turned).mean(axis=0)
    current = track.current_a
    return Dwell(
        start_s=float(time[0]),
        end_s=float(time[-1]),
        mean_mgauss=in_force.undo(value),
        covariance_mgauss2=covariance,
        quantisation_mgauss2=quantisation,
        roll_rad=roll,
        pitch_rad=pitch,
        tilt_sigma_rad=tilt_sigma,
        samples=samples,
        turned_rad=turned if record is not None else math.nan,
        turned_sigma_rad=turning * LAG_SIGMA_S,
        swing=level_to_body(roll, pitch).T @ mapping,
        current_a=float(np.nanmean(current.at(time))) if current is not None and len(current) else math.nan,
        unsteady_mgauss=_wander(
            residual,
            math.sqrt(float((spread**2).mean()) * memory * len(counted) / samples),
            compass.quantum_mgauss,
        ),
    )


def _carried(
    motion: FloatArray, field_mgauss: FloatArray, keep: NDArray[np.bool_]
) -> tuple[FloatArray, float]:
    """Predict readings by the small motion inside the dwell, (N, 3), and tell how many of them that took.

    `motion` (N, 3) holds the angle turned and two of leaning. A small rotation moves the field by at most its
    length, so that slopes are held to that and only what a vehicle moved is explained by its motion.
    """
    away = motion - motion[keep].mean(axis=0)
    counted = field_mgauss[keep]
    mean = counted.mean(axis=0)
    if len(counted) < 3:
        return np.broadcast_to(mean, field_mgauss.shape), 1.0
    power, left = away[keep].T @ away[keep], counted - mean
    for _ in range(2):
        noise2 = max(0.5 * float((np.diff(left, axis=0) ** 2).mean()), 1e-6)
        held = noise2 / max(float(mean @ mean), 1.0) * np.eye(3)
        slopes = np.linalg.solve(power + held, away[keep].T @ (counted - mean))
        left = counted - mean - away[keep] @ slopes
    return mean + away @ slopes, 1.0 + float(np.trace(np.linalg.solve(power + held, power)))


def _inliers(reported: FloatArray, motion: FloatArray, quantum: float) -> NDArray[np.bool_]:
    """Mark the readings within five robust sigmas of what the motion predicts, (N,)."""
    everything = np.ones(len(reported), dtype=bool)
    keep = everything
    if len(reported) < 5:
        return everything
    for _ in range(2):
        line, _ = _carried(motion, reported, keep)
        away = reported - line
        away = np.abs(away - np.median(away[keep], axis=0))
        scale = 1.4826 * np.median(away[keep], axis=0) + max(quantum, 1e-6)
        keep = np.asarray((away <= _OUTLIER_SIGMAS * scale).all(axis=1), dtype=np.bool_)
        if keep.sum() < max(3, len(reported) // 2):
            return everything
    return keep


def _memory(residual: FloatArray) -> float:
    """Return by how much correlation from reading to reading raises the variance of the mean (>= 1)."""
    n = len(residual)
    if n < 8:
        return 1.0
    power = float((residual**2).sum())
    if power <= 0.0:
        return 1.0
    lag_one = float((residual[1:] * residual[:-1]).sum()) / power
    # Three axes vote; below two sigmas of that vote it is chance.
    if lag_one < 2.0 / math.sqrt(3.0 * n):
        return 1.0
    return (1.0 + min(lag_one, 0.9)) / (1.0 - min(lag_one, 0.9))


def _wander(residual: FloatArray, noise: float, quantum: float) -> float:
    """Return how far the two halves of a dwell lie apart beyond chance and motion, milligauss."""
    half = len(residual) // 2
    if half < 2:
        return 0.0
    apart = float(np.linalg.norm(residual[half:].mean(axis=0) - residual[:half].mean(axis=0)))
    chance = 4.0 * noise * math.sqrt(4.0 / max(len(residual), 2)) + quantum
    return apart if apart > chance else 0.0


# --- the tilt, and the accelerometer's part in it ---------------------------------------------------


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
