"""What stands feels gravity, but for a push that fades: a rover rolls out, a hull glides on.

A push p that fades with the time constant T has changed by D = p (exp(t / T) - 1) in the time t until now, so

    p = D / (exp(t / T) - 1)                                                                         (S1)

by the change since the look before, and by the one since the first look, which long standing shows best.
Forces are horizontal ones of `level`'s frame, complex.
"""

from __future__ import annotations

import math
from typing import NamedTuple

# So long a mean is looked at. A push fades as fast as a rover rolls out (ArduPilot 4.5.7's simulated one).
# What seems to stand may keep so much of an acceleration.
LOOK_S, _FADES_S, _STAYS_MPS2 = 0.5, 2.0, 0.01


class Standing(NamedTuple):
    """Hold the integral of what was felt since the last look, for how long, and the means of looks before."""

    felt: complex = 0.0 + 0.0j
    felt_s: float = 0.0
    looks: int = 0
    first: complex = 0.0 + 0.0j
    before: complex = 0.0 + 0.0j

    def feeling(self, force: complex, step_s: float) -> Standing:
        """Feel a force for a while."""
        felt, felt_s, looks, first, before = self
        return Standing(felt + force * step_s, felt_s + step_s, looks, first, before)

    def leant(self, by: complex) -> Standing:
        """Turn the frame, in which all forces are others by so much then."""
        felt, felt_s, looks, first, before = self
        return Standing(felt + by * felt_s, felt_s, looks, first + by, before + by)

    def looked(self) -> Standing:
        """Begin the next look."""
        mean = self.felt / self.felt_s
        return Standing(looks=self.looks + 1, first=self.first if self.looks else mean, before=mean)

    def gravity(self, noise2: float) -> tuple[complex, float]:
        """Return the mean of this look, and the variance of what is not gravity in it, each axis.

        `noise2` is the noise of the mean. The first look tells nothing.
        """
        mean = self.felt / self.felt_s
        if not self.looks:
            return mean, math.inf
        # Seen backward in time a push grows: it is no more than what it changed by since the first look.
        push2 = min(
            _of_change(1) ** 2 * _beyond(mean - self.before, noise2),
            max(_of_change(self.looks), 1.0) ** 2 * _beyond(mean - self.first, noise2),
        )
        return mean, noise2 + _STAYS_MPS2**2 + push2


def _of_change(looks: int) -> float:
    """Return how many times its change over some looks a push is, (S1)."""
    return 1.0 / math.expm1(looks * LOOK_S / _FADES_S)


def _beyond(change: complex, noise2: float) -> float:
    """Return the square of a change without what noise of both means makes of it, which may hide as much."""
    return max(change.real**2 + change.imag**2 - 4.0 * noise2, noise2)
