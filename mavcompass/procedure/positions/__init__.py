"""The still positions of a calibration: visited by the vehicle itself or by hand, proven by one more turn."""

from __future__ import annotations

from mavcompass.procedure.positions.movers import HandMover, VehicleMover
from mavcompass.procedure.positions.proof import Proof, prove
from mavcompass.procedure.positions.visiting import (
    DwellSettings,
    Mover,
    Rest,
    Sureness,
    Window,
    dwell,
    stood_since,
    turn_through,
    visit,
)

__all__ = [
    "DwellSettings",
    "HandMover",
    "Mover",
    "Proof",
    "Rest",
    "Sureness",
    "VehicleMover",
    "Window",
    "dwell",
    "prove",
    "stood_since",
    "turn_through",
    "visit",
]
