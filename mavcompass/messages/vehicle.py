"""What a vehicle says of itself."""

from __future__ import annotations

from dataclasses import dataclass

from mavcompass.messages.message import Message


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
    uid2: tuple[int, ...] = (0,) * 18


@dataclass(frozen=True, slots=True)
class Statustext(Message):
    severity: int = 6
    text: str = ""


@dataclass(frozen=True, slots=True)
class ExtendedSysState(Message):
    vtol_state: int = 0
    landed_state: int = 0
