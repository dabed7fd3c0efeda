"""The fit of a firmware's own compass calibration: readings apart from each other, and their ellipsoid."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from mavcompass.correction import FieldCorrection, Vector

Array = NDArray[np.float64]
_SECTIONS = 80
# Directions spread evenly over the sphere by the golden angle, each the middle of a section.
_HEIGHT = 1.0 - (2.0 * np.arange(_SECTIONS) + 1.0) / _SECTIONS
_ANGLE = np.arange(_SECTIONS) * math.pi * (3.0 - math.sqrt(5.0))
_MIDDLES = np.stack(
    [np.sqrt(1.0 - _HEIGHT**2) * np.cos(_ANGLE), np.sqrt(1.0 - _HEIGHT**2) * np.sin(_ANGLE), _HEIGHT], axis=1
)


class TurnedReadings:
    """Collect raw readings, milligauss, no nearer to each other than a distance."""

    def __init__(self) -> None:
        self.readings: Array = np.zeros((0, 3))

    def __len__(self) -> int:
        """Count them."""
        return len(self.readings)

    def take(self, reading: Vector, apart_mgauss: float) -> bool:
        """Take a reading; False where it is too near to another."""
        if len(self) and float(np.linalg.norm(self.readings - reading, axis=1).min()) < apart_mgauss:
            return False
        self.readings = np.vstack([self.readings, reading])
        return True

    def thin(self, apart_mgauss: float) -> None:
        """Drop readings that are nearer to another than that."""
        kept, self.readings = self.readings, np.zeros((0, 3))
        for reading in kept:
            self.take(reading, apart_mgauss)

    def centre(self) -> tuple[Array, float]:
        """Return centre and radius of the sphere through them: |r|^2 = 2 c r + (R^2 - c^2)."""
        r = self.readings
        design = np.hstack([2.0 * r, np.ones((len(r), 1))])
        found = np.linalg.lstsq(design, (r**2).sum(axis=1), rcond=None)[0]
        return found[:3], math.sqrt(max(float(found[3] + found[:3] @ found[:3]), 1.0))

    def fit(self) -> tuple[FieldCorrection, float, float] | None:
        """Return what makes a sphere of them, its radius and the rms that is left; None for no ellipsoid.

        A quadric r'Q r + 2 u'r = 1 about the readings' middle, by linear least squares; |M (r - c)| = R.
        """
        middle, radius = self.centre()
        x, y, z = ((self.readings - middle) / radius).T
        design = np.stack([x * x, y * y, z * z, 2 * x * y, 2 * x * z, 2 * y * z, 2 * x, 2 * y, 2 * z], axis=1)
        a, b, c, d, e, f, *u = np.linalg.lstsq(design, np.ones(len(x)), rcond=None)[0]
        quadric = np.array([[a, d, e], [d, b, f], [e, f, c]])
        values, axes = np.linalg.eigh(quadric)
        if values[0] <= 0.0:
            return None
        shift = -np.linalg.solve(quadric, u)
        stretch = axes @ np.diag(np.sqrt(values / (1.0 + shift @ quadric @ shift))) @ axes.T
        correction = FieldCorrection.from_matrix(-(middle + radius * shift), 0.5 * (stretch + stretch.T))
        length = np.linalg.norm(correction.apply(self.readings), axis=1)
        return correction, radius, float(np.sqrt(((length - radius) ** 2).mean()))

    def sections(self, centre: Array) -> int:
        """Return which of the sphere's sections hold a reading, seen from a centre, as bits."""
        ahead = (self.readings - centre) @ _MIDDLES.T
        return sum(1 << int(k) for k in np.unique(ahead.argmax(axis=1))) if len(self) else 0
