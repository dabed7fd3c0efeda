"""The MAVLink messages that mavcompass speaks and understands, as plain values.

Names and units are the wire's (`vehicle.wire.codec` holds them to the dialect, field by field); the
meaning of the numbers as quantities is in `telemetry`. Class names are the message's name in camel
case: RawImu is RAW_IMU. Every field has a default, so a test names only what it is about.
"""

from __future__ import annotations

import re
from dataclasses import dataclass

Quaternion = tuple[float, float, float, float]
_IDENTITY: Quaternion = (1.0, 0.0, 0.0, 0.0)


@dataclass(frozen=True, slots=True)
class Message:
    """Be one MAVLink message."""

    @classmethod
    def wire_name(cls) -> str:
        """Return the dialect's name: RawImu is RAW_IMU."""
        return re.sub(r"(?<=[a-z])(?=[A-Z])", "_", cls.__name__).upper()


@dataclass(frozen=True, slots=True)
class Incoming:
    """Wrap a message heard on a link with its sender and the link's time of arrival, in seconds."""

    time_s: float
    system: int
    component: int
    message: Message


# --- what a vehicle says of itself ---------------------------------------------------------------


@dataclass(frozen=True, slots=True)
class Heartbeat(Message):
    type: int = 0
    autopilot: int = 0
    base_mode: int = 0
    custom_mode: int = 0
    system_status: int = 0
    mavlink_version: int = 3


@dataclass(frozen=True, slots=True)
class SysStatus(Message):
    onboard_control_sensors_present: int = 0
    onboard_control_sensors_enabled: int = 0
    onboard_control_sensors_health: int = 0
    load: int = 0
    voltage_battery: int = 0
    current_battery: int = -1
    battery_remaining: int = -1
    drop_rate_comm: int = 0
    errors_comm: int = 0
    errors_count1: int = 0
    errors_count2: int = 0
    errors_count3: int = 0
    errors_count4: int = 0


@dataclass(frozen=True, slots=True)
class SystemTime(Message):
    time_unix_usec: int = 0
    time_boot_ms: int = 0


@dataclass(frozen=True, slots=True)
class AutopilotVersion(Message):
    capabilities: int = 0
    flight_sw_version: int = 0
    middleware_sw_version: int = 0
    os_sw_version: int = 0
    board_version: int = 0
    flight_custom_version: tuple[int, ...] = (0,) * 8
    middleware_custom_version: tuple[int, ...] = (0,) * 8
    os_custom_version: tuple[int, ...] = (0,) * 8
    vendor_id: int = 0
    product_id: int = 0
    uid: int = 0


@dataclass(frozen=True, slots=True)
class Statustext(Message):
    severity: int = 6
    text: str = ""


@dataclass(frozen=True, slots=True)
class ExtendedSysState(Message):
    vtol_state: int = 0
    landed_state: int = 0


# --- its sensors ---------------------------------------------------------------------------------


@dataclass(frozen=True, slots=True)
class RawImu(Message):
    time_usec: int = 0
    xacc: int = 0
    yacc: int = 0
    zacc: int = 0
    xgyro: int = 0
    ygyro: int = 0
    zgyro: int = 0
    xmag: int = 0
    ymag: int = 0
    zmag: int = 0
    id: int = 0
    temperature: int = 0


@dataclass(frozen=True, slots=True)
class ScaledImu(Message):
    time_boot_ms: int = 0
    xacc: int = 0
    yacc: int = 0
    zacc: int = 0
    xgyro: int = 0
    ygyro: int = 0
    zgyro: int = 0
    xmag: int = 0
    ymag: int = 0
    zmag: int = 0
    temperature: int = 0


@dataclass(frozen=True, slots=True)
class ScaledImu2(ScaledImu):
    """Be compass and IMU 2."""


@dataclass(frozen=True, slots=True)
class ScaledImu3(ScaledImu):
    """Be compass and IMU 3."""


@dataclass(frozen=True, slots=True)
class HighresImu(Message):
    time_usec: int = 0
    xacc: float = 0.0
    yacc: float = 0.0
    zacc: float = 0.0
    xgyro: float = 0.0
    ygyro: float = 0.0
    zgyro: float = 0.0
    xmag: float = 0.0
    ymag: float = 0.0
    zmag: float = 0.0
    abs_pressure: float = 0.0
    diff_pressure: float = 0.0
    pressure_alt: float = 0.0
    temperature: float = 0.0
    fields_updated: int = 0
    id: int = 0


@dataclass(frozen=True, slots=True)
class ScaledPressure(Message):
    time_boot_ms: int = 0
    press_abs: float = 0.0
    press_diff: float = 0.0
    temperature: int = 0


# --- where it is and how it stands ---------------------------------------------------------------


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


# --- parameters and commands ---------------------------------------------------------------------


@dataclass(frozen=True, slots=True)
class ParamRequestRead(Message):
    target_system: int = 0
    target_component: int = 0
    param_id: str = ""
    param_index: int = -1


@dataclass(frozen=True, slots=True)
class ParamRequestList(Message):
    target_system: int = 0
    target_component: int = 0


@dataclass(frozen=True, slots=True)
class ParamSet(Message):
    target_system: int = 0
    target_component: int = 0
    param_id: str = ""
    param_value: float = 0.0
    param_type: int = 9


@dataclass(frozen=True, slots=True)
class ParamValue(Message):
    param_id: str = ""
    param_value: float = 0.0
    param_type: int = 9
    param_count: int = 0
    param_index: int = 65535


@dataclass(frozen=True, slots=True)
class CommandLong(Message):
    target_system: int = 0
    target_component: int = 0
    command: int = 0
    confirmation: int = 0
    param1: float = 0.0
    param2: float = 0.0
    param3: float = 0.0
    param4: float = 0.0
    param5: float = 0.0
    param6: float = 0.0
    param7: float = 0.0


@dataclass(frozen=True, slots=True)
class CommandInt(Message):
    target_system: int = 0
    target_component: int = 0
    frame: int = 0
    command: int = 0
    current: int = 0
    autocontinue: int = 0
    param1: float = 0.0
    param2: float = 0.0
    param3: float = 0.0
    param4: float = 0.0
    x: int = 0
    y: int = 0
    z: float = 0.0


@dataclass(frozen=True, slots=True)
class CommandAck(Message):
    command: int = 0
    result: int = 0
    progress: int = 0
    result_param2: int = 0
    target_system: int = 0
    target_component: int = 0


@dataclass(frozen=True, slots=True)
class MessageInterval(Message):
    message_id: int = 0
    interval_us: int = 0


@dataclass(frozen=True, slots=True)
class RequestDataStream(Message):
    target_system: int = 0
    target_component: int = 0
    req_stream_id: int = 0
    req_message_rate: int = 0
    start_stop: int = 0


@dataclass(frozen=True, slots=True)
class SetMode(Message):
    target_system: int = 0
    base_mode: int = 0
    custom_mode: int = 0


# --- motion --------------------------------------------------------------------------------------


@dataclass(frozen=True, slots=True)
class SetPositionTargetLocalNed(Message):
    time_boot_ms: int = 0
    target_system: int = 0
    target_component: int = 0
    coordinate_frame: int = 1
    type_mask: int = 0
    x: float = 0.0
    y: float = 0.0
    z: float = 0.0
    vx: float = 0.0
    vy: float = 0.0
    vz: float = 0.0
    afx: float = 0.0
    afy: float = 0.0
    afz: float = 0.0
    yaw: float = 0.0
    yaw_rate: float = 0.0


@dataclass(frozen=True, slots=True)
class SetAttitudeTarget(Message):
    time_boot_ms: int = 0
    target_system: int = 0
    target_component: int = 0
    type_mask: int = 0
    q: Quaternion = _IDENTITY
    body_roll_rate: float = 0.0
    body_pitch_rate: float = 0.0
    body_yaw_rate: float = 0.0
    thrust: float = 0.0


@dataclass(frozen=True, slots=True)
class RcChannelsOverride(Message):
    target_system: int = 0
    target_component: int = 0
    chan1_raw: int = 65535
    chan2_raw: int = 65535
    chan3_raw: int = 65535
    chan4_raw: int = 65535
    chan5_raw: int = 65535
    chan6_raw: int = 65535
    chan7_raw: int = 65535
    chan8_raw: int = 65535


@dataclass(frozen=True, slots=True)
class ManualControl(Message):
    target: int = 0
    x: int = 0
    y: int = 0
    z: int = 0
    r: int = 0
    buttons: int = 0


# --- what mavcompass reports as a component ------------------------------------------------------


@dataclass(frozen=True, slots=True)
class MagCalProgress(Message):
    compass_id: int = 0
    cal_mask: int = 0
    cal_status: int = 0
    attempt: int = 0
    completion_pct: int = 0
    completion_mask: tuple[int, ...] = (0,) * 10
    direction_x: float = 0.0
    direction_y: float = 0.0
    direction_z: float = 0.0


@dataclass(frozen=True, slots=True)
class MagCalReport(Message):
    compass_id: int = 0
    cal_mask: int = 0
    cal_status: int = 0
    autosaved: int = 0
    fitness: float = 0.0
    ofs_x: float = 0.0
    ofs_y: float = 0.0
    ofs_z: float = 0.0
    diag_x: float = 0.0
    diag_y: float = 0.0
    diag_z: float = 0.0
    offdiag_x: float = 0.0
    offdiag_y: float = 0.0
    offdiag_z: float = 0.0
    orientation_confidence: float = 0.0
    old_orientation: int = 0
    new_orientation: int = 0
    scale_factor: float = 0.0


@dataclass(frozen=True, slots=True)
class NamedValueFloat(Message):
    time_boot_ms: int = 0
    name: str = ""
    value: float = 0.0
