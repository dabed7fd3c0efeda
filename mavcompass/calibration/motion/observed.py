"""One compass's recording as a motion: sections, their fit, and what they say of any correction."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from mavcompass.attitude import LASTS_S
from mavcompass.calibration.motion.fit import (
    MotionFit,
    fit_motion,
    level_headings,
    motor_sigma_of,
    motors_variance,
    sigma_of,
)
from mavcompass.calibration.motion.sections import (
    LEAST_CIRCLE_RAD,
    ReferenceTurn,
    Sections,
    cut_sections,
    reference_turn,
)
from mavcompass.calibration.observation import accelerometer_of, find_dwells, turn_record
from mavcompass.calibration.observation.turning import TurnRecord
from mavcompass.calibration.recorded import Recorded
from mavcompass.correction import USUAL_EXPONENT, FieldCorrection, MotorSource
from mavcompass.errors import PoorCalibration
from mavcompass.frames import FloatArray, circle_covered_rad, wrap_pi
from mavcompass.heading.deviation import Loads
from mavcompass.track import Track
from mavcompass.units import STANDARD_GRAVITY_MPS2

# A load that varies less than this shows no motor field.
_LOAD_SPREAD: tuple[tuple[MotorSource, float], ...] = (("current", 1.0), ("throttle", 0.1))
# Chance makes so many numbers as large as this once in a thousand times (chi-square).
_MOTOR_CHI_SQUARE = {3: 16.3, 9: 27.9}
# Powers of output times voltage that are tried, up to the end of COMPASS_PMOT_EXP's range.
_EXPONENTS = (USUAL_EXPONENT, 1.0, 1.5, 2.0)
# Outputs that differ by less of what they are hold a copter that hovers in still air.
_APART = 0.01
# One motor against the next, on each axis.
_DIFFERENCES: FloatArray = np.kron(np.eye(3, 4) - np.eye(3, 4, 1), np.eye(3)).astype(np.float64)
# A turn without a stop pulls at an accelerometer that sits so far from its centre; the level takes a third of
# that for a lean (simulated: rover 0.32, copter 0.11).
_FROM_CENTRE_M, _TAKEN_FOR_A_LEAN = 0.1, 1.0 / 3.0
_FEWEST_OF_HALF = 8
_LEAST_TURN_RAD = math.radians(60.0)


@dataclass(frozen=True, slots=True, eq=False)
class Motion:
    """Hold a recording's motion as one compass saw it.

    Attributes:
        recorded: the recording. record: the turn, by the gyro or a reference.
        reference: the attitude reference, None where there is none.
        sections: of the motion. fit: of the sections.
        load_source: the load that the fit has a motor field for.
        motors_told: True where that field is told from the iron, so that a correction may take it out.
        exponent: of the load, where that is the motors' outputs.
    """

    recorded: Recorded
    record: TurnRecord
    reference: ReferenceTurn | None
    sections: Sections
    fit: MotionFit
    load_source: MotorSource
    motors_told: bool = False
    exponent: float = USUAL_EXPONENT

    @property
    def loads(self) -> tuple[Loads, ...]:
        """Return loads that stand for those recorded: quantiles; none where there is no motor field."""
        if self.load_source == "none":
            return ({},)
        held, own = self.recorded.in_force, self.sections.loads + self.sections.loads_mean
        every = {held.goes_with: self._recorded(held), self.goes_with: own}
        at = {s: np.percentile(load, [10.0, 30.0, 50.0, 70.0, 90.0], axis=0) for s, load in every.items()}
        return tuple({source: at[source][k] for source in at} for k in range(5))

    @property
    def goes_with(self) -> tuple[MotorSource, float]:
        """Return the load of the fit as `FieldCorrection.goes_with` does."""
        return self.load_source, self.exponent

    def mean_loads(self, correction: FieldCorrection) -> FloatArray:
        """Return the means of the loads that a correction goes with, (L,); zeros where not recorded."""
        if correction.goes_with == self.goes_with:
            return np.array(self.sections.loads_mean)
        return self._recorded(correction).mean(axis=0)

    def _recorded(self, correction: FieldCorrection) -> FloatArray:
        """Return the loads that a correction goes with, (N, L); zeros where not recorded."""
        time = self.recorded.track.compasses[self.recorded.instance].time_s
        load = self.recorded.track.load_of(correction, time)
        return np.zeros((1, len(correction.motors))) if load is None else load.reshape(time.size, -1)

    @property
    def load_doubt_rad(self) -> float:
        """Return what is not known of the motors' field, as a heading at the loads recorded, rms, radians."""
        if not self.motors_told:
            return 0.0
        around = self.sections.loads - self.sections.loads.mean(axis=0)
        variance = float(motors_variance(around, self.fit)[:, :2].mean())
        return math.sqrt(variance) / abs(self.fit.horizontal_mgauss)

    def halves(self) -> tuple[Sections, Sections] | None:
        """Return both halves of the motion; None where one of them does not turn far enough by itself."""
        middle = len(self.sections) // 2
        first, second = map(self.sections.chosen, np.split(np.arange(len(self.sections)), [middle]))
        for half in (first, second):
            if len(half) < _FEWEST_OF_HALF or circle_covered_rad(half.turned_rad) < LEAST_CIRCLE_RAD:
                return None
        return first, second

    def halves_ratio(self) -> float:
        """Return by how much more two halves of the motion differ, calibrated by themselves, than they claim.

        In sigmas of the heading, rms over the sections; 0 where a half does not turn far enough.
        """
        headings, variance = [], 0.0
        for half in self.halves() or ():
            fit = fit_motion(self.recorded, half, self.load_source)
            shift = np.subtract(half.loads_mean, self.sections.loads_mean)
            headings.append(level_headings(self.sections, fit, shift))
            variance += sigma_of(fit) ** 2
        if not headings:
            return 0.0
        apart = wrap_pi(headings[0] - headings[1])
        return float(np.std(wrap_pi(apart - np.angle(np.exp(1j * apart).mean())))) / math.sqrt(variance)

    def on(self, sections: Sections) -> Motion:
        """Fit some of the sections anew. Raises PoorCalibration where these are too few."""
        return replace(self, sections=sections, fit=fit_motion(self.recorded, sections, self.load_source))


def observe_motion(recorded: Recorded) -> Motion:
    """Cut a recording's motion into sections and fit them.

    Where stretches were chosen, what lies before the first and after the last does not count.
    Raises PoorCalibration where the recording has neither gyro nor reference, or turned too little.
    """
    track, instance = recorded.track.centred(recorded.instance), recorded.instance
    recorded = replace(recorded, track=track)
    reference = reference_turn(track)
    record = reference.record if reference is not None else turn_record(track, instance)
    if record is None:
        raise PoorCalibration(
            "World-field calibration needs an attitude that does not come from the compass, "
            "and the recording has no gyro either.",
            "Record a gyro, GPS yaw or an external reference.",
        )
    tilt_bias = 0.0 if reference else accelerometer_of(track, find_dwells(track, instance, record))
    time = track.compasses[instance].time_s
    left_out = np.zeros(time.size, dtype=bool)
    if recorded.windows:
        left_out = (time < recorded.windows[0][0]) | (time > recorded.windows[-1][1])
        if not reference and not left_out.all():
            tilt_bias = math.hypot(tilt_bias, _pulled_rad(record.rate_at(time[~left_out])))

    def cut(raw_mgauss: FloatArray, load: FloatArray | None = None) -> Sections:
        raw_mgauss[left_out] = np.nan
        sections = cut_sections(track, instance, record, raw_mgauss, load, reference)
        return replace(sections, tilt_bias_rad=tilt_bias)

    sections = cut(track.raw_field(instance, motors=False))
    if len(sections) and float(np.ptp(sections.turned_rad)) < _LEAST_TURN_RAD:
        raise PoorCalibration(
            f"The vehicle turned only {math.degrees(float(np.ptp(sections.turned_rad))):.0f} degrees.",
            "Turn it through a full circle.",
        )
    motion = None
    load, source = _motor_load(track, instance)
    if load is not None:
        loaded = cut(track.raw_field(instance), load)
        fit = fit_motion(recorded, loaded, source)
        if _motors_show(loaded, fit):
            told = _motors_told(loaded, fit, math.radians(recorded.limits.heading_deg))
            motion = Motion(recorded, record, reference, loaded, fit, source, told)
    if motion is None:
        fit = fit_motion(recorded, sections, "none")
        motion = Motion(recorded, record, reference, sections, fit, "none")
    return _by_motor(motion, cut) or motion


def _by_motor(common: Motion, cut: Callable[[FloatArray, FloatArray], Sections]) -> Motion | None:
    """Fit a field for each motor; None where these are not told apart, or one for all explains as much.

    Both are fits of the same sections, and are compared by their evidence. ArduPilot corrects compass 1 so.
    """
    recorded, track, instance = common.recorded, common.recorded.track, common.recorded.instance
    time, limit_rad = track.compasses[instance].time_s, math.radians(recorded.limits.heading_deg)
    if instance != 1 or track.autopilot != "ardupilot":
        return None
    product = track.motor_load(time, "outputs", 1.0)
    if product is None or not np.isfinite(product).all():
        return None
    powers = [product**exponent for exponent in _EXPONENTS]
    apart = powers[0] - powers[0].mean(axis=1, keepdims=True)
    if float(apart.std(axis=0).max()) < _APART * float(powers[0].mean()):
        return None
    load = track.motor_load(time, common.load_source)
    every = np.column_stack([*powers, np.zeros(time.size) if load is None else load])
    whole, found = cut(track.raw_field(instance), every), []
    for k, exponent in enumerate(_EXPONENTS):
        sections = whole.of_loads(slice(4 * k, 4 * k + 4))
        fit = fit_motion(recorded, sections, "outputs")
        if not _motors_show(sections, fit, _DIFFERENCES):
            break
        told = _motors_told(sections, fit, limit_rad)
        each = Motion(recorded, common.record, common.reference, sections, fit, "outputs", told, exponent)
        found.append((_evidence(each), each))
    if not found:
        return None
    one = cut(track.raw_field(instance, motors=load is not None), every).of_loads(slice(-1, None))
    alike = replace(common, sections=one, fit=fit_motion(recorded, one, common.load_source))
    evidence, best = max(found, key=lambda pair: pair[0])
    return best if best.motors_told and evidence > _evidence(alike) else None


def _evidence(motion: Motion) -> float:
    """Return a fit's log evidence with the prior of its loads, of which others may have more or fewer."""
    sigma = motor_sigma_of(motion.sections, motion.load_source)
    return motion.fit.log_evidence - motion.fit.motor.size * math.log(sigma)


def _pulled_rad(rate_radps: FloatArray) -> float:
    """Return what a turn at these rates, (N,), adds to roll and pitch all along, 1 sigma of each."""
    centripetal_mps2 = _FROM_CENTRE_M * float((rate_radps**2).mean())
    return _TAKEN_FOR_A_LEAN * centripetal_mps2 / STANDARD_GRAVITY_MPS2


def motion_or_none(recorded: Recorded) -> Motion | None:
    """Return a recording's motion; None where it has neither gyro nor reference, or turned too little."""
    try:
        return observe_motion(recorded)
    except PoorCalibration:
        return None


def _motors_show(sections: Sections, fit: MotionFit, rows: FloatArray | None = None) -> bool:
    """Tell whether the load goes with a field, or with what `rows` take of it, that chance makes no larger.

    What drives harder leans and pushes as its load goes: sections as short as the level errs the same way for
    are not so many witnesses.
    """
    field, covariance = fit.state[fit.motor], fit.covariance[np.ix_(fit.motor, fit.motor)]
    if rows is not None:
        field, covariance = rows @ field, rows @ covariance @ rows.T
    alike = max(LASTS_S / float(np.mean(sections.end_s - sections.start_s) + 1e-9), 1.0)
    return float(field @ np.linalg.solve(covariance, field)) > _MOTOR_CHI_SQUARE[field.size] * alike


def _motors_told(sections: Sections, fit: MotionFit, limit_rad: float) -> bool:
    """Tell whether the load varied enough to tell the motors' field from the iron.

    It did where the heading without load, at the end of the line that the variation drew, is known within
    the limit; and so is what each of several loads has its part in.
    """
    mean = np.array(sections.loads_mean)
    apart = np.concatenate([mean[np.newaxis], np.diag(mean)])
    sigma = np.sqrt(motors_variance(apart, fit)[:, :2].mean(axis=1))
    return float(sigma.max()) < limit_rad * fit.horizontal_mgauss


def _motor_load(track: Track, instance: int) -> tuple[FloatArray | None, MotorSource]:
    """Choose the motor load, (N,), that varies enough to be fitted: the current, else the throttle.

    Neither where each motor has its own term in force: that stays unless motors are told apart anew.
    """
    held = track.compasses[instance].correction_at(math.inf)
    if held.motor_source == "outputs" and any(held.motor_mgauss):
        return None, "none"
    time = track.compasses[instance].time_s
    for source, least in _LOAD_SPREAD:
        load = track.motor_load(time, source)
        if load is not None and np.isfinite(load).all() and float(load.std()) > least:
            return load, source
    return None, "none"
