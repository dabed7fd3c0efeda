"""Where a vehicle is and how it stands."""

from __future__ import annotations

from dataclasses import dataclass

from mavcompass.messages.message import Message


@dataclass(frozen=True, slots=True)
class Attitude(Message):
    time_boot_ms: int = 0
    roll: float = 0.0
    pitch: float = 0.0
    yaw: float = 0.0
    rollspeed: float = 0.0
    pitchspeed: float = 0.0
    yawspeed: float = 0.0


@dataclass(frozen=True, slots=True)
class Simstate(Message):
    roll: float = 0.0
    pitch: float = 0.0
    yaw: float = 0.0
    xacc: float = 0.0
    yacc: float = 0.0
    zacc: float = 0.0
    xgyro: float = 0.0
    ygyro: float = 0.0
    zgyro: float = 0.0
    lat: int = 0
    lng: int = 0


@dataclass(frozen=True, slots=True)
class GlobalPositionInt(Message):
    time_boot_ms: int = 0
    lat: int = 0
    lon: int = 0
    alt: int = 0
    relative_alt: int = 0
    vx: int = 0
    vy: int = 0
    vz: int = 0
    hdg: int = 65535


@dataclass(frozen=True, slots=True)
class LocalPositionNed(Message):
    time_boot_ms: int = 0
    x: float = 0.0
    y: float = 0.0
    z: float = 0.0
    vx: float = 0.0
    vy: float = 0.0
    vz: float = 0.0


@dataclass(frozen=True, slots=True)
class GpsRawInt(Message):
    time_usec: int = 0
    fix_type: int = 0
    lat: int = 0
    lon: int = 0
    alt: int = 0
    eph: int = 65535
    epv: int = 65535
    vel: int = 65535
    cog: int = 65535
    satellites_visible: int = 255
    yaw: int = 0


@dataclass(frozen=True, slots=True)
class VfrHud(Message):
    airspeed: float = 0.0
    groundspeed: float = 0.0
    heading: int = 0
    throttle: int = 0
    alt: float = 0.0
    climb: float = 0.0


@dataclass(frozen=True, slots=True)
class EkfStatusReport(Message):
    flags: int = 0
    velocity_variance: float = 0.0
    pos_horiz_variance: float = 0.0
    pos_vert_variance: float = 0.0
    compass_variance: float = 0.0
    terrain_alt_variance: float = 0.0


@dataclass(frozen=True, slots=True)
class EstimatorStatus(Message):
    time_usec: int = 0
    flags: int = 0
    vel_ratio: float = 0.0
    pos_horiz_ratio: float = 0.0
    pos_vert_ratio: float = 0.0
    mag_ratio: float = 0.0
    hagl_ratio: float = 0.0
    tas_ratio: float = 0.0
    pos_horiz_accuracy: float = 0.0
    pos_vert_accuracy: float = 0.0


@dataclass(frozen=True, slots=True)
class FenceStatus(Message):
    breach_status: int = 0
    breach_count: int = 0
    breach_type: int = 0
    breach_time: int = 0


@dataclass(frozen=True, slots=True)
class RcChannels(Message):
    time_boot_ms: int = 0
    chancount: int = 0
    chan1_raw: int = 65535
    chan2_raw: int = 65535
    chan3_raw: int = 65535
    chan4_raw: int = 65535
    chan5_raw: int = 65535
    chan6_raw: int = 65535
    chan7_raw: int = 65535
    chan8_raw: int = 65535
    chan9_raw: int = 65535
    chan10_raw: int = 65535
    chan11_raw: int = 65535
    chan12_raw: int = 65535
    chan13_raw: int = 65535
    chan14_raw: int = 65535
    chan15_raw: int = 65535
    chan16_raw: int = 65535
    chan17_raw: int = 65535
    chan18_raw: int = 65535
    rssi: int = 255


@dataclass(frozen=True, slots=True)
class ServoOutputRaw(Message):
    time_usec: int = 0
    port: int = 0
    servo1_raw: int = 0
    servo2_raw: int = 0
    servo3_raw: int = 0
    servo4_raw: int = 0
    servo5_raw: int = 0
    servo6_raw: int = 0
    servo7_raw: int = 0
    servo8_raw: int = 0
