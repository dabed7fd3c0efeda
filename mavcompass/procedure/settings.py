"""What a person may choose of a calibration."""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from typing import Literal

from mavcompass.calibration.result import TrueHeading
from mavcompass.procedure.motion import Motion, Permissions
from mavcompass.procedure.positions import DwellSettings
from mavcompass.procedure.turning import TurnBy

Writing = Literal["ask", "yes", "never"]


@dataclass(frozen=True, slots=True)
class CalibrateSettings:
    """Hold what the person may choose.

    Attributes:
        instances: compasses to calibrate, from 1; empty means all that the vehicle has.
        method: how the readings are solved, a name of `calibration.methods`.
        true_heading: for one-point; None takes a second antenna's.
        max_heading_error_deg: accept no larger predicted error.
        motion: who turns the vehicle; "auto" lets it turn itself where it is armed.
        turn_by: "auto" by targets; else by the pilot's own controls, in a mode in which they steer.
        permissions: what may be done to the vehicle so that it can turn itself.
        positions, step_rad: how many still positions, and the turn between them (negative: left).
        enough_deg, most_positions: a vehicle that turns itself visits more positions, up to so many,
            while the predicted heading error is larger.
        writing: "ask" the person, "yes" without asking, "never".
        system: MAVLink system id, where several vehicles share the link.
        rate_hz: at which IMU messages are asked for.
        year: decimal year to use where the vehicle does not know the date.
        reboot: restart the autopilot where its own heading cannot be brought right otherwise.
        orientation: set how a compass is mounted, too, where it is mounted turned.
        rewrite: write also where the values in force are right.
        continuous: what turns itself passes through the positions in one turn instead of stopping at each.
    """

    instances: tuple[int, ...] = (1,)
    method: str = "four-positions"
    true_heading: TrueHeading | None = None
    max_heading_error_deg: float = 2.0
    motion: Motion = "auto"
    turn_by: TurnBy = "auto"
    permissions: Permissions = field(default_factory=Permissions)
    positions: int = 4
    step_rad: float = math.pi / 2.0
    enough_deg: float = 0.3
    most_positions: int = 8
    writing: Writing = "ask"
    system: int | None = None
    rate_hz: float = 25.0
    year: float = 2026.0
    reboot: bool = False
    orientation: bool = False
    rewrite: bool = False
    continuous: bool = False
    dwell: DwellSettings = field(default_factory=DwellSettings)

    @property
    def solver(self) -> str:
        """Return the method that solves: a turn without a stop is solved as any motion is."""
        return "world-field" if self.continuous else self.method

    @property
    def stands(self) -> bool:
        """Tell whether the vehicle is left where it stands: nobody arms, moves or turns it."""
        return self.method == "one-point"

    @property
    def planned(self) -> int:
        """Return at how many positions it stands at first: by a quarter turn where the scales are kept."""
        return 1 if self.stands or self.by_autopilot else 2 if self.touches_up else self.positions

    @property
    def at_most(self) -> int:
        """Return up to how many positions a vehicle that turns itself adds."""
        return self.planned if self.touches_up else self.most_positions

    @property
    def touches_up(self) -> bool:
        """Tell whether the scales of the calibration in force are kept."""
        return self.method == "touch-up"

    @property
    def moved_by(self) -> Motion:
        """Tell who turns the vehicle, where the method leaves no choice."""
        return "none" if self.stands else "hand" if self.by_autopilot else self.motion

    @property
    def by_autopilot(self) -> bool:
        """Tell whether the autopilot's own calibration is run, and judged, while a person turns it."""
        return self.method == "autopilot"
