"""Choose the effects: held-out blocks, search, the criterion, and the choice fitted again on all rows."""

from mavcompass.gap.selection.identification import identify
from mavcompass.gap.selection.posterior import Explanation, Identified, Posterior
from mavcompass.gap.selection.remainder import Remainder, what_is_left, with_white
from mavcompass.gap.selection.split import split_blocks
from mavcompass.gap.selection.transient import between_rows

__all__ = [
    "Explanation",
    "Identified",
    "Posterior",
    "Remainder",
    "between_rows",
    "identify",
    "split_blocks",
    "what_is_left",
    "with_white",
]
