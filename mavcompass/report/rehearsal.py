"""A rehearsal in words and as a page: what heading error to expect, what makes it, what would lower it."""

from __future__ import annotations

from pathlib import Path

from mavcompass.gap.rehearsal import Expected, Part, Rehearsal, Remedy
from mavcompass.report.page import write_page
from mavcompass.report.svg import bars
from mavcompass.simulation.effects import get

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
