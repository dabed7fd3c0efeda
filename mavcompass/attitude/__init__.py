"""Roll and pitch of what stands, drives or flies, with their sigma, live and all through a recording."""

from __future__ import annotations

from mavcompass.attitude.level import LASTS_S, ON_THE_GROUND, Level
from mavcompass.attitude.recorded import Levels, down_in_body, levels, moving_average

__all__ = ["LASTS_S", "ON_THE_GROUND", "Level", "Levels", "down_in_body", "levels", "moving_average"]
