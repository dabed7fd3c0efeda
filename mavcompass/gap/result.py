"""Diagnosis: what is known about the gap of one recording, and its machine-readable form."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from mavcompass.correction import MotorSource
from mavcompass.frames import FloatArray
from mavcompass.printable import plain

Verdict = Literal["no_gap", "named", "ambiguous", "named_with_remainder", "unknown", "not_testable"]
SCHEMA = "mavcompass.gap/1"
_OF_THE_LOG = ("path", "sha256", "duration_s", "samples", "autopilot")
_AS_THEY_ARE = (
    "compass", "reference", "verdict", "causes", "look_alikes", "where", "waterfall", "next_flight", "late_s",
    "corrected_rms_mgauss", "withheld", "notes", "seconds",
)  # fmt: skip
# Where a belief has the field, the matrix, the offset and the motors; and where its effects begin.
FIELD, MATRIX, OFFSET, MOTOR, EFFECTS = slice(0, 3), slice(3, 12), slice(12, 15), slice(15, 18), 18


@dataclass(frozen=True, slots=True)
class Cause:
    """Hold one named effect: its parameters, their 95 % intervals, how probable, what else it may be.

    `separation` is how many sigmas its best rival falls short; `removes_mgauss` and `removes_deg` are the
    rms of field and heading that it explains, of readings that were not fitted.
    """

    effect: str
    parameters: Mapping[str, float]
    ci95: Mapping[str, tuple[float, float]]
    probability: float
    ambiguous_with: tuple[str, ...]
    separation: float | None = None
    removes_mgauss: float = 0.0
    removes_deg: float = 0.0

    @classmethod
    def detected(
        cls, effect: str, values: Mapping[str, float], sigma: Mapping[str, float], removes_mgauss: float = 0.0
    ) -> Cause:
        """Describe an effect that was read off by itself: its values, with standard deviations if any."""
        off = {name: 1.96 * sigma.get(name, 0.0) for name in values}
        ends = {name: (value - off[name], value + off[name]) for name, value in values.items()}
        return cls(effect, values, ends, 1.0, (), removes_mgauss=removes_mgauss)


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
    range_mgauss2: tuple[float, float]


@dataclass(frozen=True, slots=True)
class Flight:
    """Hold a proposal for the next recording: what it separates, and how well per minute."""

    protocol: str
    separates: tuple[str, ...]
    predicted_separation: float


@dataclass(frozen=True, slots=True, eq=False)
class Iron:
    """Hold what a vehicle makes of a field: raw = A field + b + motor load.

    Attributes:
        matrix: A (3, 3). offset_mgauss: b (3,). motor_mgauss: the field per unit of the motors' load, (3,).
    """

    matrix: FloatArray
    offset_mgauss: FloatArray
    motor_mgauss: FloatArray

    def changed(self, matrix: FloatArray, offset_mgauss: FloatArray, motor_mgauss: FloatArray) -> Iron:
        """Return A (1 + E) for E, (9,) or (3, 3), with more of offset and motors, (3,) each."""
        bent = self.matrix @ (np.eye(3) + matrix.reshape(3, 3))
        return Iron(bent, self.offset_mgauss + offset_mgauss, self.motor_mgauss + motor_mgauss)


@dataclass(frozen=True, slots=True, eq=False)
class CalibrationInForce:
    """Hold the vehicle's iron as its calibration, and its baseline, describe it.

    Attributes:
        calibrated: False where no calibration is in force.
        cures: what the calibration in force cures. tuned: the same with what the recordings add to it.
        taught: how much of that the baseline alone showed beside its calibration; of the matrix the change,
            relative to A.
        motor_source: the load that the motor term goes with.
        sigma_heading_deg: how far the calibration may be off, in heading.
    """

    calibrated: bool
    cures: Iron
    tuned: Iron
    taught: Iron
    motor_source: MotorSource
    sigma_heading_deg: float

    def to_json(self) -> dict[str, object]:
        """Return the cures for machines."""
        return {
            "cures": {
                "hard_iron": self.cures.offset_mgauss.tolist(),
                "matrix": self.cures.matrix.tolist(),
                "motor": self.cures.motor_mgauss.tolist(),
            },
            "sigma_heading_deg": self.sigma_heading_deg,
        }

    def words(self) -> str | None:
        """Say in a line what the calibration cures; None where there is nothing to say."""
        if not self.calibrated:
            return None
        iron = self.cures
        said = f"hard iron ({_listed(iron.offset_mgauss, 0)}) mG"
        if not np.allclose(iron.matrix, np.eye(3), atol=1e-6):
            said += f", gains {_listed(np.diag(iron.matrix), 3)}"
        if np.abs(iron.motor_mgauss).max() > 0.0:
            unit = "mG per A" if self.motor_source == "current" else "mG at full throttle"
            said += f", motors ({_listed(iron.motor_mgauss, 1)}) {unit}"
        return said


@dataclass(frozen=True, slots=True, eq=False)
class PosteriorComponent:
    """Hold one explanation of a recording, a normal distribution over place, vehicle and effects.

    The values are, one after the other: what the world's field is more than its model, north, east, down, mG;
    E of the vehicle's matrix A (1 + E), row by row; what its offset, mG, and its motors' field, mG per unit
    of load, are more than the calibration in force says; then every parameter of each effect.

    Attributes:
        weight: how probable it is, beside the other explanations.
        effects: the ids of its effects, in the order of their values; places: where these begin.
        mean, covariance: (P,), (P, P); what was not fitted does not vary.
    """

    weight: float
    effects: tuple[str, ...]
    places: tuple[int, ...]
    mean: FloatArray
    covariance: FloatArray

    def to_json(self) -> dict[str, object]:
        """Return the belief for machines; of the covariance the lower triangle, row by row."""
        return plain(self) | {"covariance": self.covariance[np.tril_indices(self.mean.size)].tolist()}

    @classmethod
    def from_json(cls, document: Mapping[str, Any]) -> PosteriorComponent:
        """Read what `to_json` wrote. Raises KeyError, TypeError or ValueError for anything else."""
        mean = np.array(document["mean"], dtype=np.float64)
        if len(document["covariance"]) != mean.size * (mean.size + 1) // 2:
            raise ValueError("a covariance of another size than its mean")
        covariance = np.zeros((mean.size, mean.size))
        covariance[np.tril_indices(mean.size)] = document["covariance"]
        covariance += np.tril(covariance, -1).T
        effects, places = tuple(document["effects"]), tuple(document["places"])
        return cls(document["weight"], effects, places, mean, covariance)


@dataclass(frozen=True, slots=True, eq=False)
class Picture:
    """Hold arrays for plots.

    Attributes:
        time_s: (N,); valid, test: rows with data, rows held out.
        before_mgauss, after_mgauss: residual of the field without and with the effects, (N, 3).
        coordinates: values (N,) and unit by name; tilt and heading in degrees among them.
        innovations: what is left, in sigmas, (N, 3).
    """

    time_s: FloatArray
    valid: NDArray[np.bool_]
    test: NDArray[np.bool_]
    before_mgauss: FloatArray
    after_mgauss: FloatArray
    coordinates: dict[str, tuple[FloatArray, str]]
    innovations: FloatArray


@dataclass(frozen=True, slots=True)
class Diagnosis:
    """Hold the whole answer. `to_json` gives the document of the command line's contract.

    `field` and `heading` are about the vehicle beside its nominal simulation, which knows the calibration in
    force (`in_force`: what that cures, which is not sought). `corrected_rms_mgauss` is the corrected reading
    beside the plain field (None: no calibration is in force). `beliefs` are the explanations as
    distributions: one, or those between which the recording does not decide. `late_s` is how late readings
    come, where that is more than autopilots' usually are and no baseline tells whether it was always so.
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
    late_s: float | None = None
    corrected_rms_mgauss: float | None = None
    in_force: CalibrationInForce | None = None
    beliefs: tuple[PosteriorComponent, ...] = dataclasses.field(default=(), repr=False, compare=False)
    picture: Picture | None = dataclasses.field(default=None, repr=False, compare=False)

    @property
    def effects(self) -> frozenset[str]:
        """Return the ids of the named causes."""
        return frozenset(cause.effect for cause in self.causes)

    def to_json(self) -> dict[str, object]:
        """Return the document `mavcompass.gap/1`, plain values only."""
        return {
            "schema": SCHEMA,
            "log": {name: getattr(self, name) for name in _OF_THE_LOG},
            **{name: plain(getattr(self, name)) for name in _AS_THEY_ARE},
            "ambiguity_set": [{"effects": list(ids), "weight": w} for ids, w in self.ambiguity_set],
            "gap": {"field_rms_mgauss": plain(self.field), "heading_rms_deg": plain(self.heading)},
            "unknown": {
                "flagged": self.unknown,
                "coordinate": self.unknown_coordinate,
                "tests": [{"name": name, "p": p} for name, p in self.tests],
            },
            "not_testable": [{"effect": e, "why": why} for e, why in self.not_testable],
            "in_force": self.in_force.to_json() if self.in_force is not None else None,
            "folded_from_baseline": list(self.folded),
            "beliefs": [belief.to_json() for belief in self.beliefs],
        }


def _listed(values: FloatArray, digits: int) -> str:
    return ", ".join(f"{value:.{digits}f}" for value in values.tolist())
