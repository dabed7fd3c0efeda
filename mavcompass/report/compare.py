"""A comparison of simulator and vehicle: in words, first what to do, then what each lacks; and as a report.

The report is one table and one picture, self-contained HTML.
"""

from __future__ import annotations

import math
from pathlib import Path

from mavcompass.gap.comparison import Achieved, Comparison, Difference
from mavcompass.gap.result import Closing
from mavcompass.report.gap_figures import Level, levels_figure, residual_overlay
from mavcompass.report.gap_words import SHADES, VERDICTS, cause_values, shrink_words, unseen_iron
from mavcompass.report.svg import write_page
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


def write_compare_report(comparison: Comparison, path: Path) -> None:
    """Write the report of a comparison. Raises UsageError where the file cannot be written."""
    told = comparison.told
    field, heading = (
        list[Level]([("as it is", gap.nominal, "old", None), ("promised", gap.after, "step", None)])
        for gap in (told.field, told.heading)
    )
    left = (told.field.after, told.heading.after)
    rows = [("promised", shrink_words(told.field), shrink_words(told.heading), *left)]
    for number, one in enumerate(comparison.achieved, start=1):
        name = "flown again" if len(comparison.achieved) == 1 else f"flown again, {number}"
        field.append((name, one.again.field.nominal, "new", None))
        heading.append((name, one.again.heading.nominal, "new", None))
        low, high = one.ci95
        interval = f" ({100 * low:.0f} to {100 * high:.0f})" if math.isfinite(low) else ""
        of_heading = f"{100 * one.heading_shrink:.0f} %" if math.isfinite(one.heading_shrink) else "no gap"
        left = (one.again.field.nominal, one.again.heading.nominal)
        rows.append((name, f"{100 * one.shrink:.0f} %{interval}", of_heading, *left))
    shown = {
        "advice": compare_advice(comparison),
        "verdict": VERDICTS[told.verdict],
        "css": SHADES.get(told.verdict, "warn"),
        "facts": {
            "Simulator": comparison.simulator.path or "unknown",
            "Vehicle": comparison.vehicle.path or "unknown",
            "Compass": str(told.compass),
        },
        "differences": [
            {
                "lacks": d.lacks,
                "id": d.cause.effect,
                "title": get(d.cause.effect).title,
                "parameters": cause_values(d.cause),
                "field": d.cause.removes_mgauss,
                "heading": d.cause.removes_deg,
            }
            for d in comparison.differences
        ],
        "rows": rows,
        "field": levels_figure(field, told.field.floor, "mG"),
        "heading": levels_figure(heading, told.heading.floor, "deg"),
        "overlays": [
            (axis, residual_overlay(told.picture, i)) for i, axis in enumerate("xyz") if told.picture
        ],
    }
    write_page(path, "gap_compare.html", shown)
