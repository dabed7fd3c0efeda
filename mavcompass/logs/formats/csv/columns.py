"""The columns of a Track CSV and the quantities of a Track that they hold."""

from __future__ import annotations

_AXES = ("x", "y", "z")
MOTORS = tuple(f"motor{n}" for n in range(1, 9))
# Quantity of the Track -> its columns in the file, in their order.
VECTORS: dict[str, tuple[str, ...]] = {
    "mag": tuple(f"mag_{a}_mgauss" for a in _AXES),
    "acc_mps2": tuple(f"acc_{a}_mps2" for a in _AXES),
    "gyro_radps": tuple(f"gyro_{a}_radps" for a in _AXES),
    "reference_q": ("ref_qw", "ref_qx", "ref_qy", "ref_qz"),
    "attitude_rad": ("roll_rad", "pitch_rad", "yaw_rad"),
    "position_ned_m": ("pos_n_m", "pos_e_m", "pos_d_m"),
    "place": ("lat_deg", "lon_deg", "alt_m"),
}
SCALARS: dict[str, str] = {
    "gps_yaw_rad": "gps_yaw_rad",
    "current_a": "current_a",
    "throttle": "throttle",
    "temperature_degc": "temperature_degc",
}
TIME = "time_s"
KNOWN = {TIME, *MOTORS, *SCALARS.values(), *(name for names in VECTORS.values() for name in names)}
