"""Is a compass mounted turned, rather than badly calibrated?

Iron and gains, which a calibration cures, change the length of the field or of its level part. What one of
the rotations that the autopilots know takes back, at each position, is the mounting.
"""

from __future__ import annotations

from collections.abc import Sequence
from functools import cache

import numpy as np
from numpy.typing import ArrayLike

from mavcompass.correction import IDENTITY, FieldCorrection
from mavcompass.frames import NUMBERED, SENSOR_ORIENTATIONS_DEG, FloatArray, nearest

# Of the field's length: what two sound compasses may differ by, 3 deg and 5 %.
_FITS = 0.08
# A mounting that is no rotation at all leaves at least so many times as much; the next best one too, where
# one position tells which rotation it is.
_CLEARLY = 3.0

Turned = tuple[float, float, float]


def turned_by(
    fields_mgauss: ArrayLike, expected_mgauss: ArrayLike, in_force: FieldCorrection = IDENTITY
) -> Sequence[Turned]:
    """List the rotations (roll, pitch, yaw in degrees) that make a compass's field what it should be.

    `fields_mgauss`, `expected_mgauss` (K, 3): corrected by what is `in_force`, in body axes, at K positions.
    The correction in force may be of the mounting as it is, or as it should be. Empty where the compass is
    not turned: what it sees is about right, or no rotation explains it.
    """
    fields, expected = np.atleast_2d(fields_mgauss), np.atleast_2d(expected_mgauss)
    numbers, rotations = _rotations()
    length = float(np.linalg.norm(expected, axis=1).mean())
    as_it_is = fields @ rotations.transpose(0, 2, 1)
    as_it_should_be = in_force.apply(in_force.undo(fields) @ rotations.transpose(0, 2, 1))
    left = np.minimum(*(_farthest(turned - expected) for turned in (as_it_is, as_it_should_be))) / length
    best = max(float(left.min()), _FITS / _CLEARLY)
    if left.min() > _FITS or left[0] < _CLEARLY * best:
        return ()
    near = np.flatnonzero(left < _CLEARLY * best)
    return [SENSOR_ORIENTATIONS_DEG[numbers[i]] for i in near[np.argsort(left[near])]]


def _farthest(off_mgauss: FloatArray) -> FloatArray:
    return np.asarray(np.linalg.norm(off_mgauss, axis=2).max(axis=1))


@cache
def _rotations() -> tuple[tuple[int, ...], FloatArray]:
    """Return each different rotation once, under its lowest number; none at all is the first."""
    numbers = tuple(sorted({nearest(one, NUMBERED)[0] for one in NUMBERED.values()}))
    return numbers, np.stack([NUMBERED[number] for number in numbers])
