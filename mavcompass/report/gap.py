"""The reports of a gap diagnosis, of a blind trial and of a rehearsal: self-contained HTML files.

A rehearsal, in words, too: what heading error to expect, what makes it, what would lower it.
"""

from __future__ import annotations

import math
from itertools import pairwise
from pathlib import Path
from typing import TYPE_CHECKING, Any

from mavcompass.chance import wilson
from mavcompass.gap.rehearsal import Expected, Part, Rehearsal, Remedy
from mavcompass.gap.result import Cause, Diagnosis
from mavcompass.report.gap_figures import (
    ambiguity_figure,
    gap_figures,
    interval_figure,
    tests_figure,
    waterfall_figure,
)
from mavcompass.report.gap_words import (
    REFERENCES,
    RMS_OF,
    SHADES,
    VERDICTS,
    advice,
    channel_words,
    could_not_show,
    figures_of,
    shrink_words,
)
from mavcompass.report.svg import bars, write_page
from mavcompass.simulation.effects import catalogue, get

if TYPE_CHECKING:
    from mavcompass.gap.trial import Trial

_MOST_PLACES = 10


def write_gap_report(diagnosis: Diagnosis, path: Path) -> None:
    """Write the report of a diagnosis. Raises UsageError where the file cannot be written."""
    facts = {
        "Recording": diagnosis.path or "unknown",
        "Length": f"{diagnosis.duration_s:.0f} s, {diagnosis.samples} readings",
        "Compass": str(diagnosis.compass),
        "Attitude from": REFERENCES[diagnosis.reference],
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
        "places": [(channel_words(p.channel), p) for p in diagnosis.where[:_MOST_PLACES]],
        "not_testable": [
            (why, [catalogue()[effect].title for effect in effects])
            for why, effects in could_not_show(diagnosis).items()
        ],
        "field_shrink": shrink_words(diagnosis.field),
        "heading_shrink": shrink_words(diagnosis.heading),
    }
    write_page(path, "gap.html", shown)


def write_trial_report(trial: Trial, path: Path) -> None:
    """Write the scoreboard of a blind trial. Raises UsageError where the file cannot be written."""
    rows = []
    for name, (hits, of) in trial.figures().items():
        if of:  # else no case of its kind was drawn
            low, high = wilson(hits, of)
            share, ends = f"{100 * hits / of:.1f} %", f"{100 * low:.1f} to {100 * high:.1f}"
            rows.append((_IN_WORDS[name], hits, of, share, ends, interval_figure(low, hits / of, high)))
    shown = {
        "trial": trial,
        "rows": rows,
        "reliability": reliability(trial),
    }
    write_page(path, "gap_trial.html", shown)


_TAKEN_OUT, _NEVER_IN = "A fault taken out of the catalogue", "A fault that was never in the catalogue"
# The scoreboard's figures, for who has not read docs/gap.md.
_IN_WORDS = {
    "no effect: named or unknown": "No fault: it claimed one all the same (should be rare)",
    "single, d_sep >= 9: exact": "One fault, plain to see: named, and nothing else",
    "single, d_sep 5 to 9: in the set": "One fault, faint: among the answers it gave",
    "single without shift (noise, steps, repeats): exact": "One fault of noise, steps or repeats: named",
    "pair, both d_sep >= 9: exact": "Two faults, both plain to see: both named, and nothing else",
    "pair, both d_sep >= 9: in the set": "Two faults, both plain to see: among the answers it gave",
    "withheld, d_perp >= 12: flagged": f"{_TAKEN_OUT}: it said that something unknown is left",
    "withheld, d_perp >= 12: misnamed": f"{_TAKEN_OUT}: it blamed another (should be rare)",
    "outside, d_perp >= 12: flagged": f"{_NEVER_IN}: it said that something unknown is left",
    "outside, d_perp >= 12: misnamed": f"{_NEVER_IN}: it blamed another (should be rare)",
    "restored, d_perp >= 12 and d_sep >= 9: exact": "That fault, put back: named, and nothing else",
    "restored, d_perp >= 12: in the set": "That fault, put back: among the answers it gave",
    "restored: within 5 % of the oracle": "That fault, put back: corrected as by who knows it, within 5 %",
    "shrink's interval covers the true shrink": "What a correction brings was within the interval told",
    "confident wrong names": "It was sure of a fault that was not there (should be rare)",
    "after above nominal": "Its correction made it worse, on data it had not seen (should be rare)",
}


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


_SOURCES = {
    "noise": "noise of the compass",
    "quantisation": "whole numbers on the wire",
    "tilt": "what is not known of the tilt",
    "gyro": "what is not known of the turns",
    "motors": "a field of the motors that this recording does not exclude",
    "field": "the field here, which is not quite the world model's",
}
# A ratio of rms errors from here on is not worth a person's time.
_WORTH = 0.9
_LEAST_SHARE = 0.02


def rehearsal_summary(rehearsal: Rehearsal) -> list[str]:
    """Put a rehearsal in a few lines for a terminal."""
    errors = rehearsal.heading_error_deg
    lines = [
        f"Expect {_expected(errors.level)} of heading error on the level, {_expected(errors.tilt_15)} leaning"
        " by 15 deg.",
        f"  {rehearsal.draws} vehicles of this kind calibrated, {rehearsal.positions:.1f} positions each;"
        f" the calibration itself would claim {rehearsal.claimed_deg:.2f} deg (compass {rehearsal.compass})",
    ]
    if rehearsal.refused:
        lines.append(f"  {rehearsal.refused} of them could not be calibrated at all")
    for share, where in (("share", "on the level"), ("share_tilted", "leaning")):
        parts = sorted(rehearsal.parts, key=lambda part: -getattr(part, share))
        said = [f"{part_words(p)} {100 * getattr(p, share):.0f} %" for p in parts[:3]
                if getattr(p, share) >= _LEAST_SHARE]  # fmt: skip
        lines.append(f"  made of, {where}: {', '.join(said) or 'many small parts, none by itself'}")
    helpful = [remedy for remedy in rehearsal.remedies if is_worth_it(remedy)]
    lines += [f"  lower with {remedy_words(remedy)}" for remedy in helpful]
    if not helpful:
        lines.append("  nothing that was tried lowers it much")
    return [*lines, *(f"  {note}" for note in rehearsal.notes)]


def is_worth_it(remedy: Remedy) -> bool:
    """Tell whether a remedy lowers one of the errors by a tenth and raises neither by as much."""
    changes = (remedy.change, remedy.change_tilted)
    return min(changes) <= _WORTH and max(changes) < 1.0 / _WORTH


def part_words(part: Part) -> str:
    """Name an effect by its id and title, a source of error in words."""
    return f"{part.name} ({get(part.name).title})" if part.kind == "effect" else _SOURCES[part.name]


def remedy_words(remedy: Remedy) -> str:
    """Say what was done and what it brings."""
    level, tilted = remedy.heading_error_deg.level.rms, remedy.heading_error_deg.tilt_15.rms
    return f"{remedy.what}: {level:.2f} deg on the level, {tilted:.2f} leaning"


def _expected(expected: Expected) -> str:
    return f"{expected.rms:.2f} deg rms (95 of 100 below {expected.interval95[1]:.2f})"


def write_rehearsal_report(rehearsal: Rehearsal, path: Path) -> None:
    """Write the report of a rehearsal. Raises UsageError where the file cannot be written."""
    first, *rest = rehearsal_summary(rehearsal)
    figures = []
    for share, where in (("share", "On the level"), ("share_tilted", "Leaning by 15 deg")):
        rows = [(part.name, 100.0 * max(getattr(part, share), 0.0)) for part in rehearsal.parts]
        figures.append((where, bars(sorted(rows, key=lambda row: -row[1]), "%", where)))
    shown = {
        "sentence": first,
        "lines": rest,
        "r": rehearsal,
        "parts": [(part_words(part), part) for part in rehearsal.parts],
        "remedies": [(remedy, is_worth_it(remedy)) for remedy in rehearsal.remedies],
        "figures": figures,
        "facts": {
            "Recording": rehearsal.source or "unknown",
            "Compass": str(rehearsal.compass),
            "What the vehicle may have": ", ".join(rehearsal.effects) or "nothing beside its known iron",
            "Vehicles": f"{rehearsal.draws}, seed {rehearsal.seed}; parts and remedies on the first"
            f" {rehearsal.compared} of them",
            "How it stands": f"as in {rehearsal.stances} calm stretches, after a turn where there are such",
        },
    }
    write_page(path, "gap_rehearsal.html", shown)
