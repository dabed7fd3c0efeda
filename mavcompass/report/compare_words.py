"""A comparison of simulator and vehicle in words for a person: first what to do, then what each lacks."""

from __future__ import annotations

import math

from mavcompass.gap.comparison import Achieved, Comparison, Difference
from mavcompass.gap.result import Closing
from mavcompass.report.gap_words import VERDICTS, cause_values, shrink_words, unseen_iron
from mavcompass.simulation.effects import get

_GOOD, _NEARLY = 0.95, 0.05


def compare_advice(comparison: Comparison) -> str:
    """Say in one sentence what to do."""
    if comparison.achieved and comparison.differences:
        return _of_flying_again(comparison)
    lacking = [d.cause.effect for d in comparison.differences if d.lacks == "simulator"]
    surplus = [d.cause.effect for d in comparison.differences if d.lacks == "vehicle"]
    if lacking:
        return f"Put into the simulator, fly it again, and compare all three: {', '.join(lacking)}."
    if surplus:
        return f"Take out of the simulator what the vehicle does not have: {', '.join(surplus)}."
    if comparison.told.verdict == "no_gap":
        return (
            "No difference found: the simulator's compass is as good as the vehicle's, to the noise of both."
        )
    if comparison.told.verdict == "not_testable":
        return "Record again, with turns through all headings, and with tilt if the vehicle can."
    return "They differ in a way that no effect of the catalogue explains; look at what it goes with (below)."


def _of_flying_again(comparison: Comparison) -> str:
    whole, held, reached = comparison.told.field.shrink, comparison.held, comparison.achieved[-1].shrink
    promised = whole if held is None else held
    if reached >= min(_GOOD, promised - _NEARLY):
        if promised < min(_GOOD, whole) - _NEARLY:
            return (
                f"The gap closed as far as this simulator can hold what was found ({_percent(reached)}; with"
                f" all of it {_percent(whole)}): see below what it lacks."
            )
        return "The simulator now flies like the vehicle: the gap closed as promised."
    return (
        f"The gap closed less than promised ({_percent(reached)} of {_percent(promised)}):"
        " see whether the simulator took all the parameters, then diagnose what is left."
    )


def compare_summary(comparison: Comparison) -> list[str]:
    """Put a comparison in a few lines for a terminal."""
    told = comparison.told
    lines = [compare_advice(comparison), f"  verdict: {VERDICTS[told.verdict]} (compass {told.compass})"]
    lines += [_difference(d) for d in comparison.differences]
    lines += [_gap("heading", told.heading, "deg"), _gap("field", told.field, "mG")]
    if told.unknown and told.unknown_coordinate:
        lines.append(f"  what no effect explains goes with: {told.unknown_coordinate}")
    lines += dict.fromkeys([*unseen_iron(comparison.vehicle), *unseen_iron(comparison.simulator)])
    held = "" if comparison.held is None else f", {_percent(comparison.held)} by what the simulator holds"
    for one in comparison.achieved:
        lines.append(
            f"  flown again ({one.path or 'unnamed'}): promised {shrink_words(told.field)}{held}, achieved"
            f" {_achieved(one)} of the field's gap, {_in_heading(one)}"
        )
    return lines


def _achieved(one: Achieved) -> str:
    """Say what share closed, with its interval where that says more."""
    share, low, high = (_percent(value) for value in (one.shrink, *one.ci95))
    return share if low == share == high else f"{share} ({low} to {high})"


def _in_heading(one: Achieved) -> str:
    """Say what share closed in the heading, where there was more to close than noise."""
    if math.isfinite(one.heading_shrink):
        return f"{_percent(one.heading_shrink)} of the heading's"
    return "the heading's was no more than noise"


def _difference(difference: Difference) -> str:
    cause = difference.cause
    return (
        f"  the {difference.lacks} lacks {cause.effect}, {get(cause.effect).title} ({cause_values(cause)}):"
        f" {cause.removes_deg:.1f} deg of heading, {cause.removes_mgauss:.1f} mG"
    )


def _gap(name: str, closing: Closing, unit: str) -> str:
    then = "" if closing.after == closing.nominal else f"; {closing.after:.1f} once that is the same"
    return f"  {name}: {closing.nominal:.1f} {unit} apart now{then} ({closing.floor:.1f} is noise)"


def _percent(share: float) -> str:
    return f"{100.0 * min(max(share, 0.0), 1.0):.0f} %" if share == share else "?"
