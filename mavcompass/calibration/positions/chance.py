"""What chance alone does: the tail of the chi-square distribution, in closed form.

scipy has it too, and takes half a second to load: while a vehicle stands still and waits for its solution.
"""

from __future__ import annotations

import math


def chance_of_more(chi_square: float, freedom: int) -> float:
    """Return the probability that chance alone gives a larger chi-square; 1 without degrees of freedom.

    Abramowitz and Stegun, 26.4.4 and 26.4.5.
    """
    if freedom <= 0:
        return 1.0
    half = 0.5 * max(chi_square, 0.0)
    odd = freedom % 2
    total = math.erfc(math.sqrt(half)) if odd else 0.0
    # The terms half^a / Gamma(a + 1), a = 0, 1, .. or 1/2, 3/2, ..; by logarithms, so that none overflows.
    for k in range(freedom // 2):
        a = k + 0.5 * odd
        power = a * math.log(half) if half > 0.0 else (0.0 if a == 0.0 else -math.inf)
        total += math.exp(power - half - math.lgamma(a + 1.0))
    return min(total, 1.0)
