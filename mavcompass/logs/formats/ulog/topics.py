"""Times and vectors out of topics."""

from __future__ import annotations

from typing import Any

import numpy as np

from mavcompass.frames import FloatArray

_MICRO = 1.0e-6


def time_s(data: Any) -> FloatArray:
    """Return when the samples were taken, seconds since boot, (N,): of the sample where it is logged."""
    fields = data.data
    stamp = fields["timestamp_sample"] if "timestamp_sample" in fields else fields["timestamp"]
    if not np.asarray(stamp).any():
        stamp = fields["timestamp"]
    return np.asarray(stamp, dtype=np.float64) * _MICRO


def has(data: Any, *names: str) -> bool:
    """Tell whether a topic has all these fields."""
    return all(name in data.data for name in names)


def vector(data: Any, *names: str) -> FloatArray:
    """Return fields as (N,) or, for several, (N, k)."""
    found = [np.asarray(data.data[name], dtype=np.float64) for name in names]
    return found[0] if len(found) == 1 else np.stack(found).T


def indexed(stem: str, count: int = 3) -> tuple[str, ...]:
    """Spell an array's fields: 'q' is q[0], q[1], ..."""
    return tuple(f"{stem}[{number}]" for number in range(count))
