"""What a fit of a motion may claim: its covariance, widened by what left-out blocks and the scatter show.

Whole blocks are left out of the fit, one after the other: tenths of the time, then eighths of the circle.
Where the model is right the heading moves by as much as the block's own information lets expect; the
ratio of the two, over all blocks and headings, has the mean 1. A ratio beyond chance multiplies the
covariance. The heading scatter that is left, between sections and second by second, is the least
that is claimed.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from mavcompass.calibration.model import HORIZONTAL, HeadingError, heading_gradient
from mavcompass.calibration.motion.fit import MotionFit, leaning_error
from mavcompass.calibration.motion.sections import Sections
from mavcompass.calibration.positions.fit import weigh_cross_terms
from mavcompass.calibration.rigid import DEFAULT_PRIOR, IronPrior
from mavcompass.frames import FloatArray

_TIME_BLOCKS, _SECTORS = 10, 8
# A ratio up to this is chance.
_BY_CHANCE = 3.0
_CIRCLE = np.arange(36) * (2.0 * math.pi / 36)


@dataclass(frozen=True, slots=True, eq=False)
class Honesty:
    """Hold what a fit may claim.

    Attributes:
        state: the fit's, its cross terms as far as they are believed.
        error: the heading's, all told. noise_rad: its rms by noise and prior alone.
        accelerometer_rad: the part of the accelerometer's own error, rms, which no further motion lowers.
        scatter_rad: what is left between sections, seen as a heading; 0 where chance explains it.
        left_out_ratio: the larger of the ratios by time and by heading.
    """

    state: FloatArray
    error: HeadingError
    noise_rad: float
    accelerometer_rad: float
    scatter_rad: float
    left_out_ratio: float

    def at_least(self, scatter_rad: float) -> Honesty:
        """Claim no less than a scatter that was seen."""
        if scatter_rad <= self.scatter_rad:
            return self
        factor = max(scatter_rad / self.error.rms_rad(), 1.0)
        wider = HeadingError(self.error.state, self.error.covariance * factor**2)
        return replace(self, error=wider, scatter_rad=scatter_rad)


def weigh_honestly(sections: Sections, fit: MotionFit, prior: IronPrior = DEFAULT_PRIOR) -> Honesty:
    """Judge a fit by blocks left out and by the scatter that it leaves."""
    blend = weigh_cross_terms(fit.state, fit.covariance, prior, leaning_error(sections, fit))
    leaning = (blend.shared @ blend.shared.T)[:9, :9]
    state, covariance = blend.state, blend.covariance[:9, :9] - leaning
    ratio = max(_left_out(fit, _by_time(sections)), _left_out(fit, _by_heading(fit)))
    claimed = HeadingError(state[:11], covariance)
    noise = claimed.rms_rad()
    widened = noise * math.sqrt(ratio if ratio > _BY_CHANCE else 1.0)
    scatter = _scatter(sections, fit)
    final = max(widened, scatter)
    error = HeadingError(state[:11], covariance * (final / noise) ** 2 + leaning)
    return Honesty(state, error, noise, HeadingError(state[:11], leaning).rms_rad(), scatter, ratio)


def _by_time(sections: Sections) -> NDArray[np.intp]:
    span = max(float(sections.end_s[-1] - sections.start_s[0]), 1e-9)
    part = (sections.middle_s - sections.start_s[0]) / span
    return np.minimum((part * _TIME_BLOCKS).astype(np.intp), _TIME_BLOCKS - 1)


def _by_heading(fit: MotionFit) -> NDArray[np.intp]:
    return np.floor(np.mod(fit.headings_rad, 2.0 * math.pi) / (2.0 * math.pi) * _SECTORS).astype(np.intp)


def _left_out(fit: MotionFit, block: NDArray[np.intp]) -> float:
    """Return by how much more the heading moves than expected where blocks are left out, squared."""
    gradient = np.zeros((_CIRCLE.size, fit.state.size))
    gradient[:, :9] = heading_gradient(fit.state, _CIRCLE)
    rows = np.repeat(block, 3)
    field_rows = fit.jacobian[: rows.size]
    before = np.einsum("ni,ij,nj->n", gradient, fit.covariance, gradient)
    scale = 1.0 / np.sqrt(np.maximum(np.diag(fit.information), 1e-24))
    moved = expected = 0.0
    for one in np.unique(block):
        inside = field_rows[rows == one]
        rest = (fit.information - inside.T @ inside) * np.outer(scale, scale)
        rest[np.diag_indices_from(rest)] += 1e-9
        pull = inside.T @ fit.whitened[: rows.size][rows == one]
        solved = np.linalg.solve(rest, (np.column_stack([pull, gradient.T])) * scale[:, np.newaxis])
        answers = gradient @ (solved * scale[:, np.newaxis])
        without = np.einsum("nn->n", answers[:, 1:])
        if not float(without.max()) < math.radians(30.0) ** 2:
            continue  # Without this block nothing is known: it cannot be judged by the rest.
        moved += float((answers[:, 0] ** 2).sum())
        expected += float(np.maximum(without - before, 0.0).sum())
    return moved / expected if expected > 0.0 else 1.0


def _scatter(sections: Sections, fit: MotionFit) -> float:
    """Return the heading scatter between sections that noise does not explain, radians."""
    if fit.model_mgauss <= 0.0:
        return 0.0
    psi = fit.headings_rad
    east = np.stack([np.sin(psi), np.cos(psi), np.zeros(psi.size)], axis=1)
    across = np.einsum("kij,kj->ki", sections.mapping, east) @ np.linalg.inv(fit.gain) / fit.state[HORIZONTAL]
    angle = (across * fit.residual_mgauss).sum(axis=1)
    spread = np.einsum("ki,kij,kj->k", across, fit.variance_mgauss2, across)
    model = fit.model_mgauss**2 * (across**2).sum(axis=1)
    share = fit.sound / sections.repeats
    share = share / share.sum()
    seen = float(share @ angle**2) - float(share @ (spread - model))
    return math.sqrt(max(seen, float(share @ model)))
