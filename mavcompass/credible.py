"""What no sensor can say is not a reading: it is left out of a track, and the user is told.

A number in a file or on a link may be any: a damaged byte, an estimator that diverged, a sensor at its end.
Readers and the live builder hand such numbers on; each track passes through `with_credible_readings` once.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
from numpy.typing import ArrayLike, NDArray

from mavcompass.frames import FloatArray, euler_to_quaternion, matrix_to_euler, quaternion_to_matrix
from mavcompass.track import Series, Track

# The largest number of each quantity in the Track's unit. Of a sensor it is twice the widest range of those
# that autopilots read, as a calibration's scale and offset come on top: AK09916 49 G, ADIS16507 40 g,
# ICM-45686 4000 deg/s, hall sensors 1000 A, thermometers 150 degrees, receivers 500 m/s.
_LARGEST: dict[str, float | tuple[float, ...]] = {
    **{"compass": 98_240.0, "acc_mps2": 785.0, "gyro_radps": 140.0, "current_a": 2_000.0},
    "voltage_v": 1_000.0,
    **{"temperature_degc": 300.0, "gps_velocity_mps": 1_000.0, "receiver_velocity_mps": 1_000.0},
    # An angle may be one that was never wrapped; beyond this a float's step is a hundredth of a radian.
    **{"attitude_rad": 1e5, "gps_yaw_rad": 1e5},
    # Of unit length, but for its rounding.
    **{"reference_q": 2.0, "truth_q": 2.0},
    # A plane that touches the Earth is of no use farther away.
    **{"position_ned_m": 1e6, "place": (90.0, 360.0, 1e6)},
    # Shares; a table may hold percents or the widths of pulses in its place.
    **{"throttle": 65_535.0, "motors": 65_535.0},
}
# The autopilot's attitude rests on it: one that says nothing else is not one that was not recorded.
_RESTED_ON = ("acc_mps2",)
_INT16 = np.iinfo(np.int16)
# Less is no field on Earth.
_SILENT_MGAUSS = 20.0
SILENT = "Compass {} reads only its offsets: the sensor itself is silent or not connected."


def is_silent(raw_mgauss: FloatArray) -> bool:
    """Tell whether readings (N, 3) without their corrections are none."""
    return float(np.linalg.norm(np.median(raw_mgauss, axis=0))) < _SILENT_MGAUSS


def incredible(quantity: str, values: FloatArray) -> NDArray[np.bool_]:
    """Tell which samples (N,) or (N, k) of a column of Track no sensor can say, (N,); nan is none of them."""
    beyond = np.abs(values) > _LARGEST[quantity]
    return np.asarray(beyond if beyond.ndim == 1 else beyond.any(axis=1))


def converted(quantity: str, values: FloatArray, by: Callable[[FloatArray], FloatArray]) -> FloatArray:
    """Convert samples of a quantity; those that no sensor can say become infinite, to be left out later."""
    with np.errstate(invalid="ignore", over="ignore"):
        out = np.array(by(values))
    out[incredible(quantity, values)] = np.inf
    return out


def quaternions_of(angles_rad: FloatArray) -> FloatArray:
    """Turn roll, pitch, yaw (N, 3) into quaternions (N, 4)."""
    return converted("attitude_rad", angles_rad, lambda angles: euler_to_quaternion(*angles.T))


def angles_of(quaternions: FloatArray) -> FloatArray:
    """Turn quaternions (N, 4) into roll, pitch, yaw (N, 3)."""
    return converted("truth_q", quaternions, lambda q: np.stack(matrix_to_euler(quaternion_to_matrix(q))).T)


def turned_field(field_mgauss: FloatArray, rotation: FloatArray) -> FloatArray:
    """Turn readings of a compass (N, 3) by a rotation (3, 3)."""
    return converted("compass", field_mgauss, lambda field: field @ rotation.T)


def open_ended(sixteen_bits: ArrayLike) -> FloatArray:
    """Read signed whole numbers; one at an end of its type's range says "this or more": infinite."""
    numbers = np.asarray(sixteen_bits, dtype=np.float64)
    return np.where((numbers == _INT16.max) | (numbers == _INT16.min), np.inf, numbers)


def with_credible_readings(track: Track) -> Track:
    """Return the track, or one without what no sensor can say; the notes tell how much it was."""
    notes: list[str] = []

    def credible(name: str, series: Series) -> Series | None:
        out = incredible(name.partition(" ")[0], series.values)
        count = int(np.count_nonzero(out))
        if not count:
            return series
        quantity = name.rpartition("_")[0] or name
        of = f"{count} of {out.size} readings of {quantity}"
        notes.append(f"Left out {of}: their numbers are beyond what any sensor can say.")
        kept = Series.of(series.time_s[~out], series.values[~out])
        return kept if len(kept) or name in _RESTED_ON else None

    kept = track.with_columns(credible)
    return replace(kept, notes=(*track.notes, *notes)) if notes else track
