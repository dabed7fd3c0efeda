"""How each kind of vehicle turns on the spot, by which messages, and how far the gyro says it turned."""

from __future__ import annotations

from mavcompass.procedure.turning.gyro_angle import GyroAngle
from mavcompass.procedure.turning.pilots_controls import TurnBy
from mavcompass.procedure.turning.profiles import strategies_for, vehicle_profile
from mavcompass.procedure.turning.steered import SteeredTurn, TurnStrategy

__all__ = [
    "GyroAngle",
    "SteeredTurn",
    "TurnBy",
    "TurnStrategy",
    "strategies_for",
    "vehicle_profile",
]
