"""World-field calibration of a recording: any motion, by an attitude reference or by the gyro."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np

from mavcompass.calibration.findings import findings
from mavcompass.calibration.model import (
    ACCELEROMETER,
    CALIBRATED,
    GAIN,
    HORIZONTAL,
    OFFSET,
    VERTICAL,
    gain_matrix,
    gain_parameters,
)
from mavcompass.calibration.motion.honesty import scatter_left_rad, weigh_honestly
from mavcompass.calibration.motion.left_out import without_disturbed_stop
from mavcompass.calibration.motion.observed import Motion, observe_motion
from mavcompass.calibration.positions.four_positions import hardly_known, unobserved
from mavcompass.calibration.recorded import Recorded
from mavcompass.calibration.result import CalibrationResult
from mavcompass.correction import FieldCorrection
from mavcompass.earth_field import EarthField
from mavcompass.frames import FloatArray

# Two halves of a recording may contradict each other by so many sigmas.
_BY_CHANCE = 2.0
# Values in force that lie farther off than this, each, in squared sigmas, contradict the motion.
_HELD_CHI_SQUARE = 2.0


def calibrate(recorded: Recorded) -> CalibrationResult:
    """Calibrate all axes against the Earth's field, turned into the body by the gyro or a reference.

    Raises PoorCalibration where the recording has neither, or turned too little.
    """
    return calibrate_motion(observe_motion(recorded))


def calibrate_motion(motion: Motion) -> CalibrationResult:
    """Turn the fit of a motion into a judged result."""
    recorded = motion.recorded
    disturbed = without_disturbed_stop(motion)
    if disturbed is not None:
        motion = disturbed.motion
    honest = weigh_honestly(motion.sections, motion.fit, recorded.prior)
    held = held_in_force(honest.state, motion.fit.covariance[:9, :9], recorded.in_force, recorded.earth)
    honest = replace(honest, state=held)
    correction = correction_of(motion, honest.state)
    honest = honest.at_least(scatter_left_rad(motion, correction))
    honest = honest.at_least(math.hypot(honest.error.rms_rad(), motion.load_doubt_rad))
    ratio = motion.halves_ratio()
    if ratio > _BY_CHANCE:
        honest = honest.at_least(ratio * honest.noise_rad)
    if disturbed is not None:
        honest = honest.at_least(disturbed.open_rad)
    mounting = _mounting_rad(motion)
    hidden = unobserved(motion.fit.covariance, recorded.prior)
    sigma = honest.error.rms_rad()
    reasons, warnings = findings(motion, honest)
    if disturbed is not None:
        sentence, refused = disturbed.said(recorded.limits.heading_deg)
        reasons, warnings = ((*reasons, sentence), warnings) if refused else (reasons, (sentence, *warnings))
    if motion.reference is None:
        unknown = "No yaw reference was recorded; the gyro's turned angle was used with an unknown start."
        warnings = (unknown, *warnings)
    result = CalibrationResult(
        instance=recorded.instance,
        method="world-field",
        accepted=False,
        reasons=reasons,
        warnings=warnings,
        correction=correction,
        in_force=recorded.in_force,
        covariance_names=CALIBRATED,
        covariance=honest.error.covariance,
        not_observable=tuple(q for q in hidden if motion.reference is None or q != "mounting_yaw"),
        residual_rms_mgauss=math.sqrt(float((motion.fit.residual_mgauss**2).mean())),
        heading_sigma_deg=math.degrees(math.hypot(sigma, mounting)),
        heading_budget_deg={
            "noise": math.degrees(min(honest.noise_rad, sigma)),
            ACCELEROMETER: math.degrees(min(honest.accelerometer_rad, sigma)),
            "disturbance": math.degrees(
                math.sqrt(max(sigma**2 - honest.noise_rad**2 - honest.accelerometer_rad**2, 0.0))
            ),
            "mounting": math.degrees(mounting),
        },
        heading_error=honest.error,
        loads=motion.loads,
        horizontal_mgauss=float(honest.state[HORIZONTAL]),
        vertical_mgauss=float(honest.state[VERTICAL]),
    )
    return result.compared().within(recorded.limits)


def held_in_force(
    state: FloatArray, covariance: FloatArray, in_force: FieldCorrection, earth: EarthField | None
) -> FloatArray:
    """Return the state at which what the motion hardly shows is as in force, unless that contradicts it.

    What is said of it would be the prior's opinion: a calibration knows better. Its sigma stays the fit's.
    Offsets that are all zero are no calibration, and the world model knows better than these.
    """
    if earth is not None and not any(in_force.offsets_mgauss):
        return state
    gains = gain_parameters(in_force.inverse)
    if earth is None:
        gains = gains * state[GAIN][:2].sum() / gains[:2].sum()
    known = np.concatenate([-np.asarray(in_force.offsets_mgauss), gains])
    away = known - state[:9]
    hidden = hardly_known(covariance)
    while hidden.size:
        inside = covariance[np.ix_(hidden, hidden)]
        pull = np.linalg.lstsq(inside, away[hidden], rcond=1e-9)[0]
        if float(away[hidden] @ pull) <= _HELD_CHI_SQUARE * hidden.size:
            held = state.copy()
            held[:9] += covariance[:, hidden] @ pull
            return held
        hidden = np.delete(hidden, int(np.argmax(away[hidden] ** 2 / np.diag(inside))))
    return state


def _mounting_rad(motion: Motion) -> float:
    """Return the mean heading error that a symmetric gain leaves: a compass turned about the vertical."""
    earth = motion.recorded.earth
    if motion.reference is None or earth is None:
        return 0.0
    away = motion.fit.headings_rad - (motion.sections.turned_rad - earth.declination_rad)
    return abs(float(np.angle(np.exp(1j * away).mean())))


def correction_of(motion: Motion, state: FloatArray) -> FieldCorrection:
    """Turn a fitted state into a correction; without the world model its horizontal diagonals average 1.

    The state's offset is that at the mean load, the correction's that without load.
    """
    matrix = np.linalg.inv(gain_matrix(state[GAIN]))
    if motion.recorded.earth is None:
        matrix = matrix * 2.0 / (matrix[0, 0] + matrix[1, 1])
    held = motion.recorded.in_force
    plain = FieldCorrection.from_matrix(-state[OFFSET], 0.5 * (matrix + matrix.T)).with_motor_of(held)
    if motion.load_source == "none":
        return plain
    # Where the motors are not told from the iron, that in force stays: the iron is that at the mean load.
    if motion.motors_told:
        told = replace(held, motor_source=motion.load_source, motor_exponent=motion.exponent)
        plain = plain.with_motors(-state[motion.fit.motor].reshape(-1, 3) @ matrix.T, told)
    at_mean = motion.mean_loads(plain) @ plain.motors
    x, y, z = (-state[OFFSET] - np.linalg.solve(matrix, at_mean)).tolist()
    return replace(plain, offsets_mgauss=(x, y, z))
