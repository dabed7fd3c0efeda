"""The level methods on a recording: min-max, sensitivity-and-bias, the textbook's four positions."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np

from mavcompass.calibration.methods.comparison import UNCERTAIN, compared, with_motor
from mavcompass.calibration.methods.judged import calibrate_positions, in_force_of
from mavcompass.calibration.methods.textbook import (
    FourReadings,
    four_positions_textbook,
    min_max,
    sensitivity_bias,
)
from mavcompass.calibration.observation import FourPositionData, observe, uncorrected_field
from mavcompass.calibration.positions import IronPrior
from mavcompass.calibration.result import CalibrationResult, Position, heading_change_rad
from mavcompass.calibration.verdict import largest_gap_rad
from mavcompass.correction import FieldCorrection
from mavcompass.earth_field import EarthField
from mavcompass.errors import PoorCalibration
from mavcompass.frames import FloatArray
from mavcompass.heading.compute import level_heading
from mavcompass.track import Track
from mavcompass.units import DEG_PER_RAD

_WIDEST_GAP_RAD = math.radians(60.0)
_RIGHT_ANGLE_SLACK_RAD = math.radians(30.0)


def level_method(
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
        "Turning on the level cannot show the Z offset: it was left as it is in force.",
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
    correction = with_motor(correction, in_force)
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
    return _against_best(compared(result), data, in_force, earth, prior)


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
        reasons=(*result.reasons, *(r for r in best.reasons if not r.startswith(UNCERTAIN))),
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
