"""Calibration: from still positions and turns, or any motion, to a correction with its covariance."""

from __future__ import annotations

from typing import TYPE_CHECKING

from mavcompass.installation.doors import door

if TYPE_CHECKING:
    from mavcompass.calibration.calibrate import calibrate_compasses as calibrate_compasses
    from mavcompass.calibration.calibrate import calibrate_track as calibrate_track
    from mavcompass.calibration.judged import calibrate_positions as calibrate_positions
    from mavcompass.calibration.methods import method_names as method_names
    from mavcompass.calibration.observation import Dwell as Dwell
    from mavcompass.calibration.observation import FourPositionData as FourPositionData
    from mavcompass.calibration.observation import Step as Step
    from mavcompass.calibration.observation import StillnessDetector as StillnessDetector
    from mavcompass.calibration.observation import assemble as assemble
    from mavcompass.calibration.observation import dwell_between as dwell_between
    from mavcompass.calibration.observation import find_dwells as find_dwells
    from mavcompass.calibration.observation import observe as observe
    from mavcompass.calibration.observation import step_between as step_between
    from mavcompass.calibration.observation import turns_between as turns_between
    from mavcompass.calibration.positions import FourPositionsResult as FourPositionsResult
    from mavcompass.calibration.positions import solve_four_positions as solve_four_positions
    from mavcompass.calibration.result import CalibrationResult as CalibrationResult
    from mavcompass.calibration.verdict import Limits as Limits

__getattr__, __dir__ = door(
    __name__,
    {
        "calibrate_compasses": "calibrate",
        "calibrate_positions": "judged",
        "calibrate_track": "calibrate",
        "FourPositionsResult": "positions",
        "solve_four_positions": "positions",
        "Dwell": "observation",
        "FourPositionData": "observation",
        "Step": "observation",
        "dwell_between": "observation",
        "step_between": "observation",
        "method_names": "methods",
        "CalibrationResult": "result",
        "StillnessDetector": "observation",
        "assemble": "observation",
        "find_dwells": "observation",
        "observe": "observation",
        "turns_between": "observation",
        "Limits": "verdict",
    },
)
