"""What a calibration by turning looks at: where the vehicle stood still, how tilted, how far it turned."""

from __future__ import annotations

from mavcompass.calibration.observation.detector import UNREST, StillnessDetector
from mavcompass.calibration.observation.dwells import (
    Dwell,
    FourPositionData,
    Step,
    around,
    centred,
    correction_at,
    dwell_between,
    field_lag_s,
)
from mavcompass.calibration.observation.rolling import WHEELED, rolls
from mavcompass.calibration.observation.stillness import (
    accelerometer_of,
    assemble,
    find_dwells,
    observe,
    turns_between,
)
from mavcompass.calibration.observation.turning import turn_record

__all__ = [
    "UNREST",
    "WHEELED",
    "Dwell",
    "FourPositionData",
    "Step",
    "StillnessDetector",
    "accelerometer_of",
    "around",
    "assemble",
    "centred",
    "correction_at",
    "dwell_between",
    "field_lag_s",
    "find_dwells",
    "observe",
    "rolls",
    "turn_record",
    "turns_between",
]
