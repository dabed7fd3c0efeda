"""Other people's simulators: their programs, started on this computer's loopback and stopped again."""

from __future__ import annotations

from mavcompass.vehicle.simulators.ardupilot import ArduPilotSitl, calibration_in
from mavcompass.vehicle.simulators.program import RunningProgram

__all__ = ["ArduPilotSitl", "RunningProgram", "calibration_in"]
