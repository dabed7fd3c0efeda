"""What a vehicle's sensors say."""

from __future__ import annotations

from dataclasses import dataclass

from mavcompass.messages.message import Message


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
