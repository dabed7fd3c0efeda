"""World-field calibration of a recording: by an attitude reference, or by the gyro."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np

from mavcompass.calibration.comparison import compared, judged
from mavcompass.calibration.fits.world_field import WorldFieldFit, fit_with_gyro_yaw, fit_world_field
from mavcompass.calibration.model import (
    GAIN,
    HORIZONTAL,
    OFFSET,
    VERTICAL,
    HeadingError,
    gain_parameters,
    level_to_body,
)
from mavcompass.calibration.observation import field_lag_s, turn_record
from mavcompass.calibration.recorded import Recorded
from mavcompass.calibration.result import CalibrationResult
from mavcompass.correction import FieldCorrection, MotorSource
from mavcompass.earth_field import EarthField
from mavcompass.errors import PoorCalibration
from mavcompass.frames import FloatArray, quaternion_to_matrix, rotate_back, tilt_from_acceleration, wrap_pi
from mavcompass.heading.gravity import down_in_body
from mavcompass.track import Track

# A battery current that varies less than this shows no motor field.
_LOAD_SPREAD_A = 2.0


def calibrate(recorded: Recorded) -> CalibrationResult:
    """Calibrate all axes against the Earth's field, turned into the body by an attitude or by the gyro.

    Raises PoorCalibration where the recording has neither, or turned too little.
    """
    track, instance, earth = recorded.track, recorded.instance, recorded.earth
    time = track.compasses[instance].time_s
    raw = track.raw_field(instance)
    load, source = _load(track, time)
    attitude = _reference(track, time, earth)
    if attitude is not None:
        expected = _expected(raw, attitude, earth)
        fit = fit_world_field(raw, expected, load, prior=recorded.prior)
        horizontal, vertical = _horizontal_of(expected, attitude)
        warnings: tuple[str, ...] = ()
        misalignment = _first_heading_offset(raw, fit, attitude, earth)
    else:
        fit, horizontal, vertical = _by_gyro(recorded, raw, time, load)
        warnings = ("No yaw reference was recorded; the gyro's turned angle was used with an unknown start.",)
        misalignment = 0.0
    matrix = np.linalg.inv(fit.gain)
    correction = FieldCorrection.from_matrix(-fit.offset_mgauss, 0.5 * (matrix + matrix.T))
    if load is not None:
        x, y, z = (-matrix @ fit.motor_mgauss).tolist()
        correction = replace(correction, motor_mgauss=(x, y, z), motor_source=source)
    state = np.zeros(11)
    state[OFFSET], state[GAIN] = fit.offset_mgauss, gain_parameters(fit.gain)
    state[HORIZONTAL], state[VERTICAL] = horizontal, vertical
    error = HeadingError(state, fit.covariance[:9, :9])
    result = compared(
        CalibrationResult(
            instance=instance,
            method="world-field",
            accepted=False,
            reasons=(),
            warnings=warnings,
            raw_offset_mgauss=fit.offset_mgauss,
            correction=correction,
            in_force=recorded.in_force,
            covariance_names=fit.names,
            covariance=fit.covariance,
            not_observable=() if attitude is not None else ("mounting_yaw",),
            residual_rms_mgauss=fit.residual_rms_mgauss,
            heading_sigma_deg=math.degrees(math.hypot(error.rms_rad(), misalignment)),
            heading_budget_deg={
                "noise": math.degrees(error.rms_rad()),
                "mounting": math.degrees(misalignment),
            },
            heading_error=error,
            horizontal_mgauss=horizontal,
            vertical_mgauss=vertical,
        )
    )
    return judged(result, recorded.limits)


def _load(track: Track, time: FloatArray) -> tuple[FloatArray | None, MotorSource]:
    """Choose the motor load that varies enough to fit: the current, else the throttle."""
    candidates: tuple[tuple[MotorSource, float], ...] = (("current", _LOAD_SPREAD_A), ("throttle", 0.1))
    for source, least in candidates:
        load = track.motor_load(time, source)
        if load is not None and np.isfinite(load).all() and float(load.std()) > least:
            return load, source
    return None, "none"


def _reference(track: Track, time: FloatArray, earth: EarthField | None) -> FloatArray | None:
    """Return body-to-NED matrices (N, 3, 3) by a reference that owes nothing to a compass, or None."""
    if track.reference_q is not None and len(track.reference_q):
        q = track.reference_q.at(time)
        return quaternion_to_matrix(q / np.linalg.norm(q, axis=1, keepdims=True))
    yaw = track.gps_yaw_rad
    if yaw is None or len(yaw) < 10 or earth is None:
        return None
    known = np.isfinite(yaw.values)
    smooth = np.unwrap(yaw.values[known])
    down = down_in_body(track, time)
    psi = np.interp(time, yaw.time_s[known], smooth)
    level = level_to_body(*tilt_from_acceleration(-down))
    cos, sin, zero = np.cos(psi), np.sin(psi), np.zeros(psi.size)
    turn = np.stack(
        [
            np.stack([cos, sin, zero], -1),
            np.stack([-sin, cos, zero], -1),
            np.stack([zero, zero, zero + 1], -1),
        ],
        axis=-2,
    )
    return np.asarray(np.swapaxes(level @ turn, 1, 2))


def _expected(raw: FloatArray, attitude: FloatArray, earth: EarthField | None) -> FloatArray:
    """Return the Earth's field in the body, (N, 3); an unknown field is fitted with the offsets."""
    if earth is not None:
        return rotate_back(attitude, np.broadcast_to(earth.vector_mgauss, raw.shape))
    # raw = b + R^T B is linear in b and B; the gain then follows from the fitted field.
    n = len(raw)
    transposed = np.swapaxes(attitude, 1, 2).reshape(3 * n, 3)
    design = np.concatenate([np.tile(np.eye(3), (n, 1)), transposed], axis=1)
    answer, *_ = np.linalg.lstsq(design, raw.reshape(-1), rcond=None)
    return rotate_back(attitude, np.broadcast_to(answer[3:], raw.shape))


def _horizontal_of(expected: FloatArray, attitude: FloatArray) -> tuple[float, float]:
    world = np.einsum("nij,nj->ni", attitude[:1], expected[:1])[0]
    return math.hypot(world[0], world[1]), float(world[2])


def _first_heading_offset(
    raw: FloatArray, fit: WorldFieldFit, attitude: FloatArray, earth: EarthField | None
) -> float:
    """Return the mean heading error that a symmetric gain leaves: a compass turned about the vertical."""
    if earth is None:
        return 0.0
    matrix = np.linalg.inv(fit.gain)
    world = np.einsum("nij,nj->ni", attitude, (raw - fit.offset_mgauss) @ matrix.T)
    angle = np.arctan2(world[:, 1], world[:, 0]) - earth.declination_rad
    return abs(float(np.angle(np.exp(1j * np.asarray(wrap_pi(angle))).mean())))


def _by_gyro(
    recorded: Recorded, raw: FloatArray, time: FloatArray, load: FloatArray | None
) -> tuple[WorldFieldFit, float, float]:
    track, instance, earth = recorded.track, recorded.instance, recorded.earth
    record = turn_record(track, instance)
    if record is None:
        raise PoorCalibration(
            "World-field calibration needs an attitude that does not come from the compass, "
            "and the recording has no gyro either.",
            "Record a gyro, GPS yaw or an external reference.",
        )
    turned = record.angle_at(time - field_lag_s(track))
    if float(np.ptp(turned)) < math.radians(200.0):
        raise PoorCalibration(
            f"The vehicle turned only {math.degrees(float(np.ptp(turned))):.0f} degrees.",
            "Turn it through a full circle.",
        )
    if earth is not None:
        horizontal, vertical = earth.horizontal_mgauss, earth.ned_mgauss[2]
    else:
        field = recorded.in_force.apply(raw)
        swing = np.percentile(field[:, :2], 97, axis=0) - np.percentile(field[:, :2], 3, axis=0)
        horizontal, vertical = 0.5 * float(swing.mean()), float(np.median(field[:, 2]))
    level = level_to_body(*tilt_from_acceleration(-down_in_body(track, time)))
    answer = fit_with_gyro_yaw(raw, time, level, turned, horizontal, vertical, load, recorded.prior)
    return answer.fit, horizontal, vertical
