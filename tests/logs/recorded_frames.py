"""Frames as vehicles send them, packed by pymavlink, for recordings made in tests."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from pymavlink.dialects.v20 import ardupilotmega as dialect

from mavcompass.logs.formats.tlog.frames import TlogWriter

T0_US = 1_700_000_000_000_000
HEARTBEATS = {
    "rover": (dialect.MAV_TYPE_GROUND_ROVER, dialect.MAV_AUTOPILOT_ARDUPILOTMEGA),
    "copter": (dialect.MAV_TYPE_QUADROTOR, dialect.MAV_AUTOPILOT_ARDUPILOTMEGA),
    "px4 copter": (dialect.MAV_TYPE_QUADROTOR, dialect.MAV_AUTOPILOT_PX4),
    "ground station": (dialect.MAV_TYPE_GCS, dialect.MAV_AUTOPILOT_INVALID),
    "gimbal": (dialect.MAV_TYPE_GIMBAL, dialect.MAV_AUTOPILOT_ARDUPILOTMEGA),
}


def frame(
    message: Any, system: int = 1, component: int = 1, version: int = 2, key: bytes | None = None
) -> bytes:
    """Pack one message as the wire carries it; with a key, signed."""
    mav = dialect.MAVLink(None, srcSystem=system, srcComponent=component)
    if key is not None:
        mav.signing.secret_key = key
        mav.signing.sign_outgoing = True
    return bytes(message.pack(mav, force_mavlink1=version == 1))


def heartbeat(kind: str) -> Any:
    type_, autopilot = HEARTBEATS[kind]
    return dialect.MAVLink_heartbeat_message(type_, autopilot, 0, 0, 0, 3)


def raw_imu(boot_s: float, mag: tuple[int, int, int], gyro_z: int = 0) -> Any:
    return dialect.MAVLink_raw_imu_message(round(boot_s * 1e6), 0, 0, -1000, 0, 0, gyro_z, *mag)


def scaled_imu(boot_s: float, mag: tuple[int, int, int], number: str = "") -> Any:
    make = getattr(dialect, f"MAVLink_scaled_imu{number}_message")
    return make(round(boot_s * 1e3), 0, 0, -1000, 0, 0, 0, *mag)


def attitude(boot_s: float, yaw: float = 0.0) -> Any:
    return dialect.MAVLink_attitude_message(round(boot_s * 1e3), 0.0, 0.0, yaw, 0.0, 0.0, 0.0)


def parameter(name: str, value: float, index: int = 65535, kind: int = 9) -> Any:
    return dialect.MAVLink_param_value_message(name.encode(), value, kind, 1000, index)


def sys_status(current_ca: int) -> Any:
    return dialect.MAVLink_sys_status_message(0, 0, 0, 0, 12000, current_ca, 50, 0, 0, 0, 0, 0, 0)


class Recording:
    """Collect frames with the times when a ground station logged them."""

    def __init__(self) -> None:
        self.records: list[tuple[int, bytes]] = []

    def add(self, log_s: float, message: Any, **sender: Any) -> Recording:
        self.records.append((T0_US + round(log_s * 1e6), frame(message, **sender)))
        return self

    def fly(
        self,
        seconds: float = 10.0,
        *,
        boot_s: float = 20.0,
        log_s: float = 0.0,
        mag: tuple[int, int, int] = (200, 50, -500),
        kind: str = "rover",
        **sender: Any,
    ) -> Recording:
        """Add a heartbeat each second, RAW_IMU and ATTITUDE at 10 Hz with a link delay of 20 ms."""
        for tick in range(round(seconds * 10)):
            now = tick * 0.1
            if tick % 10 == 0:
                self.add(log_s + now, heartbeat(kind), **sender)
            self.add(log_s + now + 0.02, attitude(boot_s + now, yaw=0.1), **sender)
            self.add(log_s + now + 0.021, raw_imu(boot_s + now, mag, gyro_z=tick % 100), **sender)
        return self

    @property
    def content(self) -> bytes:
        return b"".join(time_us.to_bytes(8, "big") + content for time_us, content in self.records)

    def write(self, path: Path) -> Path:
        with TlogWriter(path) as log:
            for time_us, content in self.records:
                log.append(time_us, content)
        return path
