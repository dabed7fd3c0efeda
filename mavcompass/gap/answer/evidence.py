"""What was found about one recording, before anything is said of it."""

from __future__ import annotations

from dataclasses import dataclass

from mavcompass.gap.left import Adequacy, Floor
from mavcompass.gap.replay import Replay
from mavcompass.gap.result import Cause
from mavcompass.gap.selection import Identified, Remainder
from mavcompass.gap.traces import Traces
from mavcompass.simulation.effects import detected_by
from mavcompass.track import Track


@dataclass(frozen=True, slots=True, eq=False)
class Evidence:
    """Hold all that was found about one recording.

    `untestable` says of effects why the recording cannot show them; of those that are `half_testable` it
    shows a part only.
    """

    track: Track
    compass: int
    replay: Replay
    floor: Floor
    identified: Identified
    remainder: Remainder
    adequacy: Adequacy
    traces: Traces
    untestable: dict[str, str]
    half_testable: frozenset[str]
    withheld: frozenset[str]
    faults: tuple[Cause, ...]

    @property
    def beside(self) -> bool:
        """Tell whether something is named besides the fitted effects: faults, scatter, other traces."""
        return bool(self.beside_ids)

    @property
    def beside_ids(self) -> frozenset[str]:
        """Return what is named besides the fitted effects."""
        ids = {fault.effect for fault in self.faults} | {rapid.effect for rapid in self.traces.rapid}
        if self.traces.stale_share > 0.0:
            ids.add(detected_by("repeats").id)
        if self.traces.step_mgauss > 0.0:
            ids.add(detected_by("steps").id)
        if self.remainder.scatter is not None:
            ids.add(self.remainder.scatter.effect)
        return frozenset(ids)

    @property
    def frozen(self) -> bool:
        """Tell whether the compass says one thing throughout, and so tells of nothing else."""
        return self.traces.stale_share > 0.0 and self.replay.trace.frozen

    @property
    def unseen_mgauss2(self) -> float:
        """Return the variance of the readings that averaged and cleaned rows do not have."""
        scatter = self.remainder.scatter
        unseen = sum(rapid.variance_mgauss2 for rapid in self.traces.rapid)
        if scatter is not None and scatter.white:
            unseen += scatter.size**2 - scatter.on_rows_mgauss2(self.replay)
        return unseen
