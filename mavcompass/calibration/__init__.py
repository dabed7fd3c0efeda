"""Calibration: from still positions and turns, or any motion, to a correction with its covariance."""

from __future__ import annotations

from typing import TYPE_CHECKING

from mavcompass.installation.doors import door

if TYPE_CHECKING:
    from mavcompass.calibration.calibrate import calibrate_compasses as calibrate_compasses
    from mavcompass.calibration.calibrate import calibrate_track as calibrate_track
    from mavcompass.calibration.methods import method_names as method_names
    from mavcompass.calibration.methods.four_positions import calibrate_positions as calibrate_positions
    from mavcompass.calibration.observation import StillnessDetector as StillnessDetector
    from mavcompass.calibration.observation import find_dwells as find_dwells
    from mavcompass.calibration.positions import solve_four_positions as solve_four_positions
    from mavcompass.calibration.result import Limits as Limits

__getattr__, __dir__ = door(
    __name__,
    {
        "calibrate_compasses": "calibrate",
        "calibrate_track": "calibrate",
        "calibrate_positions": "methods.four_positions",
        "method_names": "methods",
        "StillnessDetector": "observation",
        "find_dwells": "observation",
        "solve_four_positions": "positions",
        "Limits": "result",
    },
)
