"""Put the answer together: verdict, names, how far the gap closes, where it lies, what to do next."""

from mavcompass.gap.answer.description import describe
from mavcompass.gap.answer.evidence import Evidence
from mavcompass.gap.answer.locate import bin_means
from mavcompass.gap.answer.several import together
from mavcompass.gap.answer.verdict import Answer, decide

__all__ = [
    "Answer",
    "Evidence",
    "bin_means",
    "decide",
    "describe",
    "together",
]
