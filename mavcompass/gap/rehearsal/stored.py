"""A diagnosis as `gap diagnose --json` wrote it: as much of it as a rehearsal needs."""

from __future__ import annotations

import json
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from mavcompass.errors import UsageError
from mavcompass.files import read_text, sha256_of
from mavcompass.gap.result import SCHEMA, Belief, Cause, Verdict


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
        if document["schema"] != SCHEMA:
            raise ValueError(document["schema"])
        log = document["log"]
        stored = Stored(
            recording=_recording(path, log["path"], log["sha256"]),
            compass=document["compass"],
            verdict=document["verdict"],
            causes=tuple(map(_cause, document["causes"])),
            beliefs=tuple(map(Belief.from_json, document["beliefs"])),
        )
    except (
        OSError,
        ValueError,
        KeyError,
        TypeError,
        AttributeError,
        OverflowError,
        RecursionError,
    ) as error:
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
