"""What a calibration gives: a correction, what is known of it in degrees, and a verdict."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from mavcompass.calibration.model import ACCELEROMETER, HeadingError
from mavcompass.correction import IDENTITY, FieldCorrection
from mavcompass.frames import NO_HEADING_RAD, FloatArray
from mavcompass.heading.deviation import NO_LOADS, DeviationCard, Loads, deviation_card, heading_change_rad
from mavcompass.heading.true_north import TrueNorth
from mavcompass.printable import plain

# A difference of so many sigmas is no chance.
BEYOND_CHANCE = 3.0
UNCERTAIN = "The heading would be uncertain"
# What no further position lowers.
_NOT_AVERAGED = (ACCELEROMETER, "disagreement")
# A smaller change of the iron may be an error of the attitude.
_IRON_MGAUSS = 15.0


@dataclass(frozen=True, slots=True)
class Limits:
    """Set what is accepted: the predicted heading error in degrees, 1 sigma rms over the circle.

    Attributes:
        by_motion: only what more motion would lower counts, not what the accelerometer itself may be off by.
    """

    heading_deg: float = 2.0
    by_motion: bool = False


DEFAULT_LIMITS = Limits()


@dataclass(frozen=True, slots=True, eq=False)
class Position:
    """Hold one still position as the report shows it.

    Attributes:
        turned_deg: the angle turned since the first position.
        mean_mgauss: the mean raw field, (3,). samples: fresh readings in it.
        residual_mgauss: measured less fitted, (3,); nan where the method has none.
    """

    turned_deg: float
    mean_mgauss: FloatArray
    samples: int
    residual_mgauss: FloatArray = field(default_factory=lambda: np.full(3, np.nan))


# Half a metre of hull laid along a line to a centimetre by eye.
BY_EYE_SIGMA_RAD = math.radians(1.0)


@dataclass(frozen=True, slots=True)
class TrueHeading:
    """Hold where the vehicle points, from true north, as a person or a second antenna tells it, radians.

    Attributes:
        by: the name in the evidence of the source that tells it, which then is no witness; "" for a person.
    """

    heading_rad: float
    sigma_rad: float = BY_EYE_SIGMA_RAD
    by: str = ""

    def to_json(self) -> dict[str, Any]:
        """Return it as plain values."""
        heading, sigma = math.degrees(self.heading_rad) % 360.0, math.degrees(self.sigma_rad)
        return {"heading_deg": heading, "sigma_deg": sigma}


@dataclass(frozen=True, slots=True)
class OwnFinding:
    """Hold what an autopilot's own calibration found of a compass: a correction, or why there is none."""

    correction: FieldCorrection | None = None
    why_not: str = ""


def true_heading(heading_rad: float | None, sigma_rad: float | None = None) -> TrueHeading | None:
    """Put a heading together, with the usual sigma where none is told; None where there is no heading."""
    if heading_rad is None:
        return None
    return TrueHeading(heading_rad) if sigma_rad is None else TrueHeading(heading_rad, sigma_rad)


@dataclass(frozen=True, slots=True)
class Witness:
    """Hold by how much another source's heading differs from a compass's: the constant part."""

    witness: str
    difference_deg: float
    sigma_deg: float
    contradicts: bool


@dataclass(frozen=True, slots=True, eq=False)
class Mounting:
    """Hold what is known of how a compass is mounted.

    Attributes:
        seen: True where something could have contradicted the mounting that is set.
        turned: the rotation (3, 3) after the mounting in force that is right; None where that is.
        angle_deg: of that rotation. setting: the parameters that set it; `no_setting` why there are none.
        mended: the calibration of the compass so mounted.
    """

    seen: bool = False
    turned: FloatArray | None = None
    angle_deg: float = 0.0
    setting: Mapping[str, float] = field(default_factory=dict)
    no_setting: str = ""
    mended: CalibrationResult | None = None

    def to_json(self) -> dict[str, Any]:
        """Return it as plain values."""
        return {"seen": self.seen, "angle_deg": self.angle_deg, "setting": dict(self.setting)}


@dataclass(frozen=True, slots=True)
class Change:
    """Say that what was recorded before a time does not fit the rest, and by how much the iron differed."""

    time_s: float
    moved_mgauss: float

    @property
    def is_iron(self) -> bool:
        """Tell whether iron aboard was moved; else it may be manoeuvres, or something that passed."""
        return self.moved_mgauss > _IRON_MGAUSS

    def words(self) -> str:
        """Say it in a sentence."""
        if self.is_iron:
            return (
                f"The iron changed by about {self.moved_mgauss:.0f} mG at {self.time_s:.0f} s: only what was "
                "recorded after it counts."
            )
        return (
            f"What was recorded before {self.time_s:.0f} s does not fit the rest (hard manoeuvres, or "
            "something magnetic nearby): only what came after counts."
        )


@dataclass(frozen=True, slots=True, eq=False)
class CalibrationResult:
    """Hold one compass's calibration.

    Attributes:
        instance: the compass, from 1. method: by which it was found.
        accepted: True where the correction is worth writing; `reasons` say why not, in a pilot's words.
        warnings: what the pilot should know although it is accepted.
        correction: to put in force. in_force: the one that was.
        covariance_names, covariance: of the fitted quantities.
        not_observable: quantities this motion cannot determine; where they came from is in `warnings`.
        residual_rms_mgauss: measured less fitted.
        heading_sigma_deg: the level heading's predicted error, 1 sigma, rms over the circle.
        heading_budget_deg: its parts by source; their squares add up.
        heading_error: the same as a function of heading and tilt; None for methods without covariance.
        heading_change_deg: old correction against new on the same field, rms over the circle.
        heading_change_max_deg: the largest such difference.
        horizontal_mgauss, vertical_mgauss: the Earth's field the fit arrived at.
        positions: the still positions used.
        loads: motor loads that stand for those recorded; headings old and new are compared at these.
        evidence: what else tells the heading, and how far that is from this one.
        north: what course and second antenna show of true headings; None where they were not looked at.
        mounting: what is known of it.
        already_right: True where the values in force are no worse beyond the new ones' sigma.
        true_heading: that was given; at it every such calibration agrees, whatever is true.
        not_seen_deg: twelfths of the circle that a drive did not point to, by their first magnetic heading.
        changed: when the iron last changed in a drive, None where it did not; only what came after counts.
        parameters: the autopilot's parameters that put the correction in force.
    """

    instance: int
    method: str
    accepted: bool
    reasons: tuple[str, ...]
    correction: FieldCorrection
    in_force: FieldCorrection = IDENTITY
    warnings: tuple[str, ...] = ()
    covariance_names: tuple[str, ...] = ()
    covariance: FloatArray = field(default_factory=lambda: np.zeros((0, 0)))
    not_observable: tuple[str, ...] = ()
    residual_rms_mgauss: float = math.nan
    heading_sigma_deg: float = math.nan
    heading_budget_deg: Mapping[str, float] = field(default_factory=dict)
    heading_error: HeadingError | None = None
    heading_change_deg: float = math.nan
    heading_change_max_deg: float = math.nan
    horizontal_mgauss: float = math.nan
    vertical_mgauss: float = math.nan
    positions: tuple[Position, ...] = ()
    loads: tuple[Loads, ...] = (NO_LOADS,)
    evidence: tuple[Witness, ...] = ()
    north: TrueNorth | None = None
    mounting: Mounting = field(default_factory=Mounting)
    already_right: bool = False
    true_heading: TrueHeading | None = None
    not_seen_deg: tuple[int, ...] = ()
    changed: Change | None = None
    parameters: Mapping[str, float] = field(default_factory=dict)

    @property
    def sure_gain_deg(self) -> float:
        """Return by how much at least it lowers the heading error in force, at three sigmas; 0 if unsure."""
        return (
            max(self.heading_change_deg - BEYOND_CHANCE * self.heading_sigma_deg, 0.0)
            if self.accepted
            else 0.0
        )

    @property
    def raw_offset_mgauss(self) -> FloatArray:
        """Return the hard iron, (3,): raw = field + offset."""
        return -np.asarray(self.correction.offsets_mgauss)

    @property
    def repeatable_sigma_deg(self) -> float:
        """Return the part of the heading's sigma that further positions would lower."""
        shared_deg = math.hypot(*(self.heading_budget_deg.get(name, 0.0) for name in _NOT_AVERAGED))
        return _without(self.heading_sigma_deg, shared_deg)

    def change_rad(self, roll_rad: float = 0.0, pitch_rad: float = 0.0) -> FloatArray:
        """Return by how much the heading changes from the values in force, (72 by load), radians."""
        return np.concatenate(
            [
                heading_change_rad(
                    self.in_force,
                    self.correction,
                    self.horizontal_mgauss,
                    self.vertical_mgauss,
                    roll_rad,
                    pitch_rad,
                    self.mounting.turned,
                    loads,
                )
                for loads in self.loads
            ]
        )

    def in_force_error_deg(self) -> FloatArray | None:
        """Return how far off the heading in force is, (72,), by this; None where the field is unknown."""
        field = (self.horizontal_mgauss, self.vertical_mgauss)
        known = math.isfinite(sum(field))
        return np.degrees(heading_change_rad(self.in_force, self.correction, *field)) if known else None

    def widened(self, sigma_deg: float, source: str) -> CalibrationResult:
        """Claim a larger heading sigma; what it grows by is counted for a source of the budget."""
        sigma_deg = min(sigma_deg, math.degrees(NO_HEADING_RAD))
        if not sigma_deg > self.heading_sigma_deg:
            return self
        budget = {**self.heading_budget_deg}
        grown = math.sqrt(sigma_deg**2 - self.heading_sigma_deg**2)
        budget[source] = math.hypot(budget.get(source, 0.0), grown)
        error = self.heading_error
        if error is not None:
            error = HeadingError(error.state, error.covariance * (sigma_deg / self.heading_sigma_deg) ** 2)
        return replace(self, heading_sigma_deg=sigma_deg, heading_budget_deg=budget, heading_error=error)

    def compared(self) -> CalibrationResult:
        """Add what changes in the heading from the correction in force."""
        change_deg = np.degrees(self.change_rad())
        rms, largest = math.sqrt(float((change_deg**2).mean())), float(np.abs(change_deg).max())
        return replace(self, heading_change_deg=rms, heading_change_max_deg=largest)

    def within(self, limits: Limits, why: str = "") -> CalibrationResult:
        """Accept it with no reason against it and a sigma within the limit; `why` is what widened that."""
        reasons, sigma_deg = self.reasons, self.heading_sigma_deg
        if limits.by_motion:
            sigma_deg = _without(sigma_deg, self.heading_budget_deg.get(ACCELEROMETER, 0.0))
        if not sigma_deg <= limits.heading_deg and not any(UNCERTAIN in reason for reason in reasons):
            uncertain = f"{UNCERTAIN} by {sigma_deg:.1f} degrees (limit {limits.heading_deg:g})."
            reasons = (*reasons, why or uncertain)
        return replace(self, reasons=reasons, accepted=not reasons)

    def at_least(self, scatter_rad: float, limits: Limits) -> CalibrationResult:
        """Claim no less than a heading scatter that was seen to be left, and judge again by it."""
        scatter = math.degrees(scatter_rad)
        if scatter <= self.heading_sigma_deg:
            return self
        left = (
            f"The corrected heading would still scatter by {scatter:.1f} degrees about the gyro's "
            f"(limit {limits.heading_deg:g}): motors, something magnetic, or manoeuvres not followed."
        )
        return self.widened(scatter, "disturbance").within(limits, left)

    def to_json(self) -> dict[str, Any]:
        """Return the entry of `compasses` in the calibration JSON; nan becomes null."""
        given = {} if self.true_heading is None else {"true_heading": self.true_heading.to_json()}
        said = {
            "instance": self.instance,
            "method": self.method,
            "accepted": self.accepted,
            "already_right": self.already_right,
            **given,
            "reasons": self.reasons,
            "warnings": self.warnings,
            "raw_offset_mgauss": self.raw_offset_mgauss,
            "correction": self.correction,
            "covariance": {"names": self.covariance_names, "matrix": self.covariance},
            "not_observable": self.not_observable,
            "residual_rms_mgauss": self.residual_rms_mgauss,
            "heading_sigma_deg": self.heading_sigma_deg,
            "heading_error_budget_deg": self.heading_budget_deg,
            "heading_change_deg": self.heading_change_deg,
            "heading_change_max_deg": self.heading_change_max_deg,
            "field_mgauss": {"horizontal": self.horizontal_mgauss, "vertical": self.vertical_mgauss},
            "deviation_card": self._card_json(),
            "evidence": self.evidence,
            "true_north": None if self.north is None else self.north.to_json(),
            "mounting": self.mounting.to_json(),
            "positions": self.positions,
            "parameters": {name: float(value) for name, value in self.parameters.items()},
        }
        document: dict[str, Any] = plain(said)
        return document

    def deviation_card(self, headings: int = 8) -> DeviationCard:
        """Draw the deviation card of the correction that was in force, by this calibration."""
        circle = np.arange(72) * (2.0 * math.pi / 72)
        sigma = None if self.heading_error is None else self.heading_error.sigma_rad(circle)
        return deviation_card(
            self.in_force, self.correction, self.horizontal_mgauss, self.vertical_mgauss, headings, sigma
        )

    def _card_json(self) -> dict[str, Any] | None:
        if not math.isfinite(self.horizontal_mgauss + self.vertical_mgauss):
            return None
        try:
            card = self.deviation_card()
        except ValueError:
            # The correction in force shows one heading all round: there is no card of it.
            return None
        kept = ("compass_deg", "deviation_deg", "coefficients_deg")
        return {name: getattr(card, name) for name in kept}


def summary(result: CalibrationResult) -> str:
    """Say what was found and how good it is."""
    x, y, z = result.correction.offsets_mgauss
    dx, dy, _ = result.correction.diagonals
    if not result.accepted:
        return f"Compass {result.instance}: not accepted."
    if result.already_right:
        sigma_deg = max(result.heading_sigma_deg, result.heading_change_deg)
        return f"Compass {result.instance}: already right, within {sigma_deg:.2f} deg (1 sigma)."
    text = f"Compass {result.instance}: good"
    if math.isfinite(result.heading_sigma_deg):
        text += f", heading within {result.heading_sigma_deg:.2f} deg (1 sigma)"
    if math.isfinite(result.heading_change_deg):
        text += f", {result.heading_change_deg:.1f} deg off before"
    text = f"{text}. Offsets {x:.1f} {y:.1f} {z:.1f} mG, scale {dx:.3f} {dy:.3f}"
    if any(result.correction.motor_mgauss):
        text += f", motors {_motor_words(result.correction)}"
    return f"{text}."


def _motor_words(correction: FieldCorrection) -> str:
    of_each = "; ".join(f"{x:.1f} {y:.1f} {z:.1f}" for x, y, z in correction.motors.tolist())
    if correction.motor_source == "outputs":
        return f"1 to 4 each by itself: {of_each} mG per (output x volt)^{correction.motor_exponent:g}"
    return f"{of_each} {'mG/A' if correction.motor_source == 'current' else 'mG at full throttle'}"


def before_and_after(result: CalibrationResult) -> str:
    """Say by how much a heading is off with the values in force, and with the new ones."""
    if result.already_right or not result.accepted:
        return summary(result)
    old, new = result.heading_change_deg, result.heading_sigma_deg
    told = [f"{value:.{digits}f}" for value, digits in ((old, 1), (new, 2)) if math.isfinite(value)]
    return f"Compass {result.instance}: {' -> '.join(told) or '?'} deg off."


def surest(results: Sequence[CalibrationResult]) -> CalibrationResult:
    """Return the result whose heading is known best, the first of equals."""
    return min(results, key=lambda r: r.heading_sigma_deg if math.isfinite(r.heading_sigma_deg) else math.inf)


def _without(sigma: float, part: float) -> float:
    """Return what a sigma is without a part of it."""
    return math.sqrt(max(sigma**2 - part**2, 0.0))
