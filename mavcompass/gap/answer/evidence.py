"""What was found about one recording, before anything is said of it."""

from __future__ import annotations

from dataclasses import dataclass

from mavcompass.gap.left import Adequacy, Floor
from mavcompass.gap.replay import Replay
from mavcompass.gap.result import Cause
from mavcompass.gap.selection import Identified, Remainder
from mavcompass.gap.traces import Traces
from mavcompass.track import Track


@dataclass(frozen=True, slots=True, eq=False)
class Evidence:
    """Hold all that was found about one recording."""

    track: Track
    compass: int
    replay: Replay
    floor: Floor
    identified: Identified
    remainder: Remainder
    adequacy: Adequacy
    traces: Traces
    untestable: dict[str, str]
    withheld: frozenset[str]
    faults: tuple[Cause, ...]

    @property
    def beside(self) -> bool:
        """Tell whether something is named besides the fitted effects: faults, scatter, other traces."""
        return bool(self.faults) or self.remainder.scatter is not None or self.traces.named

    @property
    def unseen_mgauss2(self) -> float:
        """Return the variance of the readings that averaged and cleaned rows do not have."""
        scatter = self.remainder.scatter
        unseen = sum(rapid.variance_mgauss2 for rapid in self.traces.rapid)
        if scatter is not None and scatter.white:
            unseen += scatter.size**2 - scatter.on_rows_mgauss2(self.replay)
        return unseen
