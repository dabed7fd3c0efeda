"""The report of a comparison of simulator and vehicle: one table, one picture, self-contained HTML."""

from __future__ import annotations

import math
from pathlib import Path

from mavcompass.gap.comparison import Comparison
from mavcompass.report.compare_words import compare_advice
from mavcompass.report.gap_figures import Level, levels_figure, residual_overlay
from mavcompass.report.gap_words import SHADES, VERDICTS, cause_values, shrink_words
from mavcompass.report.page import write_page
from mavcompass.simulation.effects import get


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
