"""Vectors of three as tuples: for single ones numpy's calls take longer than the sums."""

from __future__ import annotations

import math

Vector = tuple[float, float, float]


def dot(a: Vector, b: Vector) -> float:
    """Return the product of two vectors."""
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]


def cross(a: Vector, b: Vector) -> Vector:
    """Return the cross product."""
    return (a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0])


def turn_row(row: Vector, turn: Vector, s: float, k: float) -> Vector:
    """Turn a row by Rodrigues' formula, with these two factors of the turn's cross product and its square."""
    (x, y, z), (p, q, r) = row, turn
    a, b, c = y * r - z * q, z * p - x * r, x * q - y * p
    return (
        x + s * a + k * (b * r - c * q),
        y + s * b + k * (c * p - a * r),
        z + s * c + k * (a * q - b * p),
    )


def squared(x: Vector, y: Vector) -> tuple[Vector, Vector, Vector]:
    """Make two rows a rotation's, the first keeping its direction, and add the third."""
    (a, b, c), (d, e, f) = x, y
    length = math.sqrt(a * a + b * b + c * c) or 1.0
    a, b, c = a / length, b / length, c / length
    along = a * d + b * e + c * f
    d, e, f = d - along * a, e - along * b, f - along * c
    length = math.sqrt(d * d + e * e + f * f) or 1.0
    d, e, f = d / length, e / length, f / length
    return (a, b, c), (d, e, f), (b * f - c * e, c * d - a * f, a * e - b * d)


def middle(a: Vector, b: Vector) -> Vector:
    """Return the mean of two."""
    return (0.5 * (a[0] + b[0]), 0.5 * (a[1] + b[1]), 0.5 * (a[2] + b[2]))


def bend2(a: Vector, b: Vector, c: Vector, d: Vector) -> float:
    """Return the mean square of the third difference over x and y."""
    x = a[0] - 3.0 * (b[0] - c[0]) - d[0]
    y = a[1] - 3.0 * (b[1] - c[1]) - d[1]
    return 0.5 * (x * x + y * y)
