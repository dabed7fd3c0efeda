"""What chance alone does: tails and quantiles of chi-square and Student's t, in closed form.

scipy has them too, and takes a quarter of a second to load, more than most diagnoses need for all else:
half a second on the vehicle, while it stands still and waits for its solution.
"""

from __future__ import annotations

import math
from collections.abc import Callable


def chance_of_more(chi_square: float, freedom: int) -> float:
    """Return the probability that chance alone gives a larger chi-square; 1 without degrees of freedom.

    Abramowitz and Stegun, 26.4.4 and 26.4.5.
    """
    if freedom <= 0:
        return 1.0
    if math.isinf(chi_square):
        return 0.0
    half = 0.5 * max(chi_square, 0.0)
    odd = freedom % 2
    total = math.erfc(math.sqrt(half)) if odd else 0.0
    # The terms half^a / Gamma(a + 1), a = 0, 1, .. or 1/2, 3/2, ..; by logarithms, so that none overflows.
    for k in range(freedom // 2):
        a = k + 0.5 * odd
        power = a * math.log(half) if half > 0.0 else (0.0 if a == 0.0 else -math.inf)
        total += math.exp(power - half - math.lgamma(a + 1.0))
    return min(total, 1.0)


def chi_square_of(chance: float, freedom: int) -> float:
    """Return the chi-square that chance alone exceeds with a probability, 0 < chance < 1."""
    high = 1.0
    while chance_of_more(high, freedom) > chance:
        high *= 2.0
    return _where(lambda x: chance_of_more(x, freedom) < chance, high)


def chance_above(normal: float) -> float:
    """Return the probability that a standard normal value is larger."""
    return 0.5 * math.erfc(normal / math.sqrt(2.0))


def students_t(share: float, freedom: int) -> float:
    """Return the point below which a share of Student's t lies, 0.5 <= share < 1.

    Abramowitz and Stegun, 26.7.3 and 26.7.4, of the angle whose tangent is t / sqrt(freedom).
    """

    def within(angle: float) -> float:
        """Return the probability of a smaller absolute value."""
        sine, cosine = math.sin(angle), math.cos(angle)
        odd = freedom % 2
        term, total = (cosine if odd else 1.0), 0.0
        for k in range(1 + odd, freedom, 2):
            total += term
            term *= cosine * cosine * k / (k + 1.0)
        return 2.0 / math.pi * (angle + sine * total) if odd else sine * total

    wanted = 2.0 * share - 1.0
    return math.sqrt(freedom) * math.tan(_where(lambda angle: within(angle) > wanted, 0.5 * math.pi))


def _where(past: Callable[[float], bool], high: float) -> float:
    """Return the place between 0 and `high` from which on something holds, as exactly as numbers are."""
    low = 0.0
    while low < (middle := 0.5 * (low + high)) < high:
        low, high = (low, middle) if past(middle) else (middle, high)
    return high


def wilson(hits: int, of: int) -> tuple[float, float]:
    """Return Wilson's 95 % interval of a share."""
    if of == 0:
        return (0.0, 1.0)
    z, p = 1.96, hits / of
    middle = (p + z * z / (2 * of)) / (1 + z * z / of)
    half = z / (1 + z * z / of) * math.sqrt(p * (1 - p) / of + z * z / (4 * of * of))
    return (max(middle - half, 0.0), min(middle + half, 1.0))
