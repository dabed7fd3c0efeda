"""The four-position calibration at its best: still positions found or chosen, fitted, judged."""

from __future__ import annotations

import numpy as np

from mavcompass.calibration.judged import calibrate_positions
from mavcompass.calibration.observation import FourPositionData, assemble, dwell_between, observe, turn_record
from mavcompass.calibration.recorded import Recorded
from mavcompass.calibration.result import CalibrationResult
from mavcompass.earth_field import earth_field_of
from mavcompass.frames import FloatArray


def calibrate(recorded: Recorded) -> CalibrationResult:
    """Calibrate from the recording's still positions and the gyro's turns between them."""
    data = _observed(recorded)
    return calibrate_positions(
        data,
        recorded.in_force,
        recorded.earth,
        recorded.instance,
        recorded.limits,
        recorded.prior,
        _references(recorded, data),
    )


def _observed(recorded: Recorded) -> FourPositionData:
    track, instance = recorded.track, recorded.instance
    if recorded.windows is None:
        return observe(track, instance)
    record = turn_record(track, instance)
    dwells = [dwell_between(track, instance, start, end, record) for start, end in recorded.windows]
    return assemble(track, dwells, instance, record)


def _references(recorded: Recorded, data: FourPositionData) -> FloatArray | None:
    """Return the dwells' magnetic headings by GPS yaw, (K,); None where the recording has none."""
    yaw = recorded.track.gps_yaw_rad
    world = earth_field_of(recorded.track)
    if yaw is None or not len(yaw) or world is None:
        return None
    middles = np.array([0.5 * (d.start_s + d.end_s) for d in data.dwells])
    nearest = np.clip(np.searchsorted(yaw.time_s, middles), 0, len(yaw) - 1)
    headings = yaw.values[nearest] - world.declination_rad
    return np.where(np.abs(yaw.time_s[nearest] - middles) < 2.0, headings, np.nan)
