"""How each kind of vehicle turns on the spot, by which messages, and how far the gyro says it turned."""

from __future__ import annotations

from mavcompass.procedure.turning.gyro_angle import GyroAngle
from mavcompass.procedure.turning.profiles import vehicle_profile
from mavcompass.procedure.turning.px4 import OffboardTurn
from mavcompass.procedure.turning.strategies import SteeredTurn, TurnBy, TurnStrategy, strategies_for

__all__ = [
    "GyroAngle",
    "OffboardTurn",
    "SteeredTurn",
    "TurnBy",
    "TurnStrategy",
    "strategies_for",
    "vehicle_profile",
]
