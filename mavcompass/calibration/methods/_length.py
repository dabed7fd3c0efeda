"""What sphere and ellipsoid share: the fit of a length as a result."""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np

from mavcompass.attitude import down_in_body
from mavcompass.calibration.comparison import compared, within
from mavcompass.calibration.fits.length import LengthFit
from mavcompass.calibration.model import (
    GAIN,
    HORIZONTAL,
    OFFSET,
    VERTICAL,
    HeadingError,
    gain_jacobian,
    gain_parameters,
)
from mavcompass.calibration.observation import uncorrected_field
from mavcompass.calibration.recorded import Recorded
from mavcompass.calibration.result import CalibrationResult
from mavcompass.correction import FieldCorrection
from mavcompass.earth_field import EarthField
from mavcompass.frames import FloatArray

_LEAST_COVERAGE = 0.3


def length_result(
    recorded: Recorded, method: str, fit_length: Callable[[FloatArray], LengthFit]
) -> CalibrationResult:
    """Fit the readings (N, 3) of a compass turned every way and bring the fit into a judged result."""
    track, instance, earth = recorded.track, recorded.instance, recorded.earth
    raw = uncorrected_field(track, instance)
    usable = np.isfinite(raw).all(axis=1)
    raw, time = raw[usable], track.compasses[instance].time_s[usable]
    fit, in_force = fit_length(raw), recorded.in_force
    correction = FieldCorrection.from_matrix(-fit.centre_mgauss, fit.matrix).with_motor_of(in_force)
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
    result = compared(
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
    return within(result, recorded.limits)


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
