"""Real recordings with truth as cases, read without mavcompass: BROAD, and ArduPilot's firmware.

They lie outside the project, in the folder that MAVCOMPASS_SHARED_DATA names or ../shared/data beside it.
"""

from __future__ import annotations

import os
from pathlib import Path

import numpy as np

from compassbench.cases import Case, Truth
from compassbench.motions import F, columns

SHARED = Path(os.environ.get("MAVCOMPASS_SHARED_DATA") or Path(__file__).parents[4] / "shared" / "data")
FILES = {
    "real broad": [
        SHARED / "real" / "broad" / f"{name}.csv"
        for name in (
            "01_undisturbed_slow_rotation_A",
            "28_disturbed_stationary_magnet_A",
            "34_disturbed_attached_magnet_3cm",
        )
    ],
    "real firmware": [
        SHARED / "ardupilot-4.6.3" / f"{name}.BIN"
        for name in ("rover_plain", "rover_dist", "rover_dist_use2", "copter_dist_use2")
    ],
}
PLACES = {"real broad": (52.5, 13.3, 40.0), "real firmware": (-35.3633, 149.1652, 584.0)}
# North, east, down, mG: by the world model, and as it was there (a hall of steel; a simulator of the model).
WORLD = {"real broad": (187.0, 15.0, 462.0), "real firmware": (232.0, 52.7, -529.0)}
FIELDS = {"real broad": (148.0, -6.0, 406.0), "real firmware": (232.0, 52.7, -529.0)}
FIRMWARE_LAG_S = 0.09


def are_there(kind: str) -> bool:
    """Tell whether a kind's recordings are there; made kinds always are."""
    return all(file.exists() for file in FILES.get(kind, ()))


def case_of(kind: str, index: int) -> Case:
    """Read one recording.

    Passing a magnet (BROAD 28), or carrying one from 45 to 97 s (34), may be refused rightly; what is
    accepted is judged by what holds in the end.
    """
    file = FILES[kind][index]
    parts = _broad(file) if kind == "real broad" else _firmware(file)
    time, acc, gyro, attitude, mag_time, mag, euler = parts
    field, none = np.array(FIELDS[kind]), np.zeros(3)
    return Case(
        kind=kind,
        index=index,
        time=time - time[0],
        acc=acc,
        gyro=gyro,
        attitude=attitude,
        mag_time=mag_time - time[0],
        mag=mag,
        place=PLACES[kind],
        world=np.array(WORLD[kind]),
        truth=Truth(None, none, none, field, euler, from_s=100.0 if file.name.startswith("34") else 0.0),
        vehicle=file.name.split("_")[0] if kind == "real firmware" else "copter",
        autopilot="ardupilot" if kind == "real firmware" else "px4",
        answerable=kind == "real firmware" or index == 0,
    )


def _broad(file: Path) -> tuple[F, ...]:
    table = np.genfromtxt(file, delimiter=",", skip_header=1)[:, :14]
    table = table[np.isfinite(table).all(axis=1)]
    time, mag, acc, gyro = table[:, 0], table[:, 1:4], table[:, 4:7], table[:, 7:10]
    w, x, y, z = table[:, 10:14].T
    roll = np.arctan2(2 * (w * x + y * z), 1 - 2 * (x * x + y * y))
    pitch = np.arcsin(np.clip(2 * (w * y - z * x), -1, 1))
    yaw = np.arctan2(2 * (w * z + x * y), 1 - 2 * (y * y + z * z))
    euler = np.stack([roll, pitch, yaw], axis=1)
    # There is no autopilot: whoever asks for its attitude gets what is true.
    return time, acc, gyro, euler, time, mag, euler


def _firmware(file: Path) -> tuple[F, ...]:
    from pymavlink import mavutil

    log = mavutil.mavlink_connection(str(file))
    rows: dict[str, list[tuple[float, ...]]] = {"IMU": [], "MAG": [], "ATT": [], "SIM": []}
    while (m := log.recv_match(type=list(rows))) is not None:
        if getattr(m, "I", 0) == 0:
            values = {
                "IMU": lambda m: (m.AccX, m.AccY, m.AccZ, m.GyrX, m.GyrY, m.GyrZ),
                "MAG": lambda m: (m.MagX - m.OfsX, m.MagY - m.OfsY, m.MagZ - m.OfsZ),
            }.get(m.get_type(), lambda m: (m.Roll, m.Pitch, m.Yaw))(m)
            rows[m.get_type()].append((m.TimeUS * 1e-6, *values))
    imu, mag, flown, true = (np.array(rows[name]) for name in ("IMU", "MAG", "ATT", "SIM"))
    for angles in (flown, true):
        angles[:, 1:] = np.unwrap(np.radians(angles[:, 1:]), axis=0)
    attitude = np.angle(np.exp(1j * columns(imu[:, 0], flown[:, 0], flown[:, 1:])))
    euler = columns(mag[:, 0] - FIRMWARE_LAG_S, true[:, 0], true[:, 1:])
    return imu[:, 0], imu[:, 1:4], imu[:, 4:], attitude, mag[:, 0], mag[:, 1:], euler
