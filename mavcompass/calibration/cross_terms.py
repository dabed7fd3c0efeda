"""Whether a compass has cross terms at all: the fit's, blended with the same fit without them."""

from __future__ import annotations

import math

import numpy as np

from mavcompass.calibration.rigid import IronPrior
from mavcompass.frames import FloatArray

# Before the data: most compasses away from steel have no cross terms that matter.
CROSS_TERMS_BEFORE = 0.25


def weigh_cross_terms(
    state: FloatArray, covariance: FloatArray, prior: IronPrior, shared: FloatArray
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Weigh 'there are cross terms' against 'there are a sensor's own at the most' and blend the two.

    Returns the state, its covariance with the shared errors in it, and these.

    Both are one Gaussian: with the narrow prior is the fit with one more observation, that they are 0 within
    `narrow`, 1 / own^2 = 1 / cross^2 + 1 / narrow^2. The odds are the density of that observation after over
    that before the data (Savage and Dickey), times the prior odds. Where the data cannot tell, the blend
    costs less than either: a cross term that is not there is not paid for.

    No sensor's axes are square to nothing: taken for exactly so, a tilt that all readings share, which shows
    like a cross term, would count as known.

    `shared` (P, M) are errors of the state, one sigma each, that are no cross terms and tell nothing of them.
    """
    for index in ([6], [7, 8]):
        state, covariance, shared = _spike_and_slab(state, covariance, shared, index, prior)
    return state, covariance + shared @ shared.T, shared


def _spike_and_slab(
    state: FloatArray, covariance: FloatArray, shared: FloatArray, index: list[int], prior: IronPrior
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Blend a Gaussian with itself under the narrow prior of `state[index]`."""
    if prior.own_cross_sigma >= prior.cross_sigma:  # known as a calibration has them: nothing to weigh
        return state, covariance, shared
    narrow2 = 1.0 / (prior.own_cross_sigma**-2.0 - prior.cross_sigma**-2.0)
    block = covariance[np.ix_(index, index)] + narrow2 * np.eye(len(index))
    value = state[index] - np.asarray(prior.gains)[np.array(index) - 3]
    gain = covariance[:, index] @ np.linalg.inv(block)
    posterior = -0.5 * float(value @ np.linalg.solve(block, value)) - 0.5 * float(np.linalg.slogdet(block)[1])
    before = -0.5 * len(index) * math.log(prior.cross_sigma**2 + narrow2)
    odds = math.log((1.0 - CROSS_TERMS_BEFORE) / CROSS_TERMS_BEFORE)
    log_odds = min(max(posterior - before + odds, -700.0), 700.0)
    spike = 1.0 / (1.0 + math.exp(-log_odds))
    shift = -gain @ value
    blended = state + spike * shift
    reduced = covariance - spike * gain @ covariance[index, :]
    spread = spike * (1.0 - spike) * np.outer(shift, shift)
    return blended, reduced + spread, shared - spike * gain @ shared[index]
