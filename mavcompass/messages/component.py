"""What mavcompass reports as a component."""

from __future__ import annotations

from dataclasses import dataclass

from mavcompass.messages.message import Message


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
