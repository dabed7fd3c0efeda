"""What a rehearsal tells, and the stored diagnosis (`gap diagnose --json`) that one may begin with."""

from __future__ import annotations

import json
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from mavcompass.errors import UsageError
from mavcompass.files import read_text, sha256_of
from mavcompass.gap.result import SCHEMA as DIAGNOSIS_SCHEMA
from mavcompass.gap.result import Belief, Cause, Verdict, plain

SCHEMA = "mavcompass.gap-rehearsal/1"
_AS_THEY_ARE = (
    "draws", "compared", "refused", "positions", "claimed_deg", "stances", "seed", "notes", "seconds",
)  # fmt: skip


@dataclass(frozen=True, slots=True)
class Expected:
    """Hold the rms heading error over the circle to expect, degrees.

    `rms_deg` is over all vehicles drawn; 95 of 100 of them stay below `at_most95_deg`.
    """

    rms_deg: float
    median_deg: float
    at_most95_deg: float


@dataclass(frozen=True, slots=True)
class Errors:
    """Hold the heading error to expect on the level, and leaning by 15 degrees in any direction."""

    level: Expected
    tilted: Expected


@dataclass(frozen=True, slots=True)
class Part:
    """Hold what makes a part of the error: an effect, or a source of it, and the error without.

    `share` is the part of the level error's square that goes with it, `share_tilted` of the tilted one's.
    """

    name: str
    is_effect: bool
    without: Errors
    share: float
    share_tilted: float


@dataclass(frozen=True, slots=True)
class Remedy:
    """Hold what was tried instead of the usual calibration, the error with it, and how much lower that is.

    `change` and `change_tilted` are ratios of rms errors, of the same vehicles: 0.5 halves it.
    """

    words: str
    errors: Errors
    change: float
    change_tilted: float


@dataclass(frozen=True, slots=True)
class Rehearsal:
    """Hold the whole answer.

    Attributes:
        source: the recording. compass: from 1. effects: what the vehicle may have.
        errors: to expect after calibrating this vehicle by four positions, used as in the recording.
        parts: the budget, the largest first. remedies: what was tried, the best first.
        draws: how many vehicles; compared: how many of them for each part and remedy; refused: how many fits
            had no solution. positions: how many were visited, on the average.
        claimed_deg: what the calibration itself would say of its level error, 1 sigma rms.
        stances: how many calm stretches the recording shows. notes: what to know about all this.
    """

    source: str
    compass: int
    effects: tuple[str, ...]
    errors: Errors
    parts: tuple[Part, ...]
    remedies: tuple[Remedy, ...]
    draws: int
    compared: int
    refused: int
    positions: float
    claimed_deg: float
    stances: int
    seed: int
    seconds: float
    notes: tuple[str, ...] = ()

    @property
    def dominant(self) -> Part | None:
        """Return what makes most of the level error; None where nothing makes a tenth of it."""
        return self.parts[0] if self.parts and self.parts[0].share >= 0.1 else None

    def to_json(self) -> dict[str, object]:
        """Return the document `mavcompass.gap-rehearsal/1`, plain values only."""
        return {
            "schema": SCHEMA,
            "log": self.source,
            "compass": self.compass,
            "effects": list(self.effects),
            "heading_error_deg": _errors(self.errors),
            "budget": [
                {
                    "name": part.name,
                    "kind": "effect" if part.is_effect else "source",
                    "share": part.share,
                    "share_tilted": part.share_tilted,
                    "without": _errors(part.without),
                }
                for part in self.parts
            ],
            "dominant": self.dominant.name if self.dominant is not None else None,
            "remedies": [
                {
                    "what": remedy.words,
                    "change": remedy.change,
                    "change_tilted": remedy.change_tilted,
                    "heading_error_deg": _errors(remedy.errors),
                }
                for remedy in self.remedies
            ],
        } | {name: plain(getattr(self, name)) for name in _AS_THEY_ARE}


def _errors(errors: Errors) -> dict[str, object]:
    return {
        name: {
            "rms": expected.rms_deg,
            "median": expected.median_deg,
            "interval95": [0.0, expected.at_most95_deg],
        }
        for name, expected in (("level", errors.level), ("tilt_15", errors.tilted))
    }


@dataclass(frozen=True, slots=True)
class Stored:
    """Hold what a rehearsal takes from a diagnosis, and the recording that it is of."""

    recording: Path
    compass: int
    verdict: Verdict
    causes: tuple[Cause, ...]
    beliefs: tuple[Belief, ...]


def read_stored(path: Path) -> Stored:
    """Read a diagnosis and find its recording, where it was or beside the file.

    Raises UsageError where the file is no diagnosis, or its recording is gone or another.
    """
    try:
        document = json.loads(read_text(path))
        if document["schema"] != DIAGNOSIS_SCHEMA:
            raise ValueError(document["schema"])
        log = document["log"]
        stored = Stored(
            recording=_recording(path, log["path"], log["sha256"]),
            compass=document["compass"],
            verdict=document["verdict"],
            causes=tuple(map(_cause, document["causes"])),
            beliefs=tuple(map(Belief.from_json, document["beliefs"])),
        )
    except (OSError, ValueError, KeyError, TypeError, AttributeError, OverflowError, RecursionError) as error:
        raise UsageError(
            f"{path} is no diagnosis that can be rehearsed.",
            "Name the recording itself, or what `mavcompass gap diagnose LOG --json FILE` writes for one"
            " recording; what earlier versions wrote does not hold enough.",
        ) from error
    return stored


def _recording(path: Path, named: str, sha256: str) -> Path:
    places = (Path(named), path.parent / Path(named).name)
    found = next((place for place in places if place.is_file()), None)
    if found is None:
        raise UsageError(
            f"{path} is the diagnosis of {named}, which is not there.",
            "A rehearsal also needs the recording, for how the vehicle stands: put it beside the diagnosis.",
        )
    if sha256_of(found) != sha256:
        raise UsageError(
            f"{found} is not the recording that {path} is the diagnosis of.", "Diagnose it anew."
        )
    return found


def _cause(document: dict[str, Any]) -> Cause:
    return Cause(
        effect=document["effect"],
        parameters={name: float(value) for name, value in document["parameters"].items()},
        ci95={name: (float(low), float(high)) for name, (low, high) in document["ci95"].items()},
        probability=float(document["probability"]),
        ambiguous_with=tuple(document["ambiguous_with"]),
    )
