"""Every method on a recording, brought into the same judged result."""

from __future__ import annotations

from mavcompass.calibration.methods.choice import calibrate_otherwise
from mavcompass.calibration.methods.judged import calibrate_positions, in_force_of

__all__ = [
    "calibrate_otherwise",
    "calibrate_positions",
    "in_force_of",
]
