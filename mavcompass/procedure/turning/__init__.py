"""How each kind of vehicle turns on the spot, by which messages, and how far the gyro says it turned."""

from __future__ import annotations

from mavcompass.procedure.turning.gyro_angle import GyroAngle
from mavcompass.procedure.turning.pilots_controls import TurnBy, channels_moved
from mavcompass.procedure.turning.profiles import strategies_for, turned_otherwise, vehicle_profile
from mavcompass.procedure.turning.steered import SteeredTurn

__all__ = [
    "GyroAngle",
    "SteeredTurn",
    "TurnBy",
    "channels_moved",
    "strategies_for",
    "turned_otherwise",
    "vehicle_profile",
]
