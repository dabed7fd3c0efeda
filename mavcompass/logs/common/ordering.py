"""Bring the samples of one quantity into the order of time, and leave out what is no number."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from mavcompass.frames import FloatArray
from mavcompass.track import Series


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


def spoken(field: Series | None) -> tuple[Series | None, int]:
    """Leave out readings of a field that are zero on every axis, as none is: the compass said nothing then.

    Return the others, None where there is none, and how many were left out.
    """
    if field is None:
        return None, 0
    said = field.values.any(axis=1)
    silent = int(said.size - np.count_nonzero(said))
    if not silent:
        return field, 0
    return (Series.of(field.time_s[said], field.values[said]) if silent < said.size else None), silent


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
