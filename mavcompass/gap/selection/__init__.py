"""Choose the effects: held-out blocks, search, guards, and the choice fitted again on all rows."""

from mavcompass.gap.selection.guards import SILENT
from mavcompass.gap.selection.identification import identify
from mavcompass.gap.selection.identified import Identified
from mavcompass.gap.selection.levels import (
    ABOVE,
    EVIDENT,
    FEW_NAMES,
    NEEDED_ABOVE,
    at_floor,
    evident,
    lost_in_the_floor,
    whitened_left,
)
from mavcompass.gap.selection.remainder import Remainder, floor_to_start, what_is_left
from mavcompass.gap.selection.split import split_blocks
from mavcompass.gap.selection.transient import between_rows, moments

__all__ = [
    "ABOVE",
    "EVIDENT",
    "FEW_NAMES",
    "NEEDED_ABOVE",
    "SILENT",
    "Identified",
    "Remainder",
    "at_floor",
    "between_rows",
    "evident",
    "floor_to_start",
    "identify",
    "lost_in_the_floor",
    "moments",
    "split_blocks",
    "what_is_left",
    "whitened_left",
]
