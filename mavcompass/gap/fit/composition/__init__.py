"""The simulation that a hypothesis makes of a replay: its members in order, what makes late, derivatives."""

from mavcompass.gap.fit.composition.composed import Composition
from mavcompass.gap.fit.composition.derivatives import Changes

__all__ = ["Changes", "Composition"]
