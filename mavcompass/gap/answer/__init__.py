"""Put the answer together: verdict, names, how far the gap closes, where it lies, what to do next."""

from mavcompass.gap.answer.decision import Answer, decide
from mavcompass.gap.answer.description import describe
from mavcompass.gap.answer.evidence import Evidence, Statistics, statistics
from mavcompass.gap.answer.locate import bin_means
from mavcompass.gap.answer.several import together
from mavcompass.gap.answer.shrink import figures

__all__ = [
    "Answer",
    "Evidence",
    "Statistics",
    "bin_means",
    "decide",
    "describe",
    "figures",
    "statistics",
    "together",
]
