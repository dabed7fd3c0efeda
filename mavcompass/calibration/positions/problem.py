"""The four-position fit: measurements with their covariances, the prior, a first state; was one disturbed?"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np

from mavcompass.calibration.first_state import first_state, rough_field
from mavcompass.calibration.model import HEADINGS, by_tilt
from mavcompass.calibration.observation import FourPositionData
from mavcompass.calibration.rigid import (
    DEFAULT_PRIOR,
    Fit,
    IronPrior,
    PriorRows,
    Readings,
    prior_rows,
    settle,
)
from mavcompass.correction import FieldCorrection
from mavcompass.earth_field import EarthField
from mavcompass.errors import PoorCalibration
from mavcompass.frames import FloatArray, level_to_body

# What no error model names: the sensor's own bends and steps of its converter.
_FLOOR_MGAUSS = 0.01
_ROBUST_FROM, _ROUNDS, _STEPS_A_ROUND = 6, 20, 2
# What turning must show of a circle's centre and radius: less is hardly a turn; of two positions 29 degrees.
_LEAST_SEEN = {2: 0.25, 3: 0.12}
_DEAD_MGAUSS = 1.0
# Of a compass that is upside down the field turns against the gyro.
_UPSIDE_DOWN = (1.0, -1.0, 1.0)
_MANY_SIGMAS_3D = 11.34  # chi-square of three, 99 %
# How often a position is disturbed at all, and how large such fields are.
DISTURBED_RUNS, SIZES_MGAUSS = 0.05, (5.0, 40.0)
# Positions that chance lets disagree as much this often were not. And a disturbance less likely than that is
# left out of the answer: its far tail would widen a sigma that is meant to cover two thirds, not the rare
# exception.
_BY_CHANCE, _NEGLIGIBLE = 0.05, 0.1


@dataclass(frozen=True, slots=True, eq=False)
class PositionProblem:
    """Hold the measurements in the form the fit works on."""

    readings: Readings
    rules: PriorRows
    whiten: FloatArray  # (K, 3, 3), maps residuals to unit variance
    parts: Mapping[str, FloatArray]  # of the residuals' covariance, by source, (K, 3, 3) each
    leaning: FloatArray  # (K, 3, 2): one sigma of the accelerometer's error, common to all, in the field
    start: FloatArray  # (P,)
    mirrored: bool

    @classmethod
    def of(
        cls, data: FourPositionData, in_force: FieldCorrection, earth: EarthField | None, prior: IronPrior
    ) -> PositionProblem:
        """Prepare the fit: the start by linear least squares, the weights, the prior."""
        dwells = data.dwells
        if data.first_heading is None and len(dwells) < (fewest := prior.fewest_positions):
            raise PoorCalibration(
                f"Only {len(dwells)} still positions: offset and amplitude need at least {fewest}.",
                "Turn the vehicle in four steps of about 90 degrees and stop after each.",
            )
        mean = np.array([d.mean_mgauss for d in dwells])
        tilts = level_to_body([d.roll_rad for d in dwells], [d.pitch_rad for d in dwells])
        current = np.array([d.current_a for d in dwells])
        load = current - current.mean() if np.isfinite(current).all() else np.zeros(len(dwells))
        readings = Readings(
            middle_s=np.concatenate([[0.0], np.cumsum([s.duration_s for s in data.steps])]),
            mean_mgauss=mean,
            mapping=tilts @ np.array([d.swing for d in dwells]),
            by_lag=np.zeros((len(dwells), 3, 3)),
            loads=load[:, np.newaxis],
            turned_rad=data.turned_rad,
            step_sigma_rad=np.array([max(s.sigma_rad, 1e-6) for s in data.steps]),
        )
        field = rough_field(mean, earth, in_force)
        rules = prior_rows(
            readings.loads.shape,
            prior,
            earth,
            in_force,
            field[1],
            (data.gyro_scale_sigma, data.gyro_bias_sigma_radps),
            prior.motor_sigma_mgauss_per_a,
            data.first_heading,
        )
        given = data.first_heading[0] if data.first_heading is not None and earth is not None else None
        if given is None:
            _require_turning(mean, data.turned_rad)
        first, mirrored = first_state(readings, rules, field, given), False
        if given is None and len(dwells) >= DEFAULT_PRIOR.fewest_positions:
            upside_down = first_state(replace(readings, mean_mgauss=mean * _UPSIDE_DOWN), rules, field)
            mirrored = upside_down.cost(field[0]) < first.cost(field[0])
        # How the readings lean with the vehicle goes by where they were taken.
        start = settle(readings, first.state, np.tile(np.eye(3), (len(dwells), 1, 1)), rules)
        noise = np.array([d.covariance_mgauss2 for d in dwells]) + _FLOOR_MGAUSS**2 * np.eye(3)
        quantisation = np.array([d.quantisation_mgauss2 for d in dwells])
        leaning = by_tilt(tilts, start, start[HEADINGS:])
        sigma2 = np.array([d.tilt_sigma_rad for d in dwells])[:, np.newaxis, np.newaxis] ** 2
        tilt = leaning @ np.swapaxes(leaning, 1, 2) * sigma2
        return cls(
            readings=readings,
            rules=rules,
            whiten=np.linalg.inv(np.linalg.cholesky(noise + quantisation + tilt)),
            parts={"noise": noise, "quantisation": quantisation, "tilt": tilt},
            leaning=leaning * data.tilt_bias_sigma_rad,
            start=start,
            mirrored=mirrored,
        )

    def roots(self, weights: FloatArray) -> FloatArray:
        """Return what whitens the field's residuals, (K, 3, 3), of dwells that weigh so much, (K,)."""
        return np.asarray(self.whiten * np.sqrt(weights)[:, np.newaxis, np.newaxis])

    def loosened(self, index: int, size_mgauss: float) -> PositionProblem:
        """Let one dwell's field be off by an unknown amount of that size, each axis."""
        parts, whiten = {**self.parts, "noise": self.parts["noise"].copy()}, self.whiten.copy()
        parts["noise"][index] += size_mgauss**2 * np.eye(3)
        whiten[index] = np.linalg.inv(np.linalg.cholesky(sum(part[index] for part in parts.values())))
        return replace(self, parts=parts, whiten=whiten)


def _require_turning(mean: FloatArray, turned: FloatArray) -> None:
    """Raise PoorCalibration where the vehicle hardly turned, or the field of means (K, 3) hardly changed."""
    design = np.stack([np.ones(turned.size), np.cos(turned), np.sin(turned)], axis=1)
    seen = np.linalg.svd(design, compute_uv=False)[min(turned.size, 3) - 1] / math.sqrt(turned.size)
    if seen < _LEAST_SEEN[min(turned.size, 3)]:
        raise PoorCalibration(
            f"The positions cover too little of the circle: {math.degrees(np.ptp(turned)):.0f} degrees of"
            " turning in all.",
            "Turn the vehicle in four steps of about 90 degrees and stop after each.",
        )
    amplitude = 0.5 * float(np.ptp(mean, axis=0).max())
    if amplitude < _DEAD_MGAUSS:
        raise PoorCalibration(
            f"The field hardly changes while the vehicle turns (amplitude {amplitude:.1f} mG): this compass "
            "is dead, frozen or reads only its offsets.",
            "Check the compass's wiring and that COMPASS_USE and the driver see the sensor.",
        )


def fit_positions(problem: PositionProblem, near: Fit | None = None) -> Fit:
    """Fit the positions; dwells far out weigh less where there are many.

    The fit of a problem that is nearly the same may be given to begin with.
    """
    readings = problem.readings
    x, weights = (problem.start, np.ones(len(readings))) if near is None else (near.state, near.sound)
    if len(readings) >= _ROBUST_FROM:
        for _ in range(_ROUNDS):
            x = settle(readings, x, problem.roots(weights), problem.rules, _STEPS_A_ROUND)
            before, weights = weights, _weights(problem, readings.field(x)[0])
            if float(np.abs(weights - before).max()) < 1e-3:
                break
    return Fit.of(readings, x, problem.roots(weights), problem.rules, weights)


def _weights(problem: PositionProblem, field: FloatArray) -> FloatArray:
    distance = (np.einsum("kij,kj->ki", problem.whiten, field) ** 2).sum(axis=1)
    return np.asarray(np.minimum(1.0, _MANY_SIGMAS_3D / np.maximum(distance, 1e-12)))


# --- was one of the positions disturbed? --------------------------------------------------------------


class Mixture(NamedTuple):
    """Hold the mixture over "no dwell was disturbed" and "dwell j was".

    Attributes:
        state, covariance: of the mixture.
        probability: of each dwell having been disturbed, (K,).
        size_mgauss: how far each dwell's field is from what the others predict, (K,).
        best: the fit by the likeliest hypothesis.
    """

    state: FloatArray
    covariance: FloatArray
    probability: FloatArray
    size_mgauss: FloatArray
    best: Fit


def weigh_disturbances(problem: PositionProblem, fit: Fit) -> Mixture:
    """Blend the fit with those in which one dwell is disturbed, by their probabilities.

    A car that passes, or steel beside one position, adds an unknown field to one dwell. The hypothesis that
    it was dwell j is the same fit with that dwell loosened; Laplace's evidence weighs it. With many positions
    the disturbed one is left out; with four, several may be suspect, and the heading's sigma grows by how
    much their answers differ. Positions that agree as chance lets them were not disturbed.
    """
    k = len(problem.readings)
    sizes, owners, fits = np.zeros(k), [-1], [fit]
    if fit.chance >= _BY_CHANCE:
        return Mixture(fit.state, fit.covariance, np.zeros(k), sizes, fit)
    odds = math.log(DISTURBED_RUNS / (k * len(SIZES_MGAUSS)))
    weights = [math.log(1.0 - DISTURBED_RUNS) + _evidence(problem, fit)]
    for j in range(k):
        for size in SIZES_MGAUSS:
            loosened = problem.loosened(j, size)
            fits.append(fit_positions(loosened, fit))
            owners.append(j)
            weights.append(odds + _evidence(loosened, fits[-1]))
        sizes[j] = np.linalg.norm(fits[-1].residual_mgauss[j])
    share = np.exp(np.array(weights) - max(weights))
    share /= share.sum()
    probability = np.array([share[np.array(owners) == j].sum() for j in range(k)])
    best = fits[int(np.argmax(share))]
    if float(probability.sum()) < _NEGLIGIBLE:
        return Mixture(fit.state, fit.covariance, probability, sizes, best)
    states = np.array([one.state for one in fits])
    apart = states - share @ states
    covariance = np.tensordot(share, [one.covariance for one in fits], axes=1)
    covariance += (apart * share[:, np.newaxis]).T @ apart
    return Mixture(share @ states, covariance, probability, sizes, best)


def _evidence(problem: PositionProblem, fit: Fit) -> float:
    """Return the logarithm of the evidence up to a constant: fit, weights, and the room left to the state."""
    weights = float(np.linalg.slogdet(problem.whiten)[1].sum())
    scale = np.sqrt(np.diag(fit.covariance))
    correlation = fit.covariance / np.outer(scale, scale)
    room = float(np.log(scale).sum()) + 0.5 * float(np.linalg.slogdet(correlation)[1])
    return -fit.cost + weights + room
