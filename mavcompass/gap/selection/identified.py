"""What a search chose and the guards left of it."""

from __future__ import annotations

from dataclasses import dataclass

from mavcompass.gap.fit import Fit, Found, Problem, Search
from mavcompass.gap.selection.split import Split


@dataclass(frozen=True, slots=True, eq=False)
class Identified:
    """Hold the chosen fit on the training rows of a split, and how it was found.

    `dropped` tells which effects the guards took out, and why; `first` is the problem that `found` was
    found on (a change inside a held-out block moves rows afterwards). `as_good` are other sets that reach the
    floor too; `evident` are effects that are certain, and too small to be named.
    """

    problem: Problem
    split: Split
    found: Found
    fit: Fit
    dropped: tuple[tuple[str, str], ...]
    search: Search
    first: Problem
    as_good: tuple[frozenset[str], ...] = ()
    evident: frozenset[str] = frozenset()
