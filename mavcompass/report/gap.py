"""The report of a gap diagnosis and of a blind trial: self-contained HTML files."""

from __future__ import annotations

import math
from itertools import pairwise
from pathlib import Path
from typing import TYPE_CHECKING, Any

from mavcompass.chance import wilson
from mavcompass.gap.result import Cause, Diagnosis
from mavcompass.report.gap_figures import (
    ambiguity_figure,
    gap_figures,
    interval_figure,
    tests_figure,
    waterfall_figure,
)
from mavcompass.report.gap_words import RMS_OF, SHADES, VERDICTS, advice, figures_of, shrink_words
from mavcompass.report.page import write_page
from mavcompass.simulation.effects import catalogue

if TYPE_CHECKING:
    from mavcompass.gap.trial import Trial


def write_gap_report(diagnosis: Diagnosis, path: Path) -> None:
    """Write the report of a diagnosis. Raises UsageError where the file cannot be written."""
    facts = {
        "Recording": diagnosis.path or "unknown",
        "Length": f"{diagnosis.duration_s:.0f} s, {diagnosis.samples} readings",
        "Compass": str(diagnosis.compass),
        "Attitude from": diagnosis.reference,
        "Field and heading": RMS_OF,
    }
    if diagnosis.in_force is not None and (cured := diagnosis.in_force.words()) is not None:
        facts["The calibration in force cures"] = f"{cured}, part of the nominal simulation"
    if diagnosis.corrected_rms_mgauss is not None:
        facts["With the calibration in force"] = (
            f"{diagnosis.corrected_rms_mgauss:.2f} mG rms beside the plain field"
        )
    if diagnosis.folded:
        facts["Known from the baseline"] = ", ".join(diagnosis.folded)
    if diagnosis.withheld:
        facts["Withheld"] = ", ".join(diagnosis.withheld)
    shown = {
        "verdict": VERDICTS[diagnosis.verdict],
        "css": SHADES.get(diagnosis.verdict, "warn"),
        "facts": facts,
        "notes": diagnosis.notes,
        "d": diagnosis,
        "causes": [_cause(c) for c in diagnosis.causes],
        "look_alikes": [c.effect for c in diagnosis.look_alikes],
        "figures": gap_figures(diagnosis),
        "waterfall": waterfall_figure(diagnosis.field, diagnosis.waterfall),
        "ambiguity": ambiguity_figure(diagnosis),
        "tests": tests_figure(diagnosis.tests),
        "advice": advice(diagnosis),
        "field_shrink": shrink_words(diagnosis.field),
        "heading_shrink": shrink_words(diagnosis.heading),
    }
    write_page(path, "gap.html", shown)


def write_trial_report(trial: Trial, path: Path) -> None:
    """Write the scoreboard of a blind trial. Raises UsageError where the file cannot be written."""
    rows = []
    for name, (hits, of) in trial.figures().items():
        low, high = wilson(hits, of)
        share = f"{100 * hits / of:.1f} %" if of else "-"
        drawn = interval_figure(low, hits / of, high) if of else ""
        rows.append(
            (_in_words(name), hits, of, share, f"{100 * low:.1f} to {100 * high:.1f}" if of else "-", drawn)
        )
    shown = {
        "trial": trial,
        "rows": rows,
        "reliability": reliability(trial),
    }
    write_page(path, "gap_trial.html", shown)


# The symbols of docs/gap.md, for who has not read it.
_SYMBOLS = {
    "d_sep": "separation",
    "d_perp": "part that nothing known mimics",
    "single, ": "one effect, ",
    "pair, ": "two effects, ",
    "withheld, ": "one that may not be named, ",
    ">=": "at least",
}


def _in_words(name: str) -> str:
    for symbol, words in _SYMBOLS.items():
        name = name.replace(symbol, words)
    return name[:1].upper() + name[1:]


def reliability(trial: Trial) -> list[tuple[str, int, str, str]]:
    """Group cases with one effect or more by separation: how many, the share named exactly, its drawing."""
    edges = (0.0, 3.0, 5.0, 7.0, 9.0, 12.0, 20.0, math.inf)
    rows = []
    for low, high in pairwise(edges):
        chosen = [c for c in trial.cases if c.label.tier != "none" and low <= c.separation < high]
        exact = sum(c.exact for c in chosen)
        share = f"{100 * exact / len(chosen):.0f} %" if chosen else "-"
        ends = wilson(exact, len(chosen))
        drawn = interval_figure(ends[0], exact / len(chosen), ends[1]) if chosen else ""
        name = f"{low:g} to {high:g}" if math.isfinite(high) else f"{low:g} and more"
        rows.append((name, len(chosen), share, drawn))
    return rows


def _cause(cause: Cause) -> dict[str, Any]:
    effect = catalogue()[cause.effect]
    return {
        "id": cause.effect,
        "title": effect.title,
        "probability": f"{100 * cause.probability:.0f} %",
        "field": f"{cause.removes_mgauss:.1f}",
        "heading": f"{cause.removes_deg:.1f}",
        "separation": None if cause.separation is None else f"{cause.separation:.0f}",
        "separated_by": effect.separated_by,
        "ambiguous_with": cause.ambiguous_with,
        "parameters": figures_of(cause),
    }
