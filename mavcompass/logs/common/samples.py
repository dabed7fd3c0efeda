"""The samples of one quantity: in order of time, without what is no number; motors as fractions."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from itertools import islice
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from mavcompass.credible import incredible
from mavcompass.frames import FloatArray
from mavcompass.printable import printable
from mavcompass.track import Series

# SERVOn_FUNCTION: motors 1 to 8 and 9 to 12, throttle, throttle left and right.
_OF_MIXER = (*range(33, 41), *range(82, 86))
_MOTOR_FUNCTIONS = (*_OF_MIXER, 70, 73, 74)
_LOWEST_US, _HIGHEST_US = 1000.0, 2000.0
_MOST_TEXTS = 1000  # an hour of flight has some fifty


def finite_series(time_s: FloatArray, values: FloatArray) -> Series | None:
    """Build a series of the samples that are numbers, in order of time; None where there is none.

    `values` is (N,) or (N, k). An estimator that has not started gives nan; what is infinite stays in, for
    `with_credible_readings` to leave out and to tell of.
    """
    rows = values[:, np.newaxis] if values.ndim == 1 else values
    numbers = ~np.isnan(rows).any(axis=1) | np.isinf(rows).any(axis=1)
    if not bool(numbers.any()):
        return None
    if not bool(numbers.all()):
        time_s, values = time_s[numbers], values[numbers]
    return Series.of(time_s, values)


def spoken(field: Series | None, instance: int) -> tuple[Series | None, list[str]]:
    """Leave out readings of a compass that are zero on every axis, as none is: it said nothing then.

    Return the others, None where there is none, and what to tell of those left out.
    """
    if field is None:
        return None, []
    said = field.values.any(axis=1)
    silent = int(said.size - np.count_nonzero(said))
    if not silent:
        return field, []
    if silent == said.size:
        return None, []
    of = f"{silent} of {said.size} readings"
    note = f"Compass {instance} said nothing (zero on every axis) in {of}: left out."
    return Series.of(field.time_s[said], field.values[said]), [note]


def in_order(time_s: FloatArray, rows: Any, *, own_time: bool = True) -> tuple[FloatArray, Any, int]:
    """Sort times and record rows by time; leave out repeats (same time, same bytes), and count them.

    A radio link delivers late and twice; a log that merges two links holds everything twice. Without
    `own_time` the times were found from outside, and tell nothing of repeats.
    """
    steps = np.diff(time_s)
    if bool((steps > 0.0).all()):
        return time_s, rows, 0
    if bool((steps < 0.0).any()):
        order = np.argsort(time_s, kind="stable")
        time_s, rows = time_s[order], rows[order]
        steps = np.diff(time_s)
    if not own_time:
        return time_s, rows, 0
    fresh = _fresh(steps, rows)
    repeats = int(fresh.size - np.count_nonzero(fresh))
    return (time_s[fresh], rows[fresh], repeats) if repeats else (time_s, rows, 0)


def _fresh(steps: FloatArray, rows: Any) -> NDArray[np.bool_]:
    """Tell which rows are not a repeat of an earlier one of the same time."""
    fresh = np.ones(rows.size, dtype=bool)
    edges = np.flatnonzero(np.concatenate([[True], steps > 0.0, [True]]))
    lengths = np.diff(edges)
    for first, count in zip(edges[:-1][lengths > 1], lengths[lengths > 1], strict=True):
        heard: set[bytes] = set()
        for index in range(int(first), int(first + count)):
            content = rows[index].tobytes()
            fresh[index] = content not in heard
            heard.add(content)
    return fresh


def motor_outputs(pulse_us: ArrayLike, parameters: Mapping[str, float]) -> FloatArray | None:
    """Turn pulse widths (N, outputs), microseconds, into motor outputs 0..1, (N, motors).

    The parameters tell which outputs are motors and their range; where they do not, every output that
    is in use counts, from 1000 to 2000. An output without pulses (0) is at rest. None without motors.
    Those of a mixer have the range of MOT_PWM_MIN and MAX (AP_MotorsMulticopter, update_throttle_range), or
    their own as others.
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
        mixed = functions[n] in _OF_MIXER and parameters.get("MOT_PWM_MAX", 0.0) > 0.0
        names = [f"SERVO{n}_{what}" for what in ("MIN", "MAX", "REVERSED")]
        names = ["MOT_PWM_MIN", "MOT_PWM_MAX", ""] if mixed else names
        out[:, column] = _fraction(pulses[:, n - 1], names, parameters)
    out[incredible("motors", pulses)] = np.inf
    return out


def _fraction(pulse_us: NDArray[np.generic], names: Sequence[str], told: Mapping[str, float]) -> FloatArray:
    low, high, turned = map(told.get, names, (_LOWEST_US, _HIGHEST_US, 0.0))
    if not high > low:
        low, high = _LOWEST_US, _HIGHEST_US
    pulses = pulse_us.astype(np.float64)
    fraction = np.clip((pulses - low) / (high - low), 0.0, 1.0)
    if turned:
        fraction = 1.0 - fraction
    return np.where(pulses > 0.0, fraction, 0.0)


def texts_said(texts: Iterable[bytes]) -> tuple[str, ...]:
    """Return what an autopilot said, fit to be printed, each text once, the earliest first."""
    spelt = (printable(text.rstrip(b"\0").decode("ascii", "replace").strip()) for text in texts)
    return tuple(islice(dict.fromkeys(filter(None, spelt)), _MOST_TEXTS))
