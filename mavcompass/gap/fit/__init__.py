"""Fit hypotheses to a replay, and search the set of effects that explains it best."""

from mavcompass.gap.fit.hypothesis import Fit, Mask, Term, least_gain, make_term, placements
from mavcompass.gap.fit.model import Problem
from mavcompass.gap.fit.search import Found, Search
from mavcompass.gap.fit.starts import pruned

__all__ = [
    "Fit",
    "Found",
    "Mask",
    "Problem",
    "Search",
    "Term",
    "least_gain",
    "make_term",
    "placements",
    "pruned",
]
