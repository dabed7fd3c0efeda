"""What a live calibration found and did."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace

from mavcompass.calibration.result import CalibrationResult
from mavcompass.correction import FieldCorrection
from mavcompass.procedure.dialect import ParameterPlan, WriteOutcome
from mavcompass.procedure.positions import Proof, Window
from mavcompass.procedure.vehicle_state import VehicleIdentity
from mavcompass.track import Track


@dataclass(frozen=True, slots=True, eq=False)
class CalibrationReport:
    """Say what a calibration found and did.

    Attributes:
        before: the correction in force at the start, per compass.
        proof: what the turn after the write showed; None where nothing was written.
        undone: True where the proof failed and the old values were put back.
    """

    identity: VehicleIdentity
    results: tuple[CalibrationResult, ...]
    before: Mapping[int, FieldCorrection]
    track: Track
    windows: tuple[Window, ...]
    duration_s: float
    plan: ParameterPlan | None = None
    outcome: WriteOutcome | None = None
    proof: Proof | None = None
    undone: bool = False
    messages: tuple[str, ...] = ()

    @property
    def accepted(self) -> bool:
        """Tell whether every compass got a calibration worth writing."""
        return bool(self.results) and all(result.accepted for result in self.results)

    @property
    def written(self) -> bool:
        """Tell whether the new values are in force on the vehicle."""
        return self.outcome is not None and not self.undone

    def noting(self, *sentences: str) -> CalibrationReport:
        """Return the report with more to tell the person."""
        return replace(self, messages=(*self.messages, *sentences))
