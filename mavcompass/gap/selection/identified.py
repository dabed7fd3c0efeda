"""What a search found, and what the criterion chose of it."""

from __future__ import annotations

from dataclasses import dataclass

from mavcompass.gap.fit import Fit, Found, Problem, Search
from mavcompass.gap.selection.posterior import Posterior
from mavcompass.gap.selection.split import Split


@dataclass(frozen=True, slots=True, eq=False)
class Identified:
    """Hold the best set as fitted to the training rows of a split, and how it was found.

    `first` is the problem that the sets were explored and weighed on (a change inside a held-out block
    moves rows afterwards).
    """

    problem: Problem
    split: Split
    found: Found
    fit: Fit
    search: Search
    first: Problem
    posterior: Posterior
