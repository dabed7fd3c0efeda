"""Whether an accelerometer shows gravity; else neither it nor an attitude that rests on it tells the level.

Vibration averages out over half a second, and what felt half of gravity, or twice, for longer than some
seconds would change its velocity by more than vehicles do. What is far from gravity throughout is no specific
force: it is of a sensor that is dead, or stands at the end of its range, or in another unit.
"""

from __future__ import annotations

import numpy as np

from mavcompass.errors import BadRecording, PoorCalibration
from mavcompass.track import Series
from mavcompass.units import STANDARD_GRAVITY_MPS2

_PIECE_S = 0.5
# In shares of gravity. 130 recordings of flights, drives and hands show 0.77 to 1.16; sensors as they are
# delivered are within a tenth.
_LEAST, _MOST = 0.5, 2.0
REMEDY = "Check the accelerometer and its setup; in a file of columns, its unit (m/s2)."


def is_gravity(force_mps2: float) -> bool:
    """Tell whether the length of a mean specific force can be gravity's; False for nan."""
    return _LEAST < force_mps2 / STANDARD_GRAVITY_MPS2 < _MOST


def no_gravity(acc: Series | None) -> str:
    """Say what is wrong where an accelerometer shows no gravity; empty where it does, or has no number.

    A series without readings is of one that said nothing that any sensor can say.
    """
    if acc is not None and not len(acc):
        return "The accelerometer's numbers are beyond any sensor's throughout: nothing tells what is level."
    finite = np.zeros(0, dtype=bool) if acc is None else np.isfinite(acc.values).all(axis=1)
    if acc is None or not finite.any():
        return ""
    values = np.asarray(acc.values)[finite]
    first = np.flatnonzero(np.diff(acc.time_s[finite] // _PIECE_S, prepend=-np.inf))
    count = np.diff(first, append=len(values))
    means = np.add.reduceat(values, first, axis=0) / count[:, np.newaxis]
    force_mps2 = float(np.median(np.linalg.norm(means, axis=1)))
    if is_gravity(force_mps2):
        return ""
    shown = f"shows {force_mps2:.3g} m/s2 throughout" if force_mps2 else "was not recorded, or dead (0 m/s2)"
    gravity = f"where gravity is {STANDARD_GRAVITY_MPS2:.1f}: nothing tells what is level."
    return f"The accelerometer {shown}, {gravity}"


def require_gravity(acc: Series | None, error: type[BadRecording | PoorCalibration] = BadRecording) -> None:
    """Raise an error where an accelerometer shows no gravity."""
    if trouble := no_gravity(acc):
        raise error(trouble, REMEDY)
