"""How a vehicle is asked to move."""

from __future__ import annotations

from dataclasses import dataclass

from mavcompass.messages.message import Message

Quaternion = tuple[float, float, float, float]
_IDENTITY: Quaternion = (1.0, 0.0, 0.0, 0.0)


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
