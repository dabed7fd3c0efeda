"""Diagnosis: what is known about the gap of one recording, and its machine-readable form."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING, Literal

if TYPE_CHECKING:
    from mavcompass.gap.cure import Cured
    from mavcompass.gap.picture import Picture

Verdict = Literal["no_gap", "named", "ambiguous", "named_with_remainder", "unknown", "not_testable"]
SCHEMA = "mavcompass.gap/1"


@dataclass(frozen=True, slots=True)
class Cause:
    """Hold one named effect: its parameters, their 95 % intervals, how probable, what else it may be.

    `separation` is how many sigmas its best rival falls short; `removes_mgauss` the rms it explains.
    """

    effect: str
    parameters: Mapping[str, float]
    ci95: Mapping[str, tuple[float, float]]
    probability: float
    ambiguous_with: tuple[str, ...]
    separation: float | None = None
    removes_mgauss: float = 0.0


@dataclass(frozen=True, slots=True)
class Place:
    """Hold one place of the gap: a channel, a coordinate, and its share of what exceeds the floor."""

    channel: str
    coordinate: str
    share: float
    at: str


@dataclass(frozen=True, slots=True)
class Closing:
    """Hold how far a gap closes on held-out parts: before, after, floor, and the shrink with interval."""

    nominal: float
    after: float
    floor: float
    shrink: float
    shrink_ci95: tuple[float, float]


@dataclass(frozen=True, slots=True)
class Bar:
    """Hold one effect's part of the closing: its Shapley value in mG^2, and its range over all orders."""

    effect: str
    part_mgauss2: float
    lowest_mgauss2: float
    highest_mgauss2: float


@dataclass(frozen=True, slots=True)
class Flight:
    """Hold a proposal for the next recording: what it separates, and how well per minute."""

    protocol: str
    separates: tuple[str, ...]
    predicted_separation: float


@dataclass(frozen=True, slots=True)
class Diagnosis:
    """Hold the whole answer. `to_json` gives the document of the command line's contract.

    `field` and `heading` are about the vehicle beside its nominal simulation, which knows the calibration in
    force (`in_force`: what that cures, which is not sought). `corrected_rms_mgauss` is the corrected reading
    beside the plain field (None: no calibration is in force).
    """

    path: str
    sha256: str | None
    duration_s: float
    samples: int
    autopilot: str
    compass: int
    reference: str
    verdict: Verdict
    causes: tuple[Cause, ...]
    look_alikes: tuple[Cause, ...]
    ambiguity_set: tuple[tuple[tuple[str, ...], float], ...]
    where: tuple[Place, ...]
    field: Closing
    heading: Closing
    waterfall: tuple[Bar, ...]
    unknown: bool
    unknown_coordinate: str | None
    tests: tuple[tuple[str, float], ...]
    not_testable: tuple[tuple[str, str], ...]
    next_flight: tuple[Flight, ...]
    folded: tuple[str, ...]
    withheld: tuple[str, ...]
    seconds: float
    notes: tuple[str, ...] = ()
    corrected_rms_mgauss: float | None = None
    in_force: Cured | None = None
    picture: Picture | None = dataclasses.field(default=None, repr=False, compare=False)

    @property
    def effects(self) -> frozenset[str]:
        """Return the ids of the named causes."""
        return frozenset(cause.effect for cause in self.causes)

    def to_json(self) -> dict[str, object]:
        """Return the document `mavcompass.gap/1`, plain values only."""
        return {
            "schema": SCHEMA,
            "log": {
                "path": self.path,
                "sha256": self.sha256,
                "duration_s": self.duration_s,
                "samples": self.samples,
                "autopilot": self.autopilot,
            },
            "compass": self.compass,
            "reference": self.reference,
            "verdict": self.verdict,
            "causes": [_cause(c) for c in self.causes],
            "look_alikes": [_cause(c) for c in self.look_alikes],
            "ambiguity_set": [{"effects": list(ids), "weight": w} for ids, w in self.ambiguity_set],
            "where": [
                {"channel": p.channel, "coordinate": p.coordinate, "share": p.share, "at": p.at}
                for p in self.where
            ],
            "gap": {"field_rms_mgauss": _closing(self.field), "heading_rms_deg": _closing(self.heading)},
            "waterfall": [
                {
                    "effect": b.effect,
                    "part_mgauss2": b.part_mgauss2,
                    "range_mgauss2": [b.lowest_mgauss2, b.highest_mgauss2],
                }
                for b in self.waterfall
            ],
            "unknown": {
                "flagged": self.unknown,
                "coordinate": self.unknown_coordinate,
                "tests": [{"name": name, "p": p} for name, p in self.tests],
            },
            "not_testable": [{"effect": e, "why": why} for e, why in self.not_testable],
            "next_flight": [
                {
                    "protocol": f.protocol,
                    "separates": list(f.separates),
                    "predicted_separation": f.predicted_separation,
                }
                for f in self.next_flight
            ],
            "corrected_rms_mgauss": self.corrected_rms_mgauss,
            "in_force": self.in_force.to_json() if self.in_force is not None else None,
            "folded_from_baseline": list(self.folded),
            "withheld": list(self.withheld),
            "notes": list(self.notes),
            "seconds": self.seconds,
        }


def _cause(cause: Cause) -> dict[str, object]:
    return {
        "effect": cause.effect,
        "parameters": dict(cause.parameters),
        "ci95": {name: list(interval) for name, interval in cause.ci95.items()},
        "probability": cause.probability,
        "ambiguous_with": list(cause.ambiguous_with),
        "separation": cause.separation,
        "removes_mgauss": cause.removes_mgauss,
    }


def _closing(closing: Closing) -> dict[str, object]:
    return {
        "nominal": closing.nominal,
        "after": closing.after,
        "floor": closing.floor,
        "shrink": closing.shrink,
        "shrink_ci95": list(closing.shrink_ci95),
    }
