"""Fits to all readings: MAGFit (the web tool), rebuilt from what is documented of it, and the textbook's.

Linear least squares of the world model's field, turned by the autopilot's attitude, against the readings: 80
bins of direction weigh alike; offsets, offsets and scale, offsets and iron, each with the battery's current
where it was recorded. A fit out of range (offsets 1500 mG, diagonals 0.8 to 1.2, off-diagonals 0.2, scale 0.8
to 1.2) is greyed out. Taken is the one with the smallest error left, as its bar chart suggests.

The textbook's is the quadric with the least algebraic error, and its symmetric root.
"""

from __future__ import annotations

import math

import numpy as np

from compassbench.cases import Case, columns, matrices
from compassbench.rivals import F, Named, Refusal, Solution

BINS = 80


def weights(direction: F) -> F:
    """Return a weight for each reading so that the bins of direction that were met count alike."""
    k = np.arange(BINS) + 0.5
    z, around = 1.0 - 2.0 * k / BINS, math.pi * (1.0 + math.sqrt(5.0)) * k
    bins = np.stack([np.sqrt(1 - z * z) * np.cos(around), np.sqrt(1 - z * z) * np.sin(around), z], axis=1)
    nearest = (direction @ bins.T).argmax(axis=1)
    counts = np.bincount(nearest, minlength=BINS)
    return counts[counts > 0].mean() / counts[nearest]


NAMES = {0: {"hard_iron"}, 1: {"hard_iron", "axis_scale"}, 6: {"hard_iron", "soft_iron"}}


def solve(case: Case, argument: str = "") -> Solution | Named:
    """Fit all and take the best that is in range; or name the one that a person would; or do the textbook's.

    A person's is the one with the least error and the fewest numbers (BIC), against none at all.
    """
    if argument == "ellipsoid":
        return ellipsoid(case)
    sine, cosine = (columns(case.mag_time, case.time, f(case.attitude)) for f in (np.sin, np.cos))
    expected = matrices(np.arctan2(sine, cosine)).swapaxes(1, 2) @ case.world
    load = None if case.current is None else np.interp(case.mag_time, case.time, case.current)
    weight = np.repeat(np.sqrt(weights(expected / np.linalg.norm(expected, axis=1)[:, np.newaxis])), 3)
    fits = []
    for iron in (0, 1, 6):
        for motor in (False, True) if load is not None else (False,):
            if (found := _fit(case.mag, expected, weight, iron, load if motor else None)) is not None:
                fits.append(
                    (*found, 3 + iron + 3 * motor, NAMES[iron] | ({"motor_current"} if motor else set()))
                )
    if argument == "gap":
        plain = math.sqrt(float((((expected - case.mag).ravel() * weight) ** 2).mean()))
        fits.append((plain, Solution(np.zeros(3)), 0, set()))
        # Ten readings a second are no ten looks: a look a second.
        looks = 3.0 * case.mag_time[-1]
        best = min(fits, key=lambda fit: 2.0 * looks * math.log(fit[0]) + fit[2] * math.log(looks))
        return Named(frozenset(best[3]))
    if not fits:
        raise Refusal("every fit is out of range")
    return min(fits, key=lambda fit: fit[0])[1]


def _fit(raw: F, expected: F, weight: F, iron: int, load: F | None) -> tuple[float, Solution] | None:
    count = len(raw)
    parts = [np.tile(np.eye(3), (count, 1))]
    target = expected.ravel()
    x, y, z = raw.T
    o = np.zeros(count)
    if iron == 6:
        for trio in ((x, o, o), (o, y, o), (o, o, z), (y, x, o), (z, o, x), (o, z, y)):
            parts.append(np.stack(trio, axis=1).reshape(-1, 1))
    elif iron == 1:
        parts.append(raw.reshape(-1, 1))
    else:
        target = target - raw.ravel()
    if load is not None:
        parts.append((load[:, np.newaxis, np.newaxis] * np.eye(3)).reshape(-1, 3))
    design = np.hstack(parts)
    p = np.linalg.lstsq(design * weight[:, np.newaxis], target * weight, rcond=None)[0]
    left = math.sqrt(float((((design @ p - target) * weight) ** 2).mean()))
    matrix = np.eye(3)
    if iron == 1:
        matrix *= p[3]
    if iron == 6:
        matrix = np.array([[p[3], p[6], p[7]], [p[6], p[4], p[8]], [p[7], p[8], p[5]]])
    scale = np.trace(matrix) / 3.0
    shape = matrix / scale if scale else matrix
    if not 0.8 <= scale <= 1.2 or np.abs(np.diag(shape) - 1.0).max() > 0.2:
        return None
    offset = np.linalg.solve(matrix, p[:3])
    if np.abs(shape[np.triu_indices(3, 1)]).max() > 0.2 or np.abs(offset).max() > 1500.0:
        return None
    return left, Solution(offset, matrix, np.zeros(3) if load is None else p[-3:])


def ellipsoid(case: Case) -> Solution:
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
