"""Watch the compass in service and say early, and why, when its calibration no longer holds.

Everything here compares the compass with something that does not come from it: the world magnetic model,
the other compasses, the gyro, the GPS course, the battery's current.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from typing import Literal

import numpy as np

from mavcompass.attitude.level import BIAS_SIGMA_RADPS
from mavcompass.earth_field import EarthField
from mavcompass.frames import FloatArray, wrap_angle, wrap_pi
from mavcompass.heading.fault_isolation import HeadingSource, isolate_faults
from mavcompass.heading.live import Heading
from mavcompass.service.config import WatchConfig
from mavcompass.service.standing import FieldStep

Severity = Literal["warning", "bad"]

_DEG = math.pi / 180.0
# A value must be beyond its limit for so long before it counts, and so long well inside before it does not.
_RAISE_S = 5.0
_CLEAR_S = 10.0
_CLEAR_BELOW = 0.7
_BAD_ABOVE = 2.5  # times the limit
# Turns of 3 degrees tell nothing of iron: a gyro drifts by as much in a minute. And a tenth of one is noise.
_NO_TURN_RAD, _NOT_LATE_RAD = 3.0 * _DEG, 0.1 * _DEG
_TURN_RAD, _SPREAD_A = 2.0 * math.pi, 0.7
COURSE_SPEED_MPS = 1.5  # slower, the receiver's noise turns its course
_AHEAD_KINDS = frozenset({"rover", "boat"})  # a sub is pushed sideways, too


@dataclass(frozen=True, slots=True)
class Finding:
    """Hold one thing that is wrong with a compass in service.

    Attributes:
        id: what was compared: field, dip, agreement, gyro, course, current, step, age, device, parameters; or
            link.
        instance: the compass, 0 for none of them.
        short: at most 50 letters, for STATUSTEXT. text: a sentence. remedy: what to do.
        value, limit: what was measured and what is tolerated, in the unit that the text names.
        method: of the calibration that puts it right, where one does without more ado.
    """

    id: str
    instance: int
    severity: Severity
    short: str
    text: str
    remedy: str
    value: float = math.nan
    limit: float = math.nan
    method: str = ""


@dataclass(frozen=True, slots=True)
class Glance:
    """Hold what the watch looks at, ten times a second or less.

    Attributes:
        time_s: on the link's clock. headings: the latest of each compass.
        rate_radps: by the gyro, about the vertical, less bias_radps. stands: disarmed, and still.
        tilt_sigma_rad: of roll and pitch. kind: of vehicle.
        course_rad, speed_mps: over ground by GPS; None without a fix. current_a: None where not measured.
    """

    time_s: float
    headings: Mapping[int, Heading]
    world: EarthField | None
    rate_radps: float
    bias_radps: float
    stands: bool
    tilt_sigma_rad: float
    kind: str
    course_rad: float | None
    speed_mps: float
    current_a: float | None


@dataclass(slots=True)
class _Latch:
    """Remember whether a value counts as beyond its limit, with patience both ways."""

    active: bool = False
    _since_s: float | None = None

    def update(self, time_s: float, value: float, limit: float) -> bool:
        crossing = value < limit * _CLEAR_BELOW if self.active else value > limit
        if not crossing:
            self._since_s = None
        elif self._since_s is None:
            self._since_s = time_s
        elif time_s - self._since_s >= (_CLEAR_S if self.active else _RAISE_S):
            self.active, self._since_s = not self.active, None
        return self.active


def _forgetting(weight: float, amount: float, span: float) -> tuple[float, float]:
    """Return an average's weight after `amount` more of its `span`, and the share of the newest sample."""
    new = -math.expm1(-amount / span)
    weight = (1.0 - new) * weight + new
    return weight, new / weight if new > 0.0 else 0.0


@dataclass(slots=True)
class _Average:
    """Average over about `span` of whatever passes (seconds, radians turned)."""

    span: float = 10.0
    value: float = 0.0
    weight: float = 0.0

    def add(self, sample: float, amount: float) -> None:
        self.weight, share = _forgetting(self.weight, amount, self.span)
        self.value += share * (sample - self.value)

    @property
    def known(self) -> bool:
        return self.weight > 0.3


@dataclass(slots=True)
class _Covariance:
    """Average the mean and the covariance of values over about `span` of whatever passes."""

    span: float
    weight: float = 0.0
    _mean: FloatArray | float = 0.0
    products: FloatArray = field(default_factory=lambda: np.zeros((0, 0)))

    def add(self, values: FloatArray, amount: float) -> None:
        self.weight, share = _forgetting(self.weight, amount, self.span)
        before = values - self._mean
        self._mean = self._mean + share * before
        now = np.outer(before, values - self._mean)
        self.products = self.products + share * (now - self.products) if self.products.size else share * now

    def beside(self, known: int, least: float) -> FloatArray:
        """Return the covariance of the rest beside what goes with the first ones, told from `least` up."""
        first, both, rest = (
            self.products[:known, :known],
            self.products[known:, :known],
            self.products[known:, known:],
        )
        return np.asarray(rest - both @ np.linalg.solve(first + least**2 * np.eye(known), both.T))


@dataclass(slots=True)
class _GyroComparison:
    """Compare the heading's change with the gyro's, per angle turned.

    What comes between them where nothing turns for long is the gyro's drift: it teaches nothing of the
    compass. Nor does what goes with the time, as far as a gyro's bias may at two sigmas, or with how late a
    reading is (0 to 0.25 s, by firmware and stream), or what changes from one reading to the next: noise.
    """

    _seen: _Covariance = field(default_factory=lambda: _Covariance(_TURN_RAD))
    _noise2: _Average = field(default_factory=lambda: _Average(_TURN_RAD))
    _turned_s: float = -math.inf
    _last: FloatArray | None = None
    _sum: FloatArray = field(default_factory=lambda: np.zeros(5))

    def add(self, heading: Heading) -> None:
        late, drift_rad = (heading.newer_rad, heading.older_rad), BIAS_SIGMA_RADPS * heading.boot_s
        now = np.array([*late, heading.from_gyro_rad, drift_rad, heading.turned_rad])
        steps = np.zeros(5) if self._last is None else now - self._last
        self._last, turned = now, abs(float(steps[4]))
        self._turned_s = heading.boot_s if turned >= 0.003 else self._turned_s
        if heading.boot_s - self._turned_s > _RAISE_S:
            return
        self._sum += (steps := wrap_pi(steps))
        self._seen.add(self._sum[:4], turned)
        self._noise2.add(0.5 * float(steps[2]) ** 2, turned)

    @property
    def rms_rad(self) -> float:
        """Return by how much they differ; nan before a third of a turn."""
        if self._seen.weight <= 0.3:
            return math.nan
        (off2, both), (_, drift2) = self._seen.beside(2, _NOT_LATE_RAD)
        sigmas = min(max(both / max(drift2, _NOT_LATE_RAD**2), -2.0), 2.0)
        off2 -= (2.0 * both - sigmas * drift2) * sigmas + self._noise2.value
        return math.sqrt(max(float(off2), 0.0))


@dataclass(slots=True)
class _CurrentCoupling:
    """Find how the field, level and vertical, goes with the current, beside how it goes with turns (iron)."""

    _seen: _Covariance = field(default_factory=lambda: _Covariance(60.0))

    def add(self, current_a: float, heading: Heading, step_s: float) -> None:
        turned_rad, level = heading.turned_rad, (heading.horizontal_mgauss, heading.level_mgauss[2])
        self._seen.add(np.array([math.cos(turned_rad), math.sin(turned_rad), current_a, *level]), step_s)

    def swing_mgauss(self) -> float:
        """Return how far the field goes with the current, 0 where they are not seen to go together."""
        if self._seen.weight < 0.3:
            return 0.0
        (ii, ih, iz), (_, hh, _), (_, _, zz) = self._seen.beside(2, _NO_TURN_RAD)
        if ii < _SPREAD_A**2 or ih * ih + iz * iz < 0.4 * ii * (hh + zz):
            return 0.0
        # Two standard deviations either side cover the range of the current.
        return float(4.0 * math.hypot(ih, iz) / ii * math.sqrt(self._seen.products[2, 2]))


@dataclass(slots=True)
class _CompassRecord:
    """Hold what the watch knows of one compass."""

    strength: _Average = field(default_factory=_Average)
    dip: _Average = field(default_factory=_Average)
    apart: _Average = field(default_factory=_Average)
    leaning: _Average = field(default_factory=_Average)
    course: _Average = field(default_factory=lambda: _Average(20.0))
    gyro: _GyroComparison = field(default_factory=_GyroComparison)
    current: _CurrentCoupling = field(default_factory=_CurrentCoupling)
    step: FieldStep = field(default_factory=FieldStep)
    latches: dict[str, _Latch] = field(default_factory=dict)
    told: dict[str, Finding] = field(default_factory=dict)

    def beyond_level_deg(self, value_deg: float, steepness: float) -> float:
        """Take out of a value what the level may be off by, at two sigmas, `steepness` times."""
        chance = 2.0 * steepness * self.leaning.value
        return math.copysign(math.sqrt(max(value_deg**2 - chance**2, 0.0)), value_deg)


class CompassWatch:
    """Take glances, keep the findings."""

    def __init__(self, limits: WatchConfig) -> None:
        self.limits = limits
        self.findings: tuple[Finding, ...] = ()
        self._records: dict[int, _CompassRecord] = {}
        self._latest_s = math.nan
        self._steep = 2.0  # the dip's tangent where most people live

    def restart(self) -> None:
        """Forget everything: the vehicle was restarted or its calibration was changed."""
        self.findings = ()
        self._records.clear()
        self._latest_s = math.nan

    def update(self, glance: Glance) -> tuple[Finding, ...]:
        """Look once and return the findings in force."""
        step_s = glance.time_s - self._latest_s
        self._latest_s = glance.time_s
        if not 0.0 < step_s < 5.0:  # the first, or after a silence: nothing has passed in between
            return self.findings
        fresh = {i: h for i, h in glance.headings.items() if glance.time_s - h.time_s <= 1.0}
        if glance.world is not None:
            self._steep = math.tan(abs(glance.world.inclination_rad))
        for instance, heading in fresh.items():
            self._learn(self._records.setdefault(instance, _CompassRecord()), heading, glance, step_s)
        apart = self._at_fault(list(fresh))
        self.findings = tuple(
            finding
            for i in fresh
            for finding in self._judge(self._records[i], i, glance, *apart.get(i, (0.0, "")))
        )
        return self.findings

    def _learn(self, record: _CompassRecord, heading: Heading, glance: Glance, step_s: float) -> None:
        record.leaning.add(glance.tilt_sigma_rad / _DEG, step_s)
        world = glance.world
        if world is not None:
            record.strength.add(100.0 * (heading.total_mgauss / world.total_mgauss - 1.0), step_s)
            record.dip.add((heading.dip_rad - world.inclination_rad) / _DEG, step_s)
        first = glance.headings.get(1)
        if first is not None and heading.instance != 1 and glance.time_s - first.time_s < 1.0:
            record.apart.add(wrap_angle(heading.from_gyro_rad - first.from_gyro_rad) / _DEG, step_s)
        still = (glance.rate_radps, glance.bias_radps, glance.stands)
        record.step.add(heading, *still, step_s, self.limits.step_deg)
        record.gyro.add(heading)
        course = glance.course_rad
        if course is not None and heading.true_rad is not None and _drives_straight_ahead(glance):
            off = wrap_angle(course - heading.true_rad) / _DEG
            if abs(off) < 135.0:  # otherwise it drives backwards
                record.course.add(off, step_s)
        if glance.current_a is not None:
            record.current.add(glance.current_a, heading, step_s)

    def _at_fault(self, instances: list[int]) -> dict[int, tuple[float, str]]:
        """Tell which compasses stand apart, degrees, and why; where nothing tells which, the last one."""
        if 1 not in instances:
            return {}
        found = isolate_faults([self._source(i) for i in instances])
        if found.undecided:
            apart_deg = math.degrees(found.apart_rad(len(instances) - 1))
            text = f"The compasses point {abs(apart_deg):.0f} deg apart; a turn tells which is wrong."
            return {instances[-1]: (apart_deg, text)}
        return {instances[k]: (math.degrees(found.apart_rad(k)), found.why(k)) for k in found.blamed}

    def _source(self, instance: int) -> HeadingSource:
        """Return what one compass shows; what the limits allow counts as two sigmas of a sound one."""
        limits, record, unknown = self.limits, self._records[instance], math.nan
        gyro_deg = record.beyond_level_deg(record.gyro.rms_rad / _DEG, self._steep)
        dip_deg = record.beyond_level_deg(record.dip.value, 1.0)
        return HeadingSource.at(
            f"compass {instance}",
            record.apart.value,
            # Two compasses are apart by five of these in one case of a hundred where both are sound, and half
            # the limit is what the latch below still counts as apart.
            0.1 * limits.agreement_deg,
            gyro=2.0 * gyro_deg / limits.gyro_deg,
            dip=2.0 * dip_deg / limits.dip_deg if record.dip.known else unknown,
            strength=2.0 * record.strength.value / limits.field_percent if record.strength.known else unknown,
        )

    def _judge(
        self, record: _CompassRecord, instance: int, glance: Glance, apart_deg: float, why: str
    ) -> Iterator[Finding]:
        horizontal = glance.headings[instance].horizontal_mgauss
        swing_deg = math.degrees(record.current.swing_mgauss() / max(horizontal, 1.0) / math.sqrt(2.0))
        course_deg = record.course.value if record.course.known else 0.0
        # What the level is off by turns a heading by as much as the field is steep.
        limits, beyond, steep = self.limits, record.beyond_level_deg, self._steep
        measured = {
            "field": (record.strength.value, limits.field_percent),
            "dip": (beyond(record.dip.value, 1.0), limits.dip_deg),
            "agreement": (apart_deg, limits.agreement_deg),
            "gyro": (beyond(record.gyro.rms_rad / _DEG, steep), limits.gyro_deg),
            "course": (beyond(course_deg, steep), limits.course_deg),
            "current": (beyond(swing_deg, steep), limits.current_deg),
            "step": (record.step.off_deg, limits.step_deg),
        }
        for name, (value, limit) in measured.items():
            if abs(value) >= limit * _CLEAR_BELOW:  # what is about to go stands as it was last told
                record.told[name] = _finding(name, instance, value, limit, why)
            if record.latches.setdefault(name, _Latch()).update(glance.time_s, abs(value), limit):
                yield record.told[name]


_WORDS: dict[str, tuple[str, str, str]] = {  # short, sentence, remedy
    "field": (
        "field strength {value:+.0f} % off",
        "The field at compass {i} is {size:.0f} % {side} than the Earth's is here.",
        "Move away from iron and current; if it stays, calibrate.",
    ),
    "dip": (
        "field dip {value:+.0f} deg off",
        "The dip of the field at compass {i} is {size:.1f} deg off the Earth's here.",
        "Move away from iron and current; if it stays, calibrate.",
    ),
    "agreement": (
        "{value:+.0f} deg off the others",
        "{why}",
        "Calibrate it; if it still differs, check the mounting orientation.",
    ),
    "gyro": (
        "heading does not follow gyro",
        "While turning, compass {i} departs from the gyro by {value:.0f} deg rms.",
        "Calibrate: the iron around the compass has changed.",
    ),
    "course": (
        "heading {value:+.0f} deg off course",
        "Driving ahead, the GPS course is {size:.0f} deg {side} of compass {i}'s heading.",
        "Check the mounting orientation, then calibrate.",
    ),
    "step": (
        "field changed by {value:.0f} deg, standing",
        "The field at compass {i} changed while the vehicle stood, by up to {value:.0f} deg of heading.",
        "If it was put aboard (battery, payload), a quarter turn puts it right: calibrate with touch-up.",
    ),
    "current": (
        "heading swings with current",
        "The field at compass {i} goes with the battery's current: about {value:.0f} deg of heading.",
        "Move power leads away from the compass or calibrate its motor compensation.",
    ),
}

_METHODS = {"step": "touch-up"}
_SIDES = {"field": ("stronger", "weaker"), "course": ("right", "left")}  # of a positive and a negative value


def _finding(name: str, instance: int, value: float, limit: float, why: str) -> Finding:
    side = _SIDES.get(name, ("", ""))[value < 0.0]
    filled_in = {"i": instance, "value": value, "size": abs(value), "side": side}
    short, text, remedy = (words.format(**filled_in, why=why) for words in _WORDS[name])
    severity: Severity = "bad" if abs(value) > _BAD_ABOVE * limit else "warning"
    short, method = f"Compass {instance}: {short}"[:50], _METHODS.get(name, "")
    return Finding(name, instance, severity, short, text, remedy, value, limit, method)


def _drives_straight_ahead(glance: Glance) -> bool:
    straight = abs(glance.rate_radps) < 0.1
    return straight and glance.speed_mps > COURSE_SPEED_MPS and glance.kind in _AHEAD_KINDS
