"""The verdict: what may be said of a gap, by how probable the best set is and by two p values."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

from mavcompass.gap.result import Verdict
from mavcompass.gap.tables import Levels, Outcome


@dataclass(frozen=True, slots=True)
class Findings:
    """Hold what the verdict is made of.

    Attributes:
        found: there is a best set, or single readings show something; searched: only that set shows it.
        confirmed: something lies above the floor without it, or what it was not fitted to gains.
        p_gain: how seldom healthy vehicles gain as much from any set; p_fit: how seldom they leave as much.
        outcomes: what the best set may be; shared: something else than the catalogue's effect makes the same.
        above: what is left lies above the floor; testable: silence would tell something.
    """

    found: bool
    searched: bool
    confirmed: bool
    p_gain: float
    p_fit: float
    outcomes: Mapping[Outcome, float]
    shared: bool
    above: bool
    testable: bool


def verdict(of: Findings, levels: Levels) -> Verdict:
    """Decide what is said: equation (3) of docs/gap.md."""
    left = of.above or of.p_fit <= levels.fit
    if not of.found or (of.searched and (of.p_gain > levels.gain or not of.confirmed)):
        if left:
            return "unknown"
        return "no_gap" if of.testable else "not_testable"
    whole, part, other, unknown = (of.outcomes[one] for one in ("whole", "part", "other", "unknown"))
    if unknown > max(whole + part, other):
        return "unknown"
    if whole >= levels.sure and not (left or of.shared):
        return "named"
    if left or part > max(whole, other):
        return "named_with_remainder" if whole + part > other + unknown else "unknown"
    return "ambiguous"
