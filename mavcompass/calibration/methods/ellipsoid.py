"""An ellipsoid: the compass turned every way, gains and oblique axes; and what a sphere shares with it.

A calibrated field has one length whichever way the compass points:

    | M (r - c) | = F,    M symmetric                                                              (E1)

For the sphere M is the identity and F its radius. Both fits start from the linear (algebraic) solution
and are then refined on the length itself, which is unbiased by noise; readings far out weigh less.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from mavcompass.attitude import down_in_body
from mavcompass.calibration.model import (
    CALIBRATED,
    GAIN,
    HORIZONTAL,
    OFFSET,
    VERTICAL,
    HeadingError,
    gain_jacobian,
    gain_matrix,
    gain_parameters,
)
from mavcompass.calibration.motion.honesty import claimed
from mavcompass.calibration.motion.observed import Motion, motion_or_none
from mavcompass.calibration.recorded import Recorded
from mavcompass.calibration.result import CalibrationResult
from mavcompass.correction import FieldCorrection
from mavcompass.earth_field import EarthField
from mavcompass.errors import PoorCalibration
from mavcompass.frames import FloatArray

_ROUNDS = 30
_HUBER_SIGMAS = 3.0
# With fewer directions than this share of the sphere's bins some parameters are extrapolation.
_COVERAGE_BINS, LEAST_COVERAGE = 80, 0.3


def calibrate(recorded: Recorded) -> CalibrationResult:
    """Calibrate all axes by the length of the field; no attitude is needed."""
    return calibrate_witnessed(recorded, motion_or_none(recorded))


def calibrate_witnessed(recorded: Recorded, motion: Motion | None) -> CalibrationResult:
    """Calibrate, and claim no less than the heading scatter that is left in the motion."""
    total = recorded.earth.total_mgauss if recorded.earth is not None else None
    result = length_result(recorded, "ellipsoid", lambda raw: fit_ellipsoid(raw, total))
    return result if motion is None else claimed(motion, result)


@dataclass(frozen=True, slots=True, eq=False)
class LengthFit:
    """Hold a fit of equation E1.

    Attributes:
        centre_mgauss: c, (3,). matrix: M, (3, 3), the identity for the sphere.
        length_mgauss: F. covariance: of c and, for the ellipsoid, M's six (xx, yy, zz, xy, xz, yz).
        residual_rms_mgauss: of the length.
        coverage: the share of 80 equal patches of the sphere that hold a reading.
    """

    centre_mgauss: FloatArray
    matrix: FloatArray
    length_mgauss: float
    covariance: FloatArray
    residual_rms_mgauss: float
    coverage: float


def fit_sphere(raw_mgauss: ArrayLike) -> LengthFit:
    """Fit centre and radius to raw readings (N, 3).

    Raises PoorCalibration where the readings do not span three dimensions.
    """
    raw = _usable(raw_mgauss, 4)
    centre, radius = _algebraic_sphere(raw)
    return _refined(raw, centre, np.eye(3) / radius, None, shape=False)


def fit_ellipsoid(raw_mgauss: ArrayLike, length_mgauss: float | None = None) -> LengthFit:
    """Fit centre and symmetric matrix to raw readings (N, 3).

    The length F is `length_mgauss` where it is known (the world model's); otherwise M is scaled so that
    its diagonal averages 1.
    Raises PoorCalibration where the readings do not determine an ellipsoid.
    """
    raw = _usable(raw_mgauss, 9)
    return _refined(raw, *_algebraic_ellipsoid(raw), length_mgauss, shape=True)


def _refined(
    raw: FloatArray, centre: FloatArray, matrix: FloatArray, length_mgauss: float | None, shape: bool
) -> LengthFit:
    """Refine the solution of |M (r - c)| = 1 on the length; open is M, or else the length alone."""
    unit = float(np.trace(matrix)) / 3.0
    length = float(length_mgauss) if length_mgauss is not None else 1.0 / unit
    x = np.concatenate([centre, gain_parameters(matrix * length)])
    size = np.array([*3 * [length], *(6 * [1.0] if shape else [length])])
    covariance = np.full((size.size, size.size), np.nan)
    for _ in range(_ROUNDS):
        residual, jacobian = _length_jacobian(raw, x, length)
        if not shape:
            jacobian = np.column_stack([jacobian[:, :3], -np.ones(len(raw))])
        step, covariance = _solve(jacobian, residual, _huber(residual))
        x[:3] -= step[:3]
        if shape:
            x[3:] -= step[3:]
        else:
            length -= float(step[3])
        if np.abs(step / size).max() < 1e-10:
            break
    residual, _ = _length_jacobian(raw, x, length)
    matrix = gain_matrix(x[3:])
    if np.linalg.eigvalsh(matrix).min() <= 0.0:
        raise _flat()
    if length_mgauss is None:
        # The unknown length: let M's diagonal average 1.
        factor = 3.0 / float(np.trace(matrix))
        matrix, length, residual = matrix * factor, length * factor, residual * factor
        covariance[3:] *= factor
        covariance[:, 3:] *= factor
    return LengthFit(
        centre_mgauss=x[:3],
        matrix=matrix,
        length_mgauss=length,
        covariance=covariance if shape else covariance[:3, :3],
        residual_rms_mgauss=math.sqrt(float((residual**2).mean())),
        coverage=sphere_coverage((raw - x[:3]) @ matrix),
    )


def _usable(raw_mgauss: ArrayLike, parameters: int) -> FloatArray:
    raw = np.asarray(raw_mgauss, dtype=np.float64)
    raw = raw[np.isfinite(raw).all(axis=1)]
    if len(raw) < 3 * parameters:
        raise PoorCalibration(
            f"{len(raw)} readings are too few to fit {parameters} quantities.", "Record for longer."
        )
    return raw


def _flat() -> PoorCalibration:
    return PoorCalibration(
        "The readings lie in a plane or on a line: the compass was not turned every way.",
        "Turn the vehicle about all three axes, or use the four-position method for a level vehicle.",
    )


def _algebraic_sphere(raw: FloatArray) -> tuple[FloatArray, float]:
    """Solve |r|^2 = 2 c.r + (R^2 - c^2) by linear least squares about the mean."""
    middle = raw.mean(axis=0)
    r = raw - middle
    if np.linalg.svd(r, compute_uv=False)[-1] <= 0.02 * np.linalg.norm(r):
        raise _flat()
    design = np.column_stack([2.0 * r, np.ones(len(r))])
    answer, *_ = np.linalg.lstsq(design, (r**2).sum(axis=1), rcond=None)
    radius = math.sqrt(max(float(answer[3] + answer[:3] @ answer[:3]), 1e-12))
    return middle + answer[:3], radius


def _algebraic_ellipsoid(raw: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Solve the quadric r^T A r + b.r = 1 about the mean, scaled; returns centre and A's root for F = 1."""
    middle = raw.mean(axis=0)
    size = float(np.sqrt(((raw - middle) ** 2).sum(axis=1).mean()))
    if size <= 0.0:
        raise _flat()
    x, y, z = ((raw - middle) / size).T
    design = np.column_stack([x * x, y * y, z * z, 2 * x * y, 2 * x * z, 2 * y * z, x, y, z])
    normal = design.T @ design
    if np.linalg.cond(normal) > 1e10:
        raise _flat()
    a = np.linalg.solve(normal, design.sum(axis=0))
    shape = gain_matrix(a[:6])
    centre = -0.5 * np.linalg.solve(shape, a[6:])
    values, vectors = np.linalg.eigh(shape / (1.0 + float(centre @ shape @ centre)))
    if values.min() <= 0.0:
        raise _flat()
    root = vectors @ np.diag(np.sqrt(values)) @ vectors.T
    return middle + size * centre, root / size


def _length_jacobian(raw: FloatArray, x: FloatArray, length: float) -> tuple[FloatArray, FloatArray]:
    """Return |M (r - c)| - F, (N,), and its derivative by c and M's six, (N, 9)."""
    matrix = gain_matrix(x[3:])
    away = raw - x[:3]
    field = away @ matrix
    size = np.linalg.norm(field, axis=1)
    unit = field / size[:, np.newaxis]
    by_matrix = np.einsum("ni,nij->nj", unit, gain_jacobian(away))
    return size - length, np.concatenate([-unit @ matrix, by_matrix], axis=1)


def _huber(residual: FloatArray) -> FloatArray:
    scale = 1.4826 * float(np.median(np.abs(residual))) + 1e-9
    return np.asarray(np.minimum(1.0, _HUBER_SIGMAS * scale / np.maximum(np.abs(residual), 1e-12)))


def _solve(jacobian: FloatArray, residual: FloatArray, weights: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return the weighted Gauss-Newton step and the covariance it implies."""
    weighted = jacobian * weights[:, np.newaxis]
    scale = 1.0 / np.maximum(np.linalg.norm(jacobian, axis=0), 1e-30)
    normal = (jacobian.T @ weighted) * np.outer(scale, scale)
    if np.linalg.cond(normal) > 1e13:
        raise _flat()
    inverse = np.linalg.inv(normal) * np.outer(scale, scale)
    freedom = max(len(residual) - jacobian.shape[1], 1)
    variance = float((weights * residual**2).sum()) / freedom
    return inverse @ (weighted.T @ residual), inverse * variance


def sphere_coverage(field_mgauss: FloatArray) -> float:
    """Return the share of 80 equal patches of the sphere that fields (N, 3) point to."""
    k = np.arange(_COVERAGE_BINS) + 0.5
    height = 1.0 - 2.0 * k / _COVERAGE_BINS
    angle = math.pi * (1.0 + math.sqrt(5.0)) * k
    across = np.sqrt(1.0 - height**2)
    patches = np.stack([across * np.cos(angle), across * np.sin(angle), height])
    step = max(len(field_mgauss) // 20000, 1)
    nearest = (field_mgauss[::step] @ patches).argmax(axis=1)
    return float(np.unique(nearest).size) / _COVERAGE_BINS


def length_result(
    recorded: Recorded, method: str, fit_length: Callable[[FloatArray], LengthFit]
) -> CalibrationResult:
    """Fit the readings (N, 3) of a compass turned every way and bring the fit into a judged result."""
    track, instance, earth = recorded.track, recorded.instance, recorded.earth
    raw = track.raw_field(instance, motors=False)
    usable = np.isfinite(raw).all(axis=1)
    raw, time = raw[usable], track.compasses[instance].time_s[usable]
    fit, in_force = fit_length(raw), recorded.in_force
    correction = FieldCorrection.from_matrix(-fit.centre_mgauss, fit.matrix).with_motor_of(in_force)
    horizontal, vertical = _split(fit.length_mgauss, correction.apply(raw), down_in_body(track, time), earth)
    covariance = _raw_form(fit)
    state = np.zeros(11)
    state[OFFSET], state[GAIN] = fit.centre_mgauss, gain_parameters(np.linalg.inv(fit.matrix))
    state[HORIZONTAL], state[VERTICAL] = horizontal, vertical
    error = HeadingError(state, covariance)
    # The length says nothing of what it leaves over; on the horizontal it turns the heading.
    noise, left = error.rms_rad(), fit.residual_rms_mgauss / horizontal
    reasons = []
    if fit.coverage < LEAST_COVERAGE:
        reasons.append(
            f"The compass pointed to only {100.0 * fit.coverage:.0f} % of all directions. Turn it every way, "
            "or use the four-position method."
        )
    result = CalibrationResult(
        instance=instance,
        method=method,
        accepted=False,
        reasons=tuple(reasons),
        correction=correction,
        in_force=in_force,
        covariance_names=CALIBRATED,
        covariance=covariance,
        not_observable=("mounting_yaw",),
        residual_rms_mgauss=fit.residual_rms_mgauss,
        heading_sigma_deg=math.degrees(math.hypot(noise, left)),
        heading_budget_deg={"noise": math.degrees(noise), "disturbance": math.degrees(left)},
        heading_error=error,
        horizontal_mgauss=horizontal,
        vertical_mgauss=vertical,
    )
    return result.compared().within(recorded.limits)


def _split(
    length: float, field: FloatArray, down: FloatArray, earth: EarthField | None
) -> tuple[float, float]:
    """Split the field's length into horizontal and vertical: by the world model, or by gravity."""
    if earth is not None:
        factor = length / earth.total_mgauss
        return factor * earth.horizontal_mgauss, factor * earth.ned_mgauss[2]
    vertical = float(np.median((field * down).sum(axis=1)))
    return math.sqrt(max(length**2 - vertical**2, (0.05 * length) ** 2)), vertical


def _raw_form(fit: LengthFit) -> FloatArray:
    """Bring the covariance of c and M into that of offsets and gains T = M^-1: dT = -T dM T."""
    covariance = np.zeros((9, 9))
    if fit.covariance.shape[0] < 9:
        covariance[:3, :3] = fit.covariance
        return covariance
    gain = np.linalg.inv(fit.matrix)
    basis = gain_jacobian(np.eye(3)).transpose(2, 1, 0)  # the six symmetric unit matrices
    by_matrix = np.stack([gain_parameters(-gain @ unit @ gain) for unit in basis], axis=1)
    change = np.zeros((9, 9))
    change[:3, :3], change[3:, 3:] = np.eye(3), by_matrix
    return np.asarray(change @ fit.covariance @ change.T)
