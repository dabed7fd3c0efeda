"""The questions of the pre-flight check, from what was read to pass, warn or fail; and the list of them."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Literal

import numpy as np

from mavcompass import messages as mav
from mavcompass.calibration.observation import unrest
from mavcompass.calibration.result import CalibrationResult
from mavcompass.compass_parameters import px4_name
from mavcompass.correction import FieldCorrection
from mavcompass.earth_field import EarthField
from mavcompass.enums import EkfFlag
from mavcompass.frames import FloatArray, wrap_pi
from mavcompass.gravity import REMEDY, no_gravity
from mavcompass.heading.fault_isolation import HeadingSource, isolate_faults
from mavcompass.heading.true_north import TrueNorth
from mavcompass.kinds import HOVERING
from mavcompass.printable import counted, named, plain
from mavcompass.procedure.turning import strategies_for
from mavcompass.procedure.vehicle_state import VehicleIdentity
from mavcompass.steering import PX4_COMPASSES, SteeringSource
from mavcompass.track import Series

Verdict = Literal["pass", "warn", "fail"]
_ORDER: tuple[Verdict, ...] = ("pass", "warn", "fail")

# What ArduPilot documents as the usual range of offsets, and beyond what it will not arm.
_USUAL_OFFSET_MGAUSS = 400.0
_MOST_OFFSET_MGAUSS = 1800.0
# Compasses that are calibrated as well as people do it point the same way within so much.
AGREEMENT_DEG = 5.0
# Two that are each as sure as this are apart by more in one case of a hundred where both are sound.
AGREEMENT_SIGMA_DEG = 1.0
_STEERING: dict[SteeringSource, str] = {
    **{i: f"compass {i} steers it" for i in PX4_COMPASSES},
    "gps": "the satellite receivers steer it",
    "other": "no compass steers it",
    None: "its parameters do not tell which compass steers it",
}
# Field strength on Earth, with room for the crust.
_EARTH_MGAUSS = (185.0, 720.0)
SCHEMA = "mavcompass.check/1"
_GOES = {**dict.fromkeys((*HOVERING, "plane"), "fly"), "sub": "dive", "boat": "sail", "unknown": "set out"}


@dataclass(frozen=True, slots=True)
class CheckItem:
    """Hold the answer to one question.

    Attributes:
        name: field, dip, agreement, offsets, matrix, switches, data, gyro, level, estimator, yaw, prearm,
            turn, place, stillness.
        instance: the compass it is about, 0 for the vehicle.
        text: one short sentence. remedy: the next step, empty for a pass.
    """

    name: str
    verdict: Verdict
    text: str
    remedy: str = ""
    instance: int = 0
    value: float = math.nan
    limit: float = math.nan

    def to_json(self) -> dict[str, Any]:
        """Return it as plain values."""
        return {
            "name": self.name,
            "compass": self.instance or None,
            "verdict": self.verdict,
            "text": self.text,
            "remedy": self.remedy,
            "value": plain(self.value),
            "limit": plain(self.limit),
        }


@dataclass(frozen=True, slots=True)
class Reading:
    """Hold what one compass showed while the vehicle stood still: field of the levelled vehicle, mGauss.

    Attributes:
        horizontal_mgauss, vertical_mgauss, heading_rad: of the field as the calibration in force gives it.
    """

    instance: int
    horizontal_mgauss: float
    vertical_mgauss: float
    heading_rad: float

    @property
    def total_mgauss(self) -> float:
        """Return the field's length."""
        return math.hypot(self.horizontal_mgauss, self.vertical_mgauss)

    @property
    def dip_rad(self) -> float:
        """Return its angle below the horizon."""
        return math.atan2(self.vertical_mgauss, self.horizontal_mgauss)


def worst(verdicts: Iterable[Verdict]) -> Verdict:
    """Return the worst of verdicts; pass for none."""
    return max(verdicts, key=_ORDER.index, default="pass")


def _graded(
    name: str, value: float, warn: float, fail: float, text: str, remedy: str, instance: int = 0
) -> CheckItem:
    """Grade how large a figure is; what passes needs no remedy."""
    size = abs(value)
    verdict: Verdict = "pass" if size <= warn else "warn" if size <= fail else "fail"
    return CheckItem(name, verdict, text, "" if verdict == "pass" else remedy, instance, value, warn)


def judge_offsets(instance: int, correction: FieldCorrection, calibrated: bool) -> CheckItem:
    """Judge the offsets in force: none at all may be no calibration, and very large ones hide trouble."""
    size = math.hypot(*correction.offsets_mgauss)
    if not calibrated:
        text = f"Compass {instance} has never been calibrated."
        return CheckItem("offsets", "fail", text, "Calibrate it.", instance, 0.0)
    largest = max(abs(value) for value in correction.offsets_mgauss)
    verdict: Verdict = (
        "fail" if size > _MOST_OFFSET_MGAUSS else "warn" if largest > _USUAL_OFFSET_MGAUSS else "pass"
    )
    remedy = "Move the compass away from iron and magnets, then calibrate." if verdict != "pass" else ""
    text = f"Compass {instance}: offsets {size:.0f} mG"
    return CheckItem("offsets", verdict, f"{text}.", remedy, instance, largest, _USUAL_OFFSET_MGAUSS)


def judge_matrix(instance: int, correction: FieldCorrection) -> CheckItem:
    """Judge how much the matrix in force bends the field: the ratio of its singular values."""
    values = np.linalg.svd(correction.matrix, compute_uv=False)
    ratio = float(values[0] / values[-1]) if values[-1] > 0.0 else math.inf
    remedy = "Calibrate; if it comes out the same, look for iron near the compass."
    text = f"Compass {instance}: matrix stretches one axis {ratio:.2f} times the other."
    return _graded("matrix", ratio, 1.35, 2.5, text, remedy, instance)


def judge_silence(instance: int, message: str, autopilot: str, steers: bool) -> CheckItem:
    """Judge a compass that has an id and never spoke; what an id alone promises is a remark.

    ArduPilot's ids are those of the sensors found at the start, PX4's may be of sensors that are gone.
    """
    text = f"No readings of compass {instance} came"
    if autopilot == "px4" and not steers:
        text += f"; {px4_name('ID', instance)} may hold the id of a sensor that is gone."
        return CheckItem("data", "pass", text, instance=instance)
    remedy = f"See that the link carries {message}; if it does, check the compass's cable."
    return CheckItem("data", "fail" if steers else "warn", f"{text}.", remedy, instance)


def judge_too_few(instance: int, message: str, readings: int, rate_hz: float) -> CheckItem:
    """Judge a compass that spoke too seldom while the vehicle stood still."""
    text = (
        f"Compass {instance}: too few readings ({readings}) came while the vehicle stood still, at"
        f" {rate_hz:.1f} Hz."
    )
    remedy = f"Have the link carry {message} at 10 Hz or more, and check again."
    return CheckItem("data", "warn", text, remedy, instance, float(readings))


def judge_yaw(instance: int, off_deg: float, source: SteeringSource) -> CheckItem:
    """Judge the autopilot's own yaw, less the declination, against one compass's heading."""
    steers = "which steers it" if source == instance else f"while {_STEERING[source]}"
    text = f"The autopilot's own yaw is {abs(off_deg):.1f} deg from compass {instance}, {steers}."
    own = "Let it settle and check again; if it stays, restart the autopilot."
    other = "Hold both against a landmark: either the compass is wrong, or what steers."
    return _graded(
        "yaw",
        off_deg,
        AGREEMENT_DEG,
        3.0 * AGREEMENT_DEG,
        text,
        own if source == instance else other,
        instance,
    )


def judge_calibration(found: CalibrationResult) -> CheckItem | None:
    """Judge the values in force by a calibration of all that was recorded, at its three sigmas."""
    instance = found.instance
    if found.mounting.turned is not None:
        remedy = "Calibrate with --orientation." if found.mounting.mended else "Set that right first."
        return CheckItem("mounting", "fail", found.reasons[0], remedy, instance)
    if not found.accepted:
        return None
    text = (
        f"Compass {instance}: its heading was {found.heading_change_deg:.1f} deg off in this recording"
        f" (within {found.heading_sigma_deg:.2f})."
    )
    most_deg = 3.0 * AGREEMENT_DEG
    return _graded("calibration", found.sure_gain_deg, AGREEMENT_DEG, most_deg, text, "Calibrate.", instance)


def judge_north(instance: int, north: TrueNorth) -> list[CheckItem]:
    """Judge a compass's heading against true ones that were seen on the way."""
    remedy = "Where it is so at other places, too, it is how the compass is mounted; else the rocks here."
    items = []
    for text, off_deg, sigma_deg in north.proofs(instance):
        limit_deg = max(3.0, 3.0 * sigma_deg)
        items.append(_graded("north", off_deg, limit_deg, 3.0 * limit_deg, text, remedy, instance))
    return items


def judge_field(reading: Reading, world: EarthField | None) -> list[CheckItem]:
    """Judge strength and dip of the field against the world model, or against any place on Earth."""
    i, total = reading.instance, reading.total_mgauss
    remedy = "Move away from iron (concrete, cars, rails) and check again; if it stays, calibrate."
    if world is None:
        low, high = _EARTH_MGAUSS
        good = low <= total <= high
        text = f"Compass {i}: the field is {total:.0f} mG; the place is not known, so any on Earth counts."
        return [CheckItem("field", "pass" if good else "fail", text, "" if good else remedy, i, total, high)]
    percent = 100.0 * (total / world.total_mgauss - 1.0)
    dip_deg = math.degrees(reading.dip_rad - world.inclination_rad)
    stronger = "stronger" if percent > 0 else "weaker"
    field_text = (
        f"Compass {i}: the field is {abs(percent):.1f} % {stronger} than the Earth's is here"
        f" ({world.total_mgauss:.0f} mG)."
    )
    dip_text = f"Compass {i}: the field's dip is {abs(dip_deg):.1f} deg off the Earth's here."
    return [
        _graded("field", percent, 6.0, 15.0, field_text, remedy, i),
        _graded("dip", dip_deg, 3.0, 8.0, dip_text, remedy, i),
    ]


def judge_agreement(sources: Mapping[int, HeadingSource]) -> list[CheckItem]:
    """Judge whether the compasses, by instance, point the same way, and which is wrong where they do not."""
    if len(sources) < 2:
        return []
    found, instances = isolate_faults(list(sources.values())), list(sources)
    items = [
        _apart(instances[k], found.why(k), math.degrees(found.apart_rad(k)), f"compass {instances[k]}")
        for k in found.blamed
    ]
    if found.undecided:
        apart_deg = max((math.degrees(found.apart_rad(k)) for k in range(len(instances))), key=abs)
        text = f"The compasses point {abs(apart_deg):.0f} deg apart; a turn tells which is wrong."
        items.append(_apart(0, text, apart_deg, "both"))
    if not items:
        numbers = ", ".join(str(instance) for instance in instances)
        items.append(CheckItem("agreement", "pass", f"Compasses {numbers} agree."))
    return items


def _apart(instance: int, text: str, apart_deg: float, whom: str) -> CheckItem:
    remedy = f"Calibrate {whom}; if it stays, check the mounting orientation."
    return _graded("agreement", apart_deg, AGREEMENT_DEG, 3.0 * AGREEMENT_DEG, text, remedy, instance)


def judge_gyro(rate_radps: FloatArray, seen: Sequence[tuple[Sequence[float], float]] = ()) -> CheckItem:
    """Judge the gyro of a vehicle at rest, (N, 3): its mean is a bias that bends every measured turn.

    What floats or flies is never quite at rest: what level and compasses see it rotate, rates (3,) and the
    sigma of each one's turn, rad/s, is taken out.
    """
    weights = np.array([max(sigma, 1e-6) ** -2.0 for _, sigma in seen])
    turns = weights.sum() > 0.0
    moved = weights @ np.array([rates for rates, _ in seen]) / weights.sum() if turns else np.zeros(3)
    sigma_dps = math.degrees(weights.sum() ** -0.5) if turns else 0.0
    bias_dps = float(np.degrees(np.linalg.norm(rate_radps.mean(axis=0) - moved)))
    warn, fail = (math.hypot(limit, 2.0 * sigma_dps) for limit in (0.7, 2.0))
    remedy = "Hold still and restart the autopilot, so that it learns the bias."
    drift = f"{bias_dps:.2f} deg/s" + (f" (give or take {sigma_dps:.2f})" if turns else "")
    return _graded("gyro", bias_dps, warn, fail, f"The gyro drifts by {drift} at rest.", remedy)


def judge_level(acc: Series | None) -> CheckItem | None:
    """Fail an accelerometer that shows no gravity: headings by it mean nothing; None where it does."""
    trouble = no_gravity(acc)
    return CheckItem("level", "fail", trouble, REMEDY) if trouble else None


def judge_stillness(still: bool, why_not: str) -> CheckItem | None:
    """Warn where the vehicle never stood still; None where it did."""
    if still:
        return None
    text = f"The vehicle did not stand still ({unrest(why_not)}): the figures below are rough."
    return CheckItem("stillness", "warn", text, "Put it down, let it come to rest and check again.")


def judge_estimator(said: mav.EkfStatusReport | mav.EstimatorStatus | None) -> CheckItem | None:
    """Judge what the autopilot's estimator says of the compass; None where it says nothing."""
    if said is None:
        return None
    ardupilot = isinstance(said, mav.EkfStatusReport)
    ready = said.flags & EkfFlag.ATTITUDE and not (ardupilot and said.flags & EkfFlag.UNINITIALIZED)
    if not ready:
        remedy = "Wait until it has started; hold the vehicle still meanwhile."
        return CheckItem("estimator", "fail", "The attitude estimate is not healthy.", remedy)
    # Innovations by what is allowed of them: PX4 does not arm above 0.5 (COM_ARM_EKF_YAW), rejects above 1.
    ratio = said.compass_variance if isinstance(said, mav.EkfStatusReport) else said.mag_ratio
    remedy = "Wait a minute; if it stays, calibrate and restart the autopilot."
    if math.isnan(ratio):
        text = "The autopilot's estimator does not use the compass."
        return CheckItem("estimator", "fail", text, "Move away from iron; if it stays, calibrate.")
    text = f"The autopilot's estimator gives the compass a variance of {ratio:.2f}."
    return _graded("estimator", ratio, 0.5, 0.8 if ardupilot else 1.0, text, remedy)


def judge_prearm(texts: Iterable[str]) -> list[CheckItem]:
    """Pass on what the autopilot itself has against its compasses."""
    seen: dict[str, CheckItem] = {}
    for text in texts:
        about_compass = any(word in text.lower() for word in ("compass", "mag field", "magnet", "heading"))
        if about_compass and text.lower().startswith(("prearm", "arm:", "preflight")):
            seen[text] = CheckItem("prearm", "fail", f'The autopilot says "{text}".', "Calibrate.")
    return list(seen.values())


def judge_turn(instance: int, field_turned_deg: float, gyro_turned_deg: float, sigma_deg: float) -> CheckItem:
    """Judge a turn as the compass saw it against the gyro's, given what is not known of the difference."""
    off_deg = math.degrees(float(wrap_pi(math.radians(field_turned_deg - gyro_turned_deg))))
    limit_deg = max(3.0, 3.0 * sigma_deg)
    text = (
        f"Turned by compass {instance} {field_turned_deg:.1f} deg, by the gyro {gyro_turned_deg:.1f} deg"
        f" ({off_deg:+.1f})."
    )
    return _graded("turn", off_deg, limit_deg, max(8.0, 2.0 * limit_deg), text, "Calibrate.", instance)


def _is_calibration(item: CheckItem) -> bool:
    return "alibrate" in item.remedy


@dataclass(frozen=True, slots=True)
class CheckReport:
    """Hold the list; `verdict` is that of its worst item, `remarks` what else to know of the parameters."""

    identity: VehicleIdentity
    items: tuple[CheckItem, ...]
    turned: bool
    duration_s: float
    remarks: tuple[str, ...] = ()

    @property
    def verdict(self) -> Verdict:
        """Return pass, warn or fail."""
        return worst(item.verdict for item in self.items)

    @property
    def calibration_advised(self) -> bool:
        """Tell whether a calibration is the remedy of something that is not right."""
        return any(item.verdict != "pass" and _is_calibration(item) for item in self.items)

    @property
    def turns_itself(self) -> bool:
        """Tell whether a calibration can have the vehicle turn on the spot."""
        return bool(strategies_for(self.identity.kind, self.identity.autopilot))

    def summary(self) -> str:
        """Say it in a sentence, and where something is wrong in another that nothing was turned."""
        wrong = [item for item in self.items if item.verdict == self.verdict]
        go, count = _GOES.get(self.identity.kind, "drive"), counted(len(self.items), "check")
        told = self.turned or any(item.name == "turn" for item in self.items)
        unturned = "" if told else " No turn was made."
        match self.verdict:
            case "pass":
                return f"Fit to {go}: {count} passed{'' if self.turned else ', without a turn'}."
            case "warn":
                more = f", and {len(wrong) - 1} more" if len(wrong) > 1 else ""
                return f"Fit to {go}, with care: {wrong[0].text.rstrip('.')}{more}.{unturned}"
        cured = sorted({item.instance for item in wrong if item.instance and _is_calibration(item)})
        what = f"calibrate {named([f'compass {i}' for i in cured])}" if cured else wrong[0].text.rstrip(".")
        return f"Not fit to {go}: {what}. {len(wrong)} of {count} failed.{unturned}"

    def to_json(self) -> dict[str, Any]:
        """Return the machine-readable form."""
        return {
            "schema": SCHEMA,
            "autopilot": self.identity.autopilot,
            "vehicle": self.identity.kind,
            "verdict": self.verdict,
            "summary": self.summary(),
            "turned": self.turned,
            "calibration_advised": self.calibration_advised,
            "items": [item.to_json() for item in self.items],
            "remarks": list(self.remarks),
            "duration_s": self.duration_s,
        }
