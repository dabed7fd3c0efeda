"""The single questions of the pre-flight check: pure functions from what was read to pass, warn or fail."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from typing import Any, Literal

import numpy as np

from mavcompass import messages as mav
from mavcompass.calibration.observation import UNREST
from mavcompass.compass_parameters import ardupilot_name, ardupilot_naming, px4_name
from mavcompass.correction import FieldCorrection
from mavcompass.earth_field import EarthField
from mavcompass.enums import EkfFlag
from mavcompass.frames import FloatArray, wrap_pi
from mavcompass.heading.fault_isolation import HeadingSource, isolate_faults

Verdict = Literal["pass", "warn", "fail"]
_ORDER: tuple[Verdict, ...] = ("pass", "warn", "fail")

# What ArduPilot documents as the usual range of offsets, and beyond what it will not arm.
_USUAL_OFFSET_MGAUSS = 400.0
_MOST_OFFSET_MGAUSS = 1800.0
# Compasses that are calibrated as well as people do it point the same way within so much.
AGREEMENT_DEG = 5.0
# Two that are each as sure as this are apart by more in one case of a hundred where both are sound.
AGREEMENT_SIGMA_DEG = 1.0
# Field strength on Earth, with room for the crust.
_EARTH_MGAUSS = (185.0, 720.0)


@dataclass(frozen=True, slots=True)
class CheckItem:
    """Hold the answer to one question.

    Attributes:
        name: field, dip, agreement, offsets, matrix, device, use, gyro, estimator, prearm, turn, place.
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
            "value": self.value if math.isfinite(self.value) else None,
            "limit": self.limit if math.isfinite(self.limit) else None,
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


def _grade(value: float, warn: float, fail: float) -> Verdict:
    return "pass" if value <= warn else "warn" if value <= fail else "fail"


def judge_offsets(instance: int, correction: FieldCorrection) -> CheckItem:
    """Judge the offsets in force: none at all is no calibration, and very large ones hide trouble."""
    size = math.hypot(*correction.offsets_mgauss)
    if size == 0.0:
        return CheckItem(
            "offsets",
            "fail",
            f"Compass {instance} has never been calibrated.",
            "Calibrate it.",
            instance,
            0.0,
        )
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
    verdict = _grade(ratio, 1.35, 2.5)
    remedy = (
        "" if verdict == "pass" else "Calibrate; if it comes out the same, look for iron near the compass."
    )
    text = f"Compass {instance}: matrix stretches one axis {ratio:.2f} times the other."
    return CheckItem("matrix", verdict, text, remedy, instance, ratio, 1.35)


def judge_device(instance: int, autopilot: str, parameters: Mapping[str, float]) -> list[CheckItem]:
    """Judge whether the autopilot uses this compass and takes its calibration for its own."""
    if autopilot == "px4":
        id_name, use_name = px4_name("ID", instance), px4_name("PRIO", instance)
    else:
        naming = ardupilot_naming(parameters)
        id_name, use_name = (ardupilot_name(q, instance, naming) for q in ("DEV_ID", "USE"))
    items: list[CheckItem] = []
    if parameters.get(id_name) == 0.0:
        text = f"Compass {instance} has no device id ({id_name} is 0): its calibration will not be used."
        items.append(CheckItem("device", "fail", text, "Connect the compass and calibrate it.", instance))
    if parameters.get(use_name) == 0.0:
        text = f"Compass {instance} is not used ({use_name} is 0)."
        remedy = "Set it to 1 if this compass is meant to steer." if instance == 1 else ""
        items.append(CheckItem("use", "warn" if instance == 1 else "pass", text, remedy, instance))
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
    strength, dip = _grade(abs(percent), 6.0, 15.0), _grade(abs(dip_deg), 3.0, 8.0)
    stronger = "stronger" if percent > 0 else "weaker"
    field_text = (
        f"Compass {i}: the field is {abs(percent):.1f} % {stronger} than the Earth's is here"
        f" ({world.total_mgauss:.0f} mG)."
    )
    dip_text = f"Compass {i}: the field's dip is {abs(dip_deg):.1f} deg off the Earth's here."
    return [
        CheckItem("field", strength, field_text, "" if strength == "pass" else remedy, i, percent, 6.0),
        CheckItem("dip", dip, dip_text, "" if dip == "pass" else remedy, i, dip_deg, 3.0),
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
        items.append(CheckItem("agreement", "pass", f"The compasses {numbers} agree with each other."))
    return items


def _apart(instance: int, text: str, apart_deg: float, whom: str) -> CheckItem:
    remedy = f"Calibrate {whom}; if it stays, check the mounting orientation."
    limit_deg = AGREEMENT_DEG
    verdict = _grade(abs(apart_deg), limit_deg, 3.0 * limit_deg)
    return CheckItem("agreement", verdict, text, remedy, instance, apart_deg, limit_deg)


def judge_gyro(rate_radps: FloatArray) -> CheckItem:
    """Judge the gyro of a vehicle at rest, (N, 3): its mean is a bias that bends every measured turn."""
    bias_dps = float(np.degrees(np.linalg.norm(rate_radps.mean(axis=0))))
    verdict = _grade(bias_dps, 0.7, 2.0)
    remedy = "" if verdict == "pass" else "Hold still and restart the autopilot, so that it learns the bias."
    return CheckItem(
        "gyro", verdict, f"The gyro drifts by {bias_dps:.2f} deg/s at rest.", remedy, 0, bias_dps, 0.7
    )


def judge_stillness(still: bool, why_not: str) -> CheckItem | None:
    """Warn where the vehicle never stood still; None where it did."""
    if still:
        return None
    text = f"The vehicle did not stand still ({UNREST.get(why_not, why_not)}): the figures below are rough."
    return CheckItem("stillness", "warn", text, "Put it down, let it come to rest and check again.")


def judge_estimator(ekf: mav.EkfStatusReport | None) -> CheckItem | None:
    """Judge what the autopilot's estimator says of the compass; None where it says nothing."""
    if ekf is None:
        return None
    if ekf.flags & EkfFlag.UNINITIALIZED or not ekf.flags & EkfFlag.ATTITUDE:
        remedy = "Wait until it has started; hold the vehicle still meanwhile."
        return CheckItem("estimator", "fail", "The attitude estimate is not healthy.", remedy)
    variance = ekf.compass_variance
    verdict = _grade(variance, 0.5, 0.8)
    remedy = "" if verdict == "pass" else "Wait a minute; if it stays, calibrate and restart the autopilot."
    text = f"The autopilot's estimator gives the compass a variance of {variance:.2f}."
    return CheckItem("estimator", verdict, text, remedy, 0, variance, 0.5)


def judge_prearm(texts: Iterable[str]) -> list[CheckItem]:
    """Pass on what the autopilot itself has against its compasses."""
    seen: dict[str, CheckItem] = {}
    for text in texts:
        about_compass = any(word in text.lower() for word in ("compass", "mag field", "magnetometer"))
        if about_compass and text.lower().startswith(("prearm", "arm:", "preflight")):
            seen[text] = CheckItem("prearm", "fail", f'The autopilot says "{text}".', "Calibrate.")
    return list(seen.values())


def judge_turn(instance: int, field_turned_deg: float, gyro_turned_deg: float, sigma_deg: float) -> CheckItem:
    """Judge a turn as the compass saw it against the gyro's, given what is not known of the difference."""
    off_deg = math.degrees(float(wrap_pi(math.radians(field_turned_deg - gyro_turned_deg))))
    limit_deg = max(3.0, 3.0 * sigma_deg)
    verdict = _grade(abs(off_deg), limit_deg, max(8.0, 2.0 * limit_deg))
    remedy = "" if verdict == "pass" else "Calibrate."
    text = (
        f"Compass {instance} saw a turn of {field_turned_deg:.1f} deg, the gyro one of"
        f" {gyro_turned_deg:.1f} deg ({off_deg:+.1f})."
    )
    return CheckItem("turn", verdict, text, remedy, instance, off_deg, limit_deg)
