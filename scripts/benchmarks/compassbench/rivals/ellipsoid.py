"""The ellipsoid fit of textbooks: the quadric with the least algebraic error, and its symmetric root."""

from __future__ import annotations

import numpy as np

from compassbench.cases import Case
from compassbench.rivals import Refusal, Solution


def solve(case: Case, argument: str = "") -> Solution:
    """Fit x'Ax + 2b'x = 1 and take the symmetric root of A; the world model tells the length."""
    scale = float(np.linalg.norm(case.world))
    x, y, z = (case.mag / scale).T
    design = np.stack([x * x, y * y, z * z, 2 * x * y, 2 * x * z, 2 * y * z, 2 * x, 2 * y, 2 * z], axis=1)
    a, b, c, ab, ac, bc, *linear = np.linalg.lstsq(design, np.ones(x.size), rcond=None)[0]
    quadric = np.array([[a, ab, ac], [ab, b, bc], [ac, bc, c]])
    centre = -np.linalg.solve(quadric, linear)
    values, axes = np.linalg.eigh(quadric / (1.0 + centre @ quadric @ centre))
    if values.min() <= 0.0:
        raise Refusal("the quadric is no ellipsoid")
    return Solution(-centre * scale, axes @ np.diag(np.sqrt(values)) @ axes.T)
