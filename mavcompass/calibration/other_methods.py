"""The other methods on a recording: each brought into the same result, each judged in degrees."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np

from mavcompass.calibration.calibrate import calibrate_positions, in_force_of
from mavcompass.calibration.ellipsoid import LengthFit, fit_ellipsoid, fit_sphere
from mavcompass.calibration.model import (
    GAIN,
    HORIZONTAL,
    OFFSET,
    VERTICAL,
    HeadingError,
    gain_jacobian,
    gain_parameters,
    level_to_body,
)
from mavcompass.calibration.observation import FourPositionData, field_lag_s, uncorrected_field
from mavcompass.calibration.position_problem import IronPrior
from mavcompass.calibration.result import CalibrationResult, Position, heading_change_rad
from mavcompass.calibration.stillness import observe
from mavcompass.calibration.textbook import (
    FourReadings,
    four_positions_textbook,
    min_max,
    sensitivity_bias,
)
from mavcompass.calibration.turning import turn_record
from mavcompass.calibration.verdict import Limits, largest_gap_rad
from mavcompass.calibration.world_field import WorldFieldFit, fit_with_gyro_yaw, fit_world_field
from mavcompass.correction import FieldCorrection, MotorSource
from mavcompass.earth_field import EarthField
from mavcompass.errors import PoorCalibration
from mavcompass.frames import FloatArray, quaternion_to_matrix, rotate_back, wrap_pi
from mavcompass.heading.compute import level_heading
from mavcompass.heading.gravity import down_in_body
from mavcompass.track import Track
from mavcompass.units import DEG_PER_RAD

_WIDEST_GAP_RAD = math.radians(60.0)
_RIGHT_ANGLE_SLACK_RAD = math.radians(30.0)
_LEAST_COVERAGE = 0.3
_UNCERTAIN = "The heading would be uncertain"
# A battery current that varies less than this shows no motor field.
_LOAD_SPREAD_A = 2.0


def calibrate_otherwise(
    track: Track,
    method: str,
    instance: int,
    limits: Limits,
    earth: EarthField | None,
    prior: IronPrior,
) -> CalibrationResult:
    """Calibrate one compass by a method other than the best; see `calibrate.calibrate_track`."""
    if method in ("min-max", "sensitivity-bias", "four-positions-textbook"):
        result = _level_method(track, method, instance, earth, prior)
    elif method in ("sphere", "ellipsoid"):
        result = _length_method(track, method, instance, earth)
    else:
        result = _world_field(track, instance, earth, prior)
    return _judged(result, limits)


def _judged(result: CalibrationResult, limits: Limits) -> CalibrationResult:
    """Refuse by the predicted heading error, beside the method's own reasons."""
    reasons = list(result.reasons)
    if not result.heading_sigma_deg <= limits.heading_deg:
        reasons.append(
            f"{_UNCERTAIN} by {result.heading_sigma_deg:.1f} degrees (limit {limits.heading_deg:g})."
        )
    return replace(result, reasons=tuple(reasons), accepted=not reasons)


# ---- level turns ----


def _level_method(
    track: Track, method: str, instance: int, earth: EarthField | None, prior: IronPrior
) -> CalibrationResult:
    raw = uncorrected_field(track, instance)
    raw = raw[np.isfinite(raw).all(axis=1)]
    in_force = in_force_of(track, instance)
    z_offset, z_diagonal = in_force.offsets_mgauss[2], float(in_force.matrix[2, 2])
    try:
        data: FourPositionData | None = observe(track, instance)
    except PoorCalibration:
        data = None
    positions: tuple[Position, ...] = ()
    warnings: tuple[str, ...] = (
        "Turning on the level does not show the Z offset: it was left as it is in force.",
    )
    if method == "four-positions-textbook":
        chosen = _right_angles(data)
        means = np.array([chosen.dwells[i].mean_mgauss for i in range(4)])
        compensation, axes = four_positions_textbook(means)
        correction = compensation.correction(z_offset, z_diagonal)
        positions = _positions(chosen)
        warnings = (*warnings, _left_over(axes))
    else:
        _full_turn(raw)
        if method == "min-max":
            correction = min_max(raw).correction(z_offset, z_diagonal)
        else:
            (x_min, y_min), (x_max, y_max) = raw[:, :2].min(axis=0), raw[:, :2].max(axis=0)
            correction = sensitivity_bias(x_min, x_max, y_min, y_max).correction(z_offset, z_diagonal)
    correction = _with_motor(correction, in_force)
    field = correction.apply(raw)
    length = np.hypot(field[:, 0], field[:, 1])
    horizontal, vertical = float(np.median(length)), float(np.median(field[:, 2]))
    result = CalibrationResult(
        instance=instance,
        method=method,
        accepted=False,
        reasons=(),
        warnings=warnings,
        raw_offset_mgauss=-np.asarray(correction.offsets_mgauss),
        correction=correction,
        in_force=in_force,
        not_observable=("offset_z", "scale_z", "cross_xy", "cross_xz", "cross_yz", "mounting_yaw"),
        residual_rms_mgauss=float(length.std()),
        heading_sigma_deg=math.degrees(float(length.std()) / max(horizontal, 1e-9)),
        horizontal_mgauss=horizontal,
        vertical_mgauss=vertical,
        positions=positions,
    )
    return _against_best(_compared(result), data, in_force, earth, prior)


def _against_best(
    result: CalibrationResult,
    data: FourPositionData | None,
    in_force: FieldCorrection,
    earth: EarthField | None,
    prior: IronPrior,
) -> CalibrationResult:
    """Predict the error of a method without a covariance: its distance from the best fit of the same data."""
    if data is None:
        return result
    try:
        best = calibrate_positions(data, in_force, earth, result.instance, prior=prior)
    except PoorCalibration:
        return result
    apart = heading_change_rad(
        result.correction, best.correction, best.horizontal_mgauss, best.vertical_mgauss
    )
    bias = math.sqrt(float((apart**2).mean())) * DEG_PER_RAD
    return replace(
        result,
        heading_sigma_deg=math.hypot(bias, best.heading_sigma_deg),
        heading_budget_deg={"method": bias, "noise": best.heading_sigma_deg},
        reasons=(*result.reasons, *(r for r in best.reasons if not r.startswith(_UNCERTAIN))),
    )


def _full_turn(raw: FloatArray) -> None:
    """Refuse a turn that leaves out part of the circle: its extremes are not those of the field."""
    low, high = np.percentile(raw[:, :2], [0.5, 99.5], axis=0)
    span = np.maximum(high - low, 1e-9)
    angles = level_heading((raw[:, :2] - 0.5 * (low + high)) / span)
    gap = largest_gap_rad(angles)
    if gap > _WIDEST_GAP_RAD:
        raise PoorCalibration(
            f"The vehicle did not turn all the way round: {math.degrees(gap):.0f} degrees are missing.",
            "Turn it through a full circle on the level.",
        )


def _right_angles(data: FourPositionData | None) -> FourPositionData:
    """Choose the first four positions whose steps are about 90 degrees, all in one direction."""
    if data is not None:
        for first in range(len(data.dwells) - 3):
            steps = data.steps[first : first + 3]
            sense = math.copysign(math.pi / 2.0, steps[0].angle_rad)
            if all(abs(s.angle_rad - sense) < _RIGHT_ANGLE_SLACK_RAD for s in steps):
                return replace(data, dwells=data.dwells[first : first + 4], steps=steps)
    raise PoorCalibration(
        "The recording has no four positions with steps of about 90 degrees between them.",
        "Turn the vehicle in four steps of 90 degrees and stop after each.",
    )


def _left_over(axes: tuple[FourReadings, FourReadings]) -> str:
    x, y = axes
    return (
        f"The two left-over equations give {x.left_over:+.1f} mG on X and {y.left_over:+.1f} mG on Y; "
        "exact steps and an undisturbed field would give 0."
    )


def _positions(data: FourPositionData) -> tuple[Position, ...]:
    return tuple(
        Position(float(turned) * DEG_PER_RAD, dwell.mean_mgauss, dwell.samples)
        for turned, dwell in zip(data.turned_rad, data.dwells, strict=True)
    )


def _with_motor(correction: FieldCorrection, in_force: FieldCorrection) -> FieldCorrection:
    """Carry the motor term in force into another matrix."""
    x, y, z = (
        correction.matrix @ np.linalg.solve(in_force.matrix, np.asarray(in_force.motor_mgauss))
    ).tolist()
    return replace(correction, motor_mgauss=(x, y, z), motor_source=in_force.motor_source)


def _compared(result: CalibrationResult) -> CalibrationResult:
    """Add what changes in the heading from the correction in force."""
    change = heading_change_rad(
        result.in_force, result.correction, result.horizontal_mgauss, result.vertical_mgauss
    )
    return replace(
        result,
        heading_change_deg=math.sqrt(float((change**2).mean())) * DEG_PER_RAD,
        heading_change_max_deg=float(np.abs(change).max()) * DEG_PER_RAD,
    )


# ---- all-round turns ----


def _length_method(track: Track, method: str, instance: int, earth: EarthField | None) -> CalibrationResult:
    raw = uncorrected_field(track, instance)
    usable = np.isfinite(raw).all(axis=1)
    raw, time = raw[usable], track.compasses[instance].time_s[usable]
    total = earth.total_mgauss if earth is not None else None
    fit = fit_sphere(raw) if method == "sphere" else fit_ellipsoid(raw, total)
    in_force = in_force_of(track, instance)
    correction = _with_motor(FieldCorrection.from_matrix(-fit.centre_mgauss, fit.matrix), in_force)
    horizontal, vertical = _split(fit.length_mgauss, correction.apply(raw), down_in_body(track, time), earth)
    names, covariance = _raw_form(fit)
    state = np.zeros(11)
    state[OFFSET], state[GAIN] = fit.centre_mgauss, gain_parameters(np.linalg.inv(fit.matrix))
    state[HORIZONTAL], state[VERTICAL] = horizontal, vertical
    error = HeadingError(state, covariance)
    # The length says nothing of what it leaves over; on the horizontal it turns the heading.
    sigma = math.hypot(error.rms_rad(), fit.residual_relative * fit.length_mgauss / horizontal)
    reasons = []
    if fit.coverage < _LEAST_COVERAGE:
        reasons.append(
            f"The compass pointed to only {100.0 * fit.coverage:.0f} % of all directions. Turn it every way, "
            "or use the four-position method."
        )
    return _compared(
        CalibrationResult(
            instance=instance,
            method=method,
            accepted=False,
            reasons=tuple(reasons),
            raw_offset_mgauss=fit.centre_mgauss,
            correction=correction,
            in_force=in_force,
            covariance_names=names,
            covariance=covariance,
            not_observable=("mounting_yaw",),
            residual_rms_mgauss=fit.residual_rms_mgauss,
            heading_sigma_deg=math.degrees(sigma),
            heading_budget_deg={
                "noise": math.degrees(error.rms_rad()),
                "disturbance": math.degrees(fit.residual_relative * fit.length_mgauss / horizontal),
            },
            heading_error=error,
            horizontal_mgauss=horizontal,
            vertical_mgauss=vertical,
        )
    )


def _split(
    length: float, field: FloatArray, down: FloatArray, earth: EarthField | None
) -> tuple[float, float]:
    """Split the field's length into horizontal and vertical: by the world model, or by gravity."""
    if earth is not None:
        factor = length / earth.total_mgauss
        return factor * earth.horizontal_mgauss, factor * earth.ned_mgauss[2]
    vertical = float(np.median((field * down).sum(axis=1)))
    return math.sqrt(max(length**2 - vertical**2, (0.05 * length) ** 2)), vertical


def _raw_form(fit: LengthFit) -> tuple[tuple[str, ...], FloatArray]:
    """Bring the covariance of c and M into that of offsets and gains T = M^-1: dT = -T dM T."""
    names = (*(f"offset_{a}" for a in "xyz"), *(f"gain_{p}" for p in ("xx", "yy", "zz", "xy", "xz", "yz")))
    covariance = np.zeros((9, 9))
    if fit.covariance.shape[0] < 9:
        covariance[:3, :3] = fit.covariance
        return names, covariance
    gain = np.linalg.inv(fit.matrix)
    basis = gain_jacobian(np.eye(3)).transpose(2, 1, 0)  # the six symmetric unit matrices
    by_matrix = np.stack([gain_parameters(-gain @ unit @ gain) for unit in basis], axis=1)
    change = np.zeros((9, 9))
    change[:3, :3], change[3:, 3:] = np.eye(3), by_matrix
    return names, change @ fit.covariance @ change.T


# ---- against the world's field ----


def _world_field(
    track: Track, instance: int, earth: EarthField | None, prior: IronPrior
) -> CalibrationResult:
    time = track.compasses[instance].time_s
    raw = track.raw_field(instance)
    load, source = _load(track, time)
    attitude = _reference(track, time, earth)
    if attitude is not None:
        expected = _expected(raw, attitude, earth)
        fit = fit_world_field(raw, expected, load, prior=prior)
        horizontal, vertical = _horizontal_of(expected, attitude)
        warnings: tuple[str, ...] = ()
        misalignment = _first_heading_offset(raw, fit, attitude, earth)
    else:
        fit, horizontal, vertical = _by_gyro(track, instance, raw, time, load, earth, prior)
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
    return _compared(
        CalibrationResult(
            instance=instance,
            method="world-field",
            accepted=False,
            reasons=(),
            warnings=warnings,
            raw_offset_mgauss=fit.offset_mgauss,
            correction=correction,
            in_force=in_force_of(track, instance),
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
    roll = np.arctan2(down[:, 1], down[:, 2])
    pitch = np.arctan2(-down[:, 0], np.hypot(down[:, 1], down[:, 2]))
    psi = np.interp(time, yaw.time_s[known], smooth)
    level = level_to_body(roll, pitch)
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
    track: Track,
    instance: int,
    raw: FloatArray,
    time: FloatArray,
    load: FloatArray | None,
    earth: EarthField | None,
    prior: IronPrior,
) -> tuple[WorldFieldFit, float, float]:
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
        field = in_force_of(track, instance).apply(raw)
        swing = np.percentile(field[:, :2], 97, axis=0) - np.percentile(field[:, :2], 3, axis=0)
        horizontal, vertical = 0.5 * float(swing.mean()), float(np.median(field[:, 2]))
    down = down_in_body(track, time)
    roll = np.arctan2(down[:, 1], down[:, 2])
    pitch = np.arctan2(-down[:, 0], np.hypot(down[:, 1], down[:, 2]))
    answer = fit_with_gyro_yaw(
        raw, time, level_to_body(roll, pitch), turned, horizontal, vertical, load, prior
    )
    return answer.fit, horizontal, vertical
