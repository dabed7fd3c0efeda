"""World-field calibration: the raw field against the Earth's, turned into the body by a known attitude.

    r = b + T (R^T B) + m load + d (t - tm) + S (t - tm) (R^T B)                                 (W1)

is linear in everything wanted: hard iron b, symmetric gain T, motor field m per unit of load, bias d and
sensitivity S (one number per axis) per degree of temperature. The attitude's yaw must not come from the
compass that is calibrated: an optical or turntable reference, GPS yaw, or the gyro with an unknown first
heading, which is then found together with the rest.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from mavcompass.calibration.model import gain_matrix
from mavcompass.calibration.positions import IronPrior
from mavcompass.errors import PoorCalibration
from mavcompass.frames import FloatArray

_AXES = "xyz"
_GAIN_NAMES = ("gain_xx", "gain_yy", "gain_zz", "gain_xy", "gain_xz", "gain_yz")
# Which field component each gain parameter multiplies on each axis: (parameter, component).
_TERMS = (((0, 0), (3, 1), (4, 2)), ((3, 0), (1, 1), (5, 2)), ((4, 0), (5, 1), (2, 2)))
_STRONGEST_CONDITION = 1e10


@dataclass(frozen=True, slots=True, eq=False)
class WorldFieldFit:
    """Hold a fit of equation W1.

    Attributes:
        offset_mgauss: b, (3,). gain: T, (3, 3).
        motor_mgauss: m, (3,) per load, or (k, 3) for k motors; empty where no load was given.
        temperature_bias, temperature_gain: d, (3,) mG per degree, and S, (3,) per degree; zeros without.
        names, covariance: of all fitted numbers; consecutive readings do not count as independent.
        residual_mgauss: (N, 3). residual_rms_mgauss: over samples and axes.
    """

    offset_mgauss: FloatArray
    gain: FloatArray
    motor_mgauss: FloatArray
    temperature_bias: FloatArray
    temperature_gain: FloatArray
    names: tuple[str, ...]
    covariance: FloatArray
    residual_mgauss: FloatArray
    residual_rms_mgauss: float


def fit_world_field(
    raw_mgauss: ArrayLike,
    expected_mgauss: ArrayLike,
    load: ArrayLike | None = None,
    temperature_degc: ArrayLike | None = None,
    independent: float | None = None,
    prior: IronPrior | None = None,
) -> WorldFieldFit:
    """Fit equation W1 by least squares over the moments of the data.

    Args:
        raw_mgauss: readings in body axes, (N, 3).
        expected_mgauss: the Earth's field in body axes at the same times, (N, 3).
        load: motor load, (N,) or, per motor, (N, k).
        temperature_degc: (N,).
        independent: how many of the N readings count for the covariance; None judges by the residuals'
            memory.
        prior: what is known of compasses in general. With it a level turn gives an answer too: the Z
            gain is then the mean of the horizontal ones and Z's offset follows from the world model.

    Raises PoorCalibration where the motion does not determine the parameters.
    """
    raw, field = (np.asarray(v, dtype=np.float64) for v in (raw_mgauss, expected_mgauss))
    extra, extra_names = _regressors(load, temperature_degc, len(raw))
    warm = None
    if temperature_degc is not None:
        temperature = np.asarray(temperature_degc, dtype=np.float64)
        warm = temperature - temperature.mean()
    normal, right = _normal_equations(raw, field, extra, warm)
    if prior is not None:
        # The prior counts against the noise of independent readings, which a first fit measures.
        weak = _with_prior(normal, right, prior, 1.0)
        first = _residual(raw, field, extra, warm, _solve(*weak)[0])
        noise = float((first**2).mean()) * _memory(first)
        normal, right = _with_prior(normal, right, prior, max(noise, 1e-6))
    answer, inverse = _solve(normal, right)
    residual = _residual(raw, field, extra, warm, answer)
    k = extra.shape[1]
    shared = answer[9 : 9 + 3 * k].reshape(k, 3)
    motors = shared[: k - (warm is not None)]
    rms = math.sqrt(float((residual**2).mean()))
    count = independent if independent is not None else len(raw) / _memory(residual)
    covariance = inverse * rms**2 * len(raw) / max(count, 1.0)
    names = (
        *(f"offset_{a}" for a in _AXES),
        *_GAIN_NAMES,
        *(f"{name}_{a}" for name in extra_names for a in _AXES),
        *(f"temperature_gain_{a}" for a in _AXES if warm is not None),
    )
    return WorldFieldFit(
        offset_mgauss=answer[:3],
        gain=gain_matrix(answer[3:9]),
        motor_mgauss=motors[0] if load is not None and np.ndim(load) == 1 else motors,
        temperature_bias=shared[-1] if warm is not None else np.zeros(3),
        temperature_gain=answer[9 + 3 * k :] if warm is not None else np.zeros(3),
        names=names,
        covariance=covariance,
        residual_mgauss=residual,
        residual_rms_mgauss=rms,
    )


def _regressors(
    load: ArrayLike | None, temperature: ArrayLike | None, count: int
) -> tuple[FloatArray, list[str]]:
    """Stack what adds a field of its own, (N, k): motor loads, then the temperature."""
    columns, names = [], []
    if load is not None:
        loads = np.asarray(load, dtype=np.float64)
        loads = loads[:, np.newaxis] if loads.ndim == 1 else loads
        columns += list(loads.T)
        names += ["motor"] if loads.shape[1] == 1 else [f"motor{i + 1}" for i in range(loads.shape[1])]
    if temperature is not None:
        t = np.asarray(temperature, dtype=np.float64)
        columns.append(t - t.mean())
        names.append("temperature")
    return (np.stack(columns, axis=1) if columns else np.empty((count, 0))), names


def _normal_equations(
    raw: FloatArray, field: FloatArray, extra: FloatArray, warm: FloatArray | None
) -> tuple[FloatArray, FloatArray]:
    """Build the normal equations J^T J x = J^T y from second moments.

    Each axis's row of the design uses the same columns u = (1, field, extra, warm field); all that is
    needed of N samples is u^T u and u^T raw.
    """
    columns = [np.ones((len(raw), 1)), field, extra]
    if warm is not None:
        columns.append(field * warm[:, np.newaxis])
    u = np.concatenate(columns, axis=1)
    moments, cross = u.T @ u, u.T @ raw
    k = extra.shape[1]
    size = 9 + 3 * k + (3 if warm is not None else 0)
    normal, right = np.zeros((size, size)), np.zeros(size)
    for axis in range(3):
        # Which parameter each column of u belongs to on this axis.
        place = [(axis, 0)]
        place += [(3 + parameter, 1 + component) for parameter, component in _TERMS[axis]]
        place += [(9 + 3 * j + axis, 4 + j) for j in range(k)]
        if warm is not None:
            place.append((9 + 3 * k + axis, 4 + k + axis))
        parameters, used = (np.array(v) for v in zip(*place, strict=True))
        normal[np.ix_(parameters, parameters)] += moments[np.ix_(used, used)]
        right[parameters] += cross[used, axis]
    return normal, right


def _solve(normal: FloatArray, right: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Solve the normal equations; returns the answer and (J^T J)^-1."""
    scale = 1.0 / np.sqrt(np.maximum(np.diag(normal), 1e-30))
    scaled = normal * np.outer(scale, scale)
    if not np.isfinite(scaled).all() or np.linalg.cond(scaled) > _STRONGEST_CONDITION:
        raise PoorCalibration(
            "This motion does not determine all that was asked for (the equations are singular).",
            "Turn the vehicle all the way round and tilt it, or ask for fewer terms.",
        )
    inverse = np.linalg.inv(scaled) * np.outer(scale, scale)
    return inverse @ right, inverse


def _with_prior(
    normal: FloatArray, right: FloatArray, prior: IronPrior, noise_mgauss2: float
) -> tuple[FloatArray, FloatArray]:
    """Add the prior of the gains as rows of the same weight as a reading of the given variance."""
    rows = np.zeros((6, len(right)))
    wanted = np.array([1.0, 1.0, 0.0, 0.0, 0.0, 0.0])
    rows[0, 3] = rows[1, 4] = rows[2, 5] = 1.0
    rows[2, 3:5] = -0.5
    rows[3:, 6:9] = np.eye(3)
    sigma = np.array(
        [prior.gain_sigma, prior.gain_sigma, prior.vertical_gain_sigma, *(3 * [prior.cross_sigma])]
    )
    weighted = rows / sigma[:, np.newaxis] ** 2 * noise_mgauss2
    return normal + rows.T @ weighted, right + weighted.T @ wanted


def _residual(
    raw: FloatArray, field: FloatArray, extra: FloatArray, warm: FloatArray | None, answer: FloatArray
) -> FloatArray:
    k = extra.shape[1]
    gain = gain_matrix(answer[3:9])
    residual = raw - field @ gain - answer[:3] - extra @ answer[9 : 9 + 3 * k].reshape(k, 3)
    if warm is not None:
        residual -= warm[:, np.newaxis] * field * answer[9 + 3 * k :]
    return np.asarray(residual)


def _memory(residual: FloatArray) -> float:
    """Return how many consecutive readings make one independent, from the residuals' autocorrelation."""
    n = len(residual)
    centred = residual - residual.mean(axis=0)
    power = float((centred**2).sum())
    if n < 16 or power <= 0.0:
        return 1.0
    total, lag = 1.0, 1
    while lag < n // 4:
        correlation = float((centred[lag:] * centred[:-lag]).sum()) / power
        if correlation < 0.05:
            break
        # Lags between the last power of two and this one count like this one.
        total += 2.0 * correlation * max(lag / 2.0, 1.0)
        lag *= 2
    return total


@dataclass(frozen=True, slots=True, eq=False)
class GyroYawFit:
    """Hold a world-field fit whose yaw is the gyro's: `first_yaw_rad` is the true yaw at the start."""

    fit: WorldFieldFit
    first_yaw_rad: float
    drift_radps: float


def fit_with_gyro_yaw(
    raw_mgauss: FloatArray,
    time_s: FloatArray,
    level_field_to_body: FloatArray,
    turned_rad: FloatArray,
    horizontal_mgauss: float,
    vertical_mgauss: float,
    load: FloatArray | None = None,
    prior: IronPrior | None = None,
) -> GyroYawFit:
    """Fit equation W1 with the gyro's turned angle as yaw; its start and drift are found by the fit.

    The expected body field is L (H cos psi, -H sin psi, Z), psi = start + turned + drift t, with L (N, 3, 3)
    from level to body axes. The start is scanned, then start and drift are refined by Gauss-Newton on the
    residuals left by the linear fit.
    """
    clock = time_s - time_s.mean()

    def expected(start: float, drift: float) -> FloatArray:
        psi = start + turned_rad + drift * clock
        level = np.stack(
            [
                horizontal_mgauss * np.cos(psi),
                -horizontal_mgauss * np.sin(psi),
                np.full(psi.size, vertical_mgauss),
            ],
            axis=1,
        )
        return np.einsum("nij,nj->ni", level_field_to_body, level)

    def residual(start: float, drift: float) -> FloatArray:
        return fit_world_field(raw_mgauss, expected(start, drift), load, prior=prior).residual_mgauss

    def plausible(start: float) -> float:
        fit = fit_world_field(raw_mgauss, expected(start, 0.0), load, prior=prior)
        # A wrong start makes the symmetric gain far from 1 rather than the residual large.
        return fit.residual_rms_mgauss + float(np.linalg.norm(fit.gain - np.eye(3))) * horizontal_mgauss

    start = min(np.arange(24) * (2.0 * math.pi / 24), key=lambda angle: plausible(float(angle)))
    x = np.array([float(start), 0.0])
    for _ in range(15):
        here = residual(*x).ravel()
        steps = (1e-4, 1e-4 / max(float(np.ptp(clock)), 1.0))
        columns = [(residual(*(x + np.eye(2)[i] * steps[i])).ravel() - here) / steps[i] for i in range(2)]
        jacobian = np.stack(columns, axis=1)
        move, *_ = np.linalg.lstsq(jacobian, -here, rcond=None)
        x = x + move
        if abs(move[0]) < 1e-9:
            break
    return GyroYawFit(fit_world_field(raw_mgauss, expected(*x), load, prior=prior), float(x[0]), float(x[1]))
