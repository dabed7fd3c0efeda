"""What the level methods share: a full turn's readings, and a compensation of two axes as a result.

[Skula] D. Skula, "New method for magnetometer offset compensation": eq. 1 to 7.
[Memsense] "nIMU - uIMU Bias and Sensitivity Corrections of Magnetometers", revision 1; its equations
are not numbered.

The two differ in sign and in which axis keeps the gain 1: [Skula] subtracts an offset and scales the
weaker axis up; [Memsense] adds a bias and lets the user choose, advising the stronger axis. Both are
kept, and both are a `LevelCompensation`. Readings may be in any unit; biases come back in the same.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import ArrayLike

from mavcompass.calibration.methods.four_positions import calibrate_positions
from mavcompass.calibration.observation import FourPositionData, observe
from mavcompass.calibration.recorded import Recorded
from mavcompass.calibration.result import UNCERTAIN, CalibrationResult, Position
from mavcompass.correction import FieldCorrection
from mavcompass.errors import PoorCalibration
from mavcompass.frames import FloatArray, circle_covered_rad
from mavcompass.heading.compute import level_heading
from mavcompass.heading.deviation import heading_change_rad
from mavcompass.units import DEG_PER_RAD

_WIDEST_GAP_RAD = math.radians(60.0)


@dataclass(frozen=True, slots=True)
class LevelCompensation:
    """Hold a compensation of two axes, gain * reading + bias; an offset H' = H gain - offset is -bias."""

    gain: tuple[float, float]
    bias: tuple[float, float]

    @classmethod
    def about(cls, centre: FloatArray, amplitude: FloatArray) -> LevelCompensation:
        """Scale the weaker axis (2,) up to the stronger: "or 1, what is bigger" ([Skula] eq. 2, 3 and 7).

        Raises PoorCalibration where an axis does not change.
        """
        require_change(amplitude)
        x, y = (max(float(amplitude[i - 1] / amplitude[i]), 1.0) for i in (0, 1))
        return cls((x, y), (-float(centre[0]) * x, -float(centre[1]) * y))

    def apply(self, readings: ArrayLike) -> FloatArray:
        """Compensate readings (..., 2 or 3), (..., 2)."""
        return np.asarray(readings, dtype=np.float64)[..., :2] * self.gain + np.array(self.bias)

    def correction(self, z_offset_mgauss: float = 0.0, z_diagonal: float = 1.0) -> FieldCorrection:
        """Express it as a field correction, M (raw + offsets) with M diagonal, offsets = bias / gain."""
        x, y = (bias / gain for bias, gain in zip(self.bias, self.gain, strict=True))
        return FieldCorrection((x, y, float(z_offset_mgauss)), (*self.gain, float(z_diagonal)))


def require_change(span: FloatArray) -> None:
    """Raise PoorCalibration for an axis of which the span, (2,), is none."""
    if not (span > 0.0).all():
        raise PoorCalibration(
            "An axis of the compass did not change at all during the turn.",
            "Turn the vehicle all the way round, and check that the compass is alive.",
        )


def readings(recorded: Recorded) -> FloatArray:
    """Return the raw readings, (N, 3)."""
    raw = recorded.track.raw_field(recorded.instance, motors=False)
    return raw[np.isfinite(raw).all(axis=1)]


def still_positions(recorded: Recorded) -> FourPositionData | None:
    """Find the recording's still positions; None where it has too few."""
    try:
        return observe(recorded.track, recorded.instance)
    except PoorCalibration:
        return None


def full_turn(recorded: Recorded) -> FloatArray:
    """Return the readings of a whole turn, (N, 3).

    Raises PoorCalibration for one that leaves out part of the circle: its extremes are not the field's.
    """
    raw = readings(recorded)
    low, high = np.percentile(raw[:, :2], [0.5, 99.5], axis=0)
    span = np.maximum(high - low, 1e-9)
    angles = level_heading((raw[:, :2] - 0.5 * (low + high)) / span)
    gap = 2.0 * math.pi - circle_covered_rad(angles)
    if gap > _WIDEST_GAP_RAD:
        raise PoorCalibration(
            f"The vehicle did not turn all the way round: {math.degrees(gap):.0f} degrees are missing.",
            "Turn it through a full circle on the level.",
        )
    return raw


def level_result(
    recorded: Recorded,
    method: str,
    compensation: LevelCompensation,
    data: FourPositionData | None,
    positions: tuple[Position, ...] = (),
    warnings: tuple[str, ...] = (),
) -> CalibrationResult:
    """Bring a compensation of X and Y into a judged result; Z stays as it is in force.

    `data` are the recording's still positions, for the error beside the best fit of them.
    """
    raw, in_force = readings(recorded), recorded.in_force
    z_offset, z_diagonal = in_force.offsets_mgauss[2], float(in_force.matrix[2, 2])
    correction = compensation.correction(z_offset, z_diagonal).with_motor_of(in_force)
    field = correction.apply(raw)
    length = np.hypot(field[:, 0], field[:, 1])
    horizontal, vertical = float(np.median(length)), float(np.median(field[:, 2]))
    result = CalibrationResult(
        instance=recorded.instance,
        method=method,
        accepted=False,
        reasons=(),
        warnings=("Turning on the level cannot show the Z offset: it was left as it is in force.", *warnings),
        correction=correction,
        in_force=in_force,
        not_observable=("offset_z", "scale_z", "cross_xy", "cross_xz", "cross_yz", "mounting_yaw"),
        residual_rms_mgauss=float(length.std()),
        heading_sigma_deg=math.degrees(float(length.std()) / max(horizontal, 1e-9)),
        horizontal_mgauss=horizontal,
        vertical_mgauss=vertical,
        positions=positions,
    )
    return _against_best(result.compared(), data, recorded).within(recorded.limits)


def _against_best(
    result: CalibrationResult,
    data: FourPositionData | None,
    recorded: Recorded,
) -> CalibrationResult:
    """Predict the error of a method without a covariance: its distance from the best fit of the same data."""
    if data is None:
        return result
    try:
        best = calibrate_positions(
            data, recorded.in_force, recorded.earth, recorded.instance, prior=recorded.prior
        )
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
