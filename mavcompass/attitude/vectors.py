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


def turned_frame(x: Vector, y: Vector, turn: Vector) -> tuple[Vector, Vector, Vector]:
    """Turn a rotation's rows by a small one of the body, in body axes, by Rodrigues' formula."""
    angle2 = dot(turn, turn)
    s, k = 1.0 - angle2 / 6.0, 0.5 - angle2 / 24.0
    return squared(_turned(x, turn, s, k), _turned(y, turn, s, k))


def _turned(row: Vector, turn: Vector, s: float, k: float) -> Vector:
    (x, y, z), (p, q, r) = row, turn
    a, b, c = y * r - z * q, z * p - x * r, x * q - y * p
    return (
        x + s * a + k * (b * r - c * q),
        y + s * b + k * (c * p - a * r),
        z + s * c + k * (a * q - b * p),
    )


def middle(a: Vector, b: Vector) -> Vector:
    """Return the mean of two."""
    return (0.5 * (a[0] + b[0]), 0.5 * (a[1] + b[1]), 0.5 * (a[2] + b[2]))


def bend2(a: Vector, b: Vector, c: Vector, d: Vector) -> float:
    """Return the mean square of the third difference over x and y."""
    x = a[0] - 3.0 * (b[0] - c[0]) - d[0]
    y = a[1] - 3.0 * (b[1] - c[1]) - d[1]
    return 0.5 * (x * x + y * y)


def changed2(a: Vector, b: Vector, down: Vector) -> tuple[float, float]:
    """Return the square of a change, of each horizontal part and of the vertical one."""
    x, y, z = b[0] - a[0], b[1] - a[1], b[2] - a[2]
    vertical = x * down[0] + y * down[1] + z * down[2]
    return 0.5 * (x * x + y * y + z * z - vertical * vertical), vertical * vertical
