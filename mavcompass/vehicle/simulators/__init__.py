"""Other people's simulators: their programs, started on this computer's loopback and stopped again."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

from mavcompass.vehicle.simulators.ardupilot import ArduPilotSitl
from mavcompass.vehicle.simulators.program import Flight, RunningProgram
from mavcompass.vehicle.simulators.px4 import Px4Sih

__all__ = ["ArduPilotSitl", "Flight", "Px4Sih", "RunningProgram", "simulator_of"]


def simulator_of(
    program: Path, model: str, defaults: Sequence[Path], speed: float | None
) -> ArduPilotSitl | Px4Sih:
    """Return the simulator that a program is: PX4's by its name, ArduPilot's otherwise; checked.

    Raises UsageError where it cannot be run or is none.
    """
    simulator: ArduPilotSitl | Px4Sih = ArduPilotSitl(program, model, {}, defaults)
    if program.name.startswith("px4"):
        simulator = Px4Sih(program, {}, tuple(defaults))
    simulator.check()
    return simulator if speed is None else replace(simulator, speed=speed)
