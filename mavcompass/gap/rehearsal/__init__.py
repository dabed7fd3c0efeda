"""The rehearsal: the calibration of a diagnosed vehicle, done a thousand times in the simulation."""

from mavcompass.gap.rehearsal.draws import IRON_NAMES, whole_iron
from mavcompass.gap.rehearsal.kind import Stored, read_stored
from mavcompass.gap.rehearsal.rehearse import Errors, Expected, Part, Rehearsal, Remedy, rehearse

__all__ = [
    "IRON_NAMES",
    "Errors",
    "Expected",
    "Part",
    "Rehearsal",
    "Remedy",
    "Stored",
    "read_stored",
    "rehearse",
    "whole_iron",
]
