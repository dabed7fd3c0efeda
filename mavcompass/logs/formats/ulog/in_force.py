"""What PX4 had done to `vehicle_magnetometer`: the calibration taken over, and a bias learnt on the ground.

Which of the parameters are inside the readings is not told by the parameters alone. PX4 takes a changed
calibration over only while it is disarmed, and not where it hardly changed; each time `calibration_count`
goes up. Besides, an estimator that runs on the ground subtracts a bias of its own, which stays in flight.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from mavcompass.compass_parameters import PX4_ANGLES
from mavcompass.frames import FloatArray
from mavcompass.logs.common import Change
from mavcompass.logs.formats.ulog.topics import has, time_s
from mavcompass.units import MGAUSS_PER_GAUSS

# The logger writes a changed parameter down a little before or after its calibration takes effect. What was
# written in flight takes none: on disarming, PX4 stores the calibration that it flew with over it.
_LOGGED_WITHIN_S, _LOADED_WITHIN_S = 1.0, 5.0


def taken_over(
    history: Sequence[Change], prefix: str, times_s: FloatArray, counts: np.ndarray[Any, Any]
) -> tuple[Change, ...]:
    """Move changes of one compass's calibration to when they were taken over; leave out those never taken.

    `prefix` is what the names of its parameters begin with; `counts` are the calibration's at `times_s`,
    (N,).
    What held before the recording, and the mounting, which has no count, stay as they are.
    """
    raised_s = times_s[1:][np.diff(counts.astype(np.int64)) != 0]
    uncounted = {f"{prefix}{quantity}" for quantity in ("ID", "PRIO", "ROT", *PX4_ANGLES)}
    out = []
    for change in history:
        counted = change.name.startswith(prefix) and change.name not in uncounted
        if not counted or not np.isfinite(change.from_s):
            out.append(change)
            continue
        after_s = raised_s - change.from_s
        later_s = raised_s[(after_s >= -_LOGGED_WITHIN_S) & (after_s <= _LOADED_WITHIN_S)]
        if later_s.size:
            out.append(replace(change, from_s=float(later_s[0])))
    return tuple(sorted(out, key=lambda change: change.from_s))


def estimated_bias_mgauss(
    topics: Mapping[str, Sequence[Any]],
    device_id: int | None,
    times_s: FloatArray,
    counts: np.ndarray[Any, Any],
) -> FloatArray:
    """Return the bias that was subtracted besides the calibration, body axes, (N, 3); 0 where none was."""
    bias = np.zeros((times_s.size, 3))
    raised_s = times_s[1:][np.diff(counts.astype(np.int64)) != 0]
    for data in topics.get("magnetometer_bias_estimate", ()):
        index = _index_of(topics, device_id)
        names = [f"bias_{axis}[{index}]" for axis in "xyz"]
        if not has(data, f"valid[{index}]", *names):
            continue
        valid = np.asarray(data.data[f"valid[{index}]"]) != 0
        said_s = time_s(data)[valid]
        said = np.stack([np.asarray(data.data[name], dtype=np.float64)[valid] for name in names], axis=1)
        last = np.searchsorted(said_s, times_s, side="right") - 1
        # A calibration that is taken over ends the bias that was learnt before it.
        began = np.searchsorted(raised_s, times_s, side="right") - 1
        since_s = np.where(began >= 0, raised_s[began] if raised_s.size else -np.inf, -np.inf)
        known = (last >= 0) & (said_s[last] > since_s if said_s.size else False)
        bias[known] = said[last[known]] * MGAUSS_PER_GAUSS
    return bias


def _index_of(topics: Mapping[str, Sequence[Any]], device_id: int | None) -> int:
    """Return the place of a sensor among all: `sensor_mag` numbers them."""
    for data in topics.get("sensor_mag", ()):
        ids = data.data.get("device_id")
        if ids is not None and len(ids) and int(ids[0]) == device_id:
            return int(data.multi_id)
    return 0
