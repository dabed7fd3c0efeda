"""Diagnosis of the gap between the simulation and a recording: where, why, how far it shrinks."""

from mavcompass.gap.diagnose import diagnose_gap
from mavcompass.gap.result import Cause, Closing, Diagnosis

__all__ = ["Cause", "Closing", "Diagnosis", "diagnose_gap"]
