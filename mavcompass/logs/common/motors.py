"""Motor outputs as fractions, from the pulse widths of a vehicle's outputs."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
from numpy.typing import ArrayLike, NDArray

from mavcompass.credible import incredible
from mavcompass.frames import FloatArray

# SERVOn_FUNCTION: motors 1 to 8 and 9 to 12, throttle, throttle left and right.
_MOTOR_FUNCTIONS = (*range(33, 41), *range(82, 86), 70, 73, 74)
_LOWEST_US, _HIGHEST_US = 1000.0, 2000.0


def motor_outputs(pulse_us: ArrayLike, parameters: Mapping[str, float]) -> FloatArray | None:
    """Turn pulse widths (N, outputs), microseconds, into motor outputs 0..1, (N, motors).

    The parameters tell which outputs are motors and their range; where they do not, every output that
    is in use counts, from 1000 to 2000. An output without pulses (0) is at rest. None without motors.
    """
    pulses = np.asarray(pulse_us)
    numbers = range(1, pulses.shape[1] + 1)
    functions = {n: int(parameters.get(f"SERVO{n}_FUNCTION", -1)) for n in numbers}
    if any(f >= 0 for f in functions.values()):
        wanted = [n for n in numbers if functions[n] in _MOTOR_FUNCTIONS]
        wanted.sort(key=lambda n: _MOTOR_FUNCTIONS.index(functions[n]))
    else:
        wanted = [n for n in numbers if bool(pulses[:, n - 1].any())]
    if not wanted or not len(pulses):
        return None
    out = np.empty((len(pulses), len(wanted)), order="F")
    for column, n in enumerate(wanted):
        out[:, column] = _fraction(pulses[:, n - 1], n, parameters)
    out[incredible("motors", pulses)] = np.inf
    return out


def _fraction(pulse_us: NDArray[np.generic], number: int, parameters: Mapping[str, float]) -> FloatArray:
    low = float(parameters.get(f"SERVO{number}_MIN", _LOWEST_US))
    high = float(parameters.get(f"SERVO{number}_MAX", _HIGHEST_US))
    if not high > low:
        low, high = _LOWEST_US, _HIGHEST_US
    pulses = pulse_us.astype(np.float64)
    fraction = np.clip((pulses - low) / (high - low), 0.0, 1.0)
    if parameters.get(f"SERVO{number}_REVERSED", 0.0):
        fraction = 1.0 - fraction
    return np.where(pulses > 0.0, fraction, 0.0)
