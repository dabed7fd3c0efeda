"""One attitude from all that knows it but the compass under test.

The smoother's equations are solved about a first trajectory, and about the corrected one again until nothing
moves.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from mavcompass.frames import FloatArray
from mavcompass.gap.attitude.chain import Solved
from mavcompass.gap.attitude.kinematics import exponentials
from mavcompass.gap.attitude.receiver import Velocity
from mavcompass.gap.attitude.scatter import Bias
from mavcompass.gap.attitude.smoother import BIAS, PHI, SCALE, SCALE_SIGMA, Sensed, Sizes, Smoother, Witness

# What is left of a pass is the square of how far it moved, and how much its velocities are believed.
_PASSES, _SETTLED_RAD, _AS_TRUSTED = 10, math.radians(0.3), 0.1
_STRAINED, _FAULTY_RADPS = 2.0, math.radians(3.0)
# A scale that is off by so many of its sigmas is a fault, and may be off by any.
_STRETCHED, FAULTY_SCALE = 5.0, 0.1


@dataclass(frozen=True, slots=True, eq=False)
class Smoothed:
    """Hold the smoothed attitude.

    Attributes:
        rotation: body to NED, (N, 3, 3). rate_radps: without the gyro's bias and scale error, (N, 3).
        gyro_bias: mean over the recording, and its standard deviation. gyro_scale: gain error of each axis.
        knots_s: the smoother's times, (K,). some: those that tell how the error goes, (M,).
        borne_out: False where a receiver's velocity is contradicted.
    """

    rotation: FloatArray
    rate_radps: FloatArray
    gyro_bias: Bias
    gyro_scale: Bias
    knots_s: FloatArray
    some: NDArray[np.int64]
    borne_out: bool
    _solved: Solved
    _excess: float

    def covariance(self) -> FloatArray:
        """Return that of the rotation vectors in world axes at some knots, (3 M, 3 M)."""
        return self._excess * self._solved.covariance(self.some, PHI.stop)

    def covariance_with(self, sums: FloatArray) -> FloatArray:
        """Return that of the rotation vectors at all knots with sums of those at some, (K, 3, k).

        The sums have weights (3 M, k).
        """
        weights = sums.reshape(self.some.size, 3, -1)
        return self._excess * self._solved.covariance_with(self.some, weights)[:, PHI]


def smoothed_attitude(
    sensed: Sensed,
    start: FloatArray,
    bias: Bias,
    velocity: Velocity | None,
    witness: Witness | None,
    scale_sigma: float = SCALE_SIGMA,
) -> Smoothed:
    """Smooth a first trajectory (N, 3, 3); its yaw must be about that of the velocity, if there is one."""
    smoother = Smoother(sensed, bias, velocity, witness, scale_sigma)
    sizes = Sizes()
    rotation, trust = smoother.through(smoother.at_knots(start)), smoother.full_trust()
    solved: Solved | None = None
    for turn in range(_PASSES):
        chain = smoother.chain(rotation, trust)
        if turn == 1:
            sizes = smoother.likeliest(chain, sizes)
        solved = smoother.with_sizes(chain, sizes).solve()
        before, trust = trust, smoother.trust(solved)
        phi = solved.states[:, PHI]
        rotation = smoother.through(exponentials(phi) @ smoother.at_knots(rotation))
        # A yaw that nothing fixes drifts on for ever.
        settled = float(np.abs(phi - phi.mean(axis=0)).max()) < _SETTLED_RAD
        if turn > 0 and settled and float(np.abs(trust - before).max(initial=0.0)) < _AS_TRUSTED:
            break
    assert solved is not None
    change = solved.states[:, BIAS].mean(axis=0)
    rate = smoother.rate - smoother.between(solved.states[:, BIAS]) - smoother.rate * solved.constants[SCALE]
    middle = np.array([smoother.knots.size // 2])
    sigma = np.sqrt(np.diag(solved.covariance(middle, BIAS.stop))[BIAS])
    excess = smoother.excess(solved)
    # The constants are a share of what the gyro says, its scale is one of how it turned.
    turned = 1.0 - solved.constants[SCALE]
    scale_sigmas = np.sqrt(excess * np.diag(solved.constants_covariance)[SCALE])
    scale = Bias(solved.constants[SCALE] / turned, scale_sigmas / turned**2)
    return Smoothed(
        rotation, rate, Bias(bias.mean + change, sigma), scale,
        smoother.knots, smoother.telling(), smoother.bears_out(solved), solved, excess,
    )  # fmt: skip


def believable(smoothed: Smoothed, bias: Bias) -> bool:
    """Tell whether a gyro's bias is what it was at rest, as far as that may be."""
    return not bool((np.abs(smoothed.gyro_bias.mean - bias.mean) > _STRAINED * bias.sigma).any())


def stretched(smoothed: Smoothed) -> bool:
    """Tell whether a gyro's scale is off by more than a healthy one's is."""
    return bool((np.abs(smoothed.gyro_scale.mean) > _STRETCHED * SCALE_SIGMA).any())


def faulty(bias: Bias) -> Bias:
    """Let a gyro be off by more than a healthy one is."""
    return Bias(bias.mean, np.maximum(bias.sigma, _FAULTY_RADPS))
