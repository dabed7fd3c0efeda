"""The pre-flight check: what is set, what the compasses show at rest, and one turn of 90 degrees.

It writes nothing. The turn is made only where it is asked for and the vehicle can turn itself; all
safety rules of a calibration hold for it.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from typing import Literal

import numpy as np

from mavcompass import messages as mav
from mavcompass.calibration.observation import assemble, dwell_between
from mavcompass.calibration.result import CalibrationResult
from mavcompass.compass_parameters import is_calibrated, orientation_name
from mavcompass.correction import FieldCorrection
from mavcompass.credible import SILENT, is_silent
from mavcompass.earth_field import EarthField
from mavcompass.enums import MavCmd
from mavcompass.errors import PoorCalibration, Refused
from mavcompass.frames import FloatArray, circular_mean, level_to_body, wrap_pi
from mavcompass.heading.fault_isolation import HeadingSource
from mavcompass.heading.true_north import TrueNorth
from mavcompass.parameter_remarks import parameter_remarks
from mavcompass.procedure.check import items
from mavcompass.procedure.check.items import AGREEMENT_SIGMA_DEG, CheckItem, CheckReport, Reading
from mavcompass.procedure.check.mounting import turned_by
from mavcompass.procedure.commands import MessageRates
from mavcompass.procedure.desk import Desk, carriers
from mavcompass.procedure.dialect import Dialect
from mavcompass.procedure.motion import Mobility, Motion
from mavcompass.procedure.positions import DwellSettings, Mover, Window, dwell
from mavcompass.procedure.script import Context, Script
from mavcompass.procedure.turning import strategies_for
from mavcompass.steering import SteeringSource, steering_source
from mavcompass.track import Track

Turn = Literal["none", "auto", "vehicle", "hand"]

_STEP_RAD = math.pi / 2.0


@dataclass(frozen=True, slots=True)
class CheckSettings:
    """Hold what the person may choose.

    Attributes:
        turn: "vehicle" lets it turn itself by 90 degrees, "auto" only where it is armed and knows how,
            "hand" asks a person.
        system: MAVLink system id, where several vehicles share the link.
        year: decimal year to use where the vehicle does not know the date.
        north: what drives before, or all of a recording, told of each compass's true heading.
        found: what a calibration of all of a recording finds of each compass.
    """

    turn: Turn = "none"
    system: int | None = None
    rate_hz: float = 25.0
    year: float = 2026.0
    # A vehicle that is on its way is waited for: a turn on the spot takes so long.
    dwell: DwellSettings = field(default_factory=lambda: DwellSettings(patience_s=10.0))
    north: Mapping[int, TrueNorth] = field(default_factory=dict)
    found: Mapping[int, CalibrationResult] = field(default_factory=dict)


def check(
    context: Context, dialect_for: Callable[[str], Dialect], settings: CheckSettings
) -> Script[CheckReport]:
    """Check a live vehicle's compasses.

    Raises Refused where a turn was asked for and is not safe, or the check was stopped; LinkError where
    the vehicle cannot be heard.
    """
    desk = yield from Desk.open(context, dialect_for, settings.system)
    checker, rates = _Checker(desk, settings), MessageRates()
    try:
        checker.granted = yield from rates.ask(context, checker.wanted_rates())
        yield from checker.look_at_rest()
        if settings.turn != "none" and checker.knows_level:
            yield from checker.turn()
        return checker.report()
    finally:
        yield from checker.end()
        yield from rates.restore(context)


@dataclass(slots=True)
class _Checker:
    """Hold what one check works with and finds."""

    desk: Desk
    settings: CheckSettings
    mover: Mover | None = None
    mobility: Mobility | None = None
    windows: list[Window] = field(default_factory=list)
    items: list[CheckItem] = field(default_factory=list)
    readings: list[Reading] = field(default_factory=list)
    fields: dict[int, list[FloatArray]] = field(default_factory=dict)
    remarks: list[str] = field(default_factory=list)
    granted: Mapping[type[mav.Message], bool] = field(default_factory=dict)
    turned: bool = False

    @property
    def knows_level(self) -> bool:
        """Tell whether the accelerometer shows gravity: without, no turn is worth making."""
        return not any(item.name == "level" for item in self.items)

    def wanted_rates(self) -> dict[type[mav.Message], float]:
        """List the messages to ask for."""
        wanted = self.desk.imu_rates(self.desk.instances, self.settings.rate_hz)
        wanted |= {mav.Attitude: 10.0, mav.GlobalPositionInt: 4.0, mav.SysStatus: 4.0, mav.SystemTime: 2.0}
        px4 = self.desk.identity.autopilot == "px4"
        return wanted | (
            {mav.EstimatorStatus: 2.0, mav.GpsRawInt: 2.0}
            if px4
            else {mav.EkfStatusReport: 2.0, mav.RcChannels: 4.0}
        )

    def look_at_rest(self) -> Script[None]:
        """Dwell, and answer every question that needs no turn."""
        context = self.desk.context
        asks = not self.desk.state.armed
        if asks:  # what forbids arming is told to who asks
            context.command(MavCmd.RUN_PREARM_CHECKS)
        context.show("dwell", "Looking at the compasses at rest.", 0.3)
        mover = Mover(self.desk.gyro, self.desk.rest)  # nobody moves it yet
        self.desk.rest.compasses = self.desk.instances
        with context.station(asks and self.desk.identity.autopilot == "px4"):
            window = yield from dwell(context, mover, self.settings.dwell)
        self.windows.append(window)
        track = self.desk.builder.build()
        self._judge_parameters()
        self._add(items.judge_stillness(window.rested, self.desk.rest.why_not))
        self._add(items.judge_level(track.acc_mps2))
        if self.knows_level:
            self._judge_field(track, window)
        gyro = track.gyro_radps
        rates = None if gyro is None else gyro.between(window.start_s, window.end_s)
        if rates is not None and len(rates) and window.rested:  # else it is the vehicle that turns
            rotating = [seen for r in self.readings if (seen := self._rotating(track, r, window)) is not None]
            self._add(items.judge_gyro(rates.values, rotating))
        estimator = items.judge_estimator(self.desk.state.ekf or self.desk.state.estimator)
        self._add(estimator)
        if estimator is None or estimator.verdict != "fail":
            self._judge_yaw(track, window)
        self.items += items.judge_prearm(self.desk.state.texts)

    def _judge_parameters(self) -> None:
        if not self.desk.instances:
            self._add(CheckItem("compass", "fail", "The vehicle has no compass.", "Connect and enable one."))
        for instance in self.desk.instances:
            of_vehicle = self.desk.identity.autopilot, self.desk.parameters
            # Of what was never heard the readings are judged as missing; its numbers may be of a sensor gone.
            if instance in self.desk.state.reporting:
                correction = self._in_force(instance)
                calibrated = is_calibrated(*of_vehicle, instance, correction)
                self._add(items.judge_offsets(instance, correction, calibrated))
                self._add(items.judge_matrix(instance, correction))
            for remark in parameter_remarks(*of_vehicle, instance):
                if remark.forbids:
                    self._add(CheckItem("switches", "warn", remark.text))
                else:
                    self.remarks.append(remark.text)

    def _judge_field(self, track: Track, window: Window) -> None:
        world = self.world()
        if world is None:
            text = "The vehicle does not know its place: the field was not compared with the world's."
            self._add(CheckItem("place", "warn", text, "Wait for a GPS fix and check again."))
        for instance in self.desk.instances:
            if (north := self.settings.north.get(instance)) is not None:
                self.items += items.judge_north(instance, north)
            if (found := self.settings.found.get(instance)) is not None:
                self._add(items.judge_calibration(found))
            reading = self._reading(track, instance, window)
            if reading is None:
                self._say_silent(track, instance, window)
                continue
            self.items += items.judge_field(reading, world)
            self.readings.append(reading)

    def _say_silent(self, track: Track, instance: int, window: Window) -> None:
        """Say why a compass could not be judged."""
        kind = carriers(self.desk.identity.autopilot).get(instance)
        message = "a message" if kind is None else kind.wire_name()
        if (compass := track.compasses.get(instance)) is not None:
            n = len(compass.reported.between(window.start_s, window.end_s))
            rate_hz = (len(compass.reported) - 1) / max(float(np.ptp(compass.time_s)), 1e-3)
            why = items.judge_too_few(instance, message, n, rate_hz)
            if is_silent(track.raw_field(instance)):
                why = CheckItem("data", "fail", SILENT.format(instance), "Check its wiring.", instance)
            self._add(why)
            return
        if kind is not None and any(self.granted.values()) and self.granted.get(kind) is False:
            self.remarks.append(f"Compass {instance} was not judged: no readings came ({message}).")
            return
        steers = self._steering() == instance or not track.compasses
        item = items.judge_silence(instance, message, self.desk.identity.autopilot, steers)
        if item.verdict == "pass":
            self.remarks.append(item.text)
        else:
            self._add(item)

    def _steering(self) -> SteeringSource:
        return steering_source(self.desk.identity.autopilot, self.desk.parameters)

    def _judge_yaw(self, track: Track, window: Window) -> None:
        """Hold the autopilot's yaw against the compass that steers it, or against all where none does."""
        told, declination_rad = track.attitude_rad, self._declination_rad()
        during = None if told is None else told.between(window.start_s, window.end_s)
        if during is None or not len(during) or declination_rad is None:
            return
        source, magnetic_rad = self._steering(), circular_mean(during.values[:, 2]) - declination_rad
        steering = [reading for reading in self.readings if reading.instance == source]
        for reading in steering or self.readings:
            off_rad = float(wrap_pi(magnetic_rad - reading.heading_rad))
            self._add(items.judge_yaw(reading.instance, math.degrees(off_rad), source))

    def _declination_rad(self) -> float | None:
        """Return the declination in the autopilot's yaw: the place's, or the one set by hand."""
        if self.desk.parameters.get("COMPASS_AUTODEC") == 0.0:
            return self.desk.parameters.get("COMPASS_DEC")
        world = self.world()
        return None if world is None else world.declination_rad

    def _reading(self, track: Track, instance: int, window: Window) -> Reading | None:
        if instance not in track.compasses:
            return None
        try:
            seen = dwell_between(track, instance, window.start_s, window.end_s)
        except PoorCalibration:
            return None
        if is_silent(seen.mean_mgauss[np.newaxis]):
            return None
        in_force, shown = self._in_force(instance), track.between(window.start_s, window.end_s)
        mean = in_force.apply(seen.mean_mgauss)
        self.fields.setdefault(instance, []).append(mean)
        # Of each reading: the mean of what tumbles is shorter than any.
        total = float(np.nanmean(np.linalg.norm(in_force.apply(shown.raw_field(instance)), axis=1)))
        down = level_to_body(seen.roll_rad, seen.pitch_rad)[:, 2]
        vertical = total * float(mean @ down) / float(np.linalg.norm(mean))
        horizontal = math.sqrt(max(total**2 - vertical**2, 0.0))
        return Reading(instance, horizontal, vertical, seen.heading_rad(in_force))

    def _in_force(self, instance: int) -> FieldCorrection:
        return self.desk.dialect.correction(self.desk.parameters, instance)

    def _rotating(
        self, track: Track, reading: Reading, window: Window
    ) -> tuple[tuple[float, float, float], float] | None:
        """Return the rates at rest that level and a compass show, and the sigma of its turn, rad/s."""
        half_s, i = 0.5 * (window.end_s - window.start_s), reading.instance
        try:
            halves = [dwell_between(track, i, s, s + half_s) for s in (window.start_s, window.end_s - half_s)]
        except PoorCalibration:
            return None
        first, second = ((d.roll_rad, d.pitch_rad, d.heading_rad(self._in_force(i))) for d in halves)
        roll, pitch, yaw = (
            float(wrap_pi(after - before)) for before, after in zip(first, second, strict=True)
        )
        sure = (seen.heading_sigma_rad(reading.horizontal_mgauss, reading.vertical_mgauss) for seen in halves)
        return (roll / half_s, pitch / half_s, yaw / half_s), math.hypot(*sure) / half_s

    def world(self) -> EarthField | None:
        """Return the Earth's field at the vehicle, None where it does not know its place."""
        return self.desk.state.world(self.settings.year)

    # --- the turn -----------------------------------------------------------------------------------

    def turn(self) -> Script[None]:
        """Turn once and compare every compass with the gyro; say so where it cannot be done."""
        why_not = yield from self._choose_mover()
        if self.mover is None:
            if self.settings.turn != "auto":
                text = f"No turn was made: {why_not}."
                self._add(CheckItem("turn", "warn", text, "Arm it, or turn it by hand."))
            return
        self.desk.context.show("turn", "Turning by 90 deg.", 0.6)
        yield from self.mover.next(self.desk.context, _STEP_RAD, 1)
        self.desk.context.show("dwell", "Standing still after the turn.", 0.8)
        self.windows.append((yield from dwell(self.desk.context, self.mover, self.settings.dwell)))
        self.turned = True
        track = self.desk.builder.build()
        for reading in self.readings:
            self._add(self._compare_turn(track, reading.instance))
            self._reading(track, reading.instance, self.windows[-1])

    def _choose_mover(self) -> Script[str]:
        """Choose who turns; returns why nobody does."""
        if self.settings.turn == "hand":
            if self.desk.state.armed:
                return "it is armed, and turning it by hand is not safe"
        elif not self.desk.state.armed:
            return "it is disarmed"
        elif not strategies_for(self.desk.identity.kind, self.desk.identity.autopilot):
            return f"this {self.desk.identity.autopilot} {self.desk.identity.kind} cannot turn on the spot"
        motion: Motion = "hand" if self.settings.turn == "hand" else "vehicle"
        self.mobility = Mobility(self.desk, motion)
        try:
            self.mover = yield from self.mobility.take_charge()
        except Refused as why:
            if self.settings.turn == "auto":
                return why.what.rstrip(".")
            raise
        return ""

    def _compare_turn(self, track: Track, instance: int) -> CheckItem:
        dwells = [dwell_between(track, instance, w.start_s, w.end_s) for w in self.windows]
        step = assemble(track, dwells, instance).steps[0]
        first, second = (seen.heading_rad(self._in_force(instance)) for seen in dwells)
        field_turned = step.angle_rad + float(wrap_pi(second - first - step.angle_rad))
        return items.judge_turn(
            instance, math.degrees(field_turned), math.degrees(step.angle_rad), math.degrees(step.sigma_rad)
        )

    def end(self) -> Script[None]:
        """Stop any motion and the watch over it, and give the vehicle back."""
        if self.mobility is not None:
            yield from self.mobility.end(in_a_hurry=not self.turned)

    def report(self) -> CheckReport:
        """Put the list together; which of several compasses is wrong, the turn may have told."""
        sources = {reading.instance: self._source(reading) for reading in self.readings}
        self.items += items.judge_agreement(sources)
        for instance in [item.instance for item in self.items if item.name == "agreement"]:
            self._blame_mounting(instance)
        remarks, took_s = tuple(dict.fromkeys(self.remarks)), self.desk.duration_s()
        return CheckReport(self.desk.identity, tuple(self.items), self.turned, took_s, remarks)

    def _blame_mounting(self, instance: int) -> None:
        """Send who has a compass that stands turned against the others (0: one of two) to its mounting."""
        one, *others = sorted(self.fields, key=lambda i: i != instance)
        fields = [self.fields[i] for i in (one, *others)]
        if not others or len({len(field) for field in fields}) > 1:
            return
        turned = turned_by(fields[0], np.mean(fields[1:], axis=0), self._in_force(one))
        if not turned:
            return
        doubted = (instance,) if instance else (one, *others)
        names = [orientation_name(self.desk.identity.autopilot, self.desk.parameters, i) for i in doubted]
        roll, pitch, yaw = turned[0]
        by = f" by roll {roll:g}, pitch {pitch:g}, yaw {yaw:g} deg" if len(turned) == 1 else ""
        wrong = f"mounted otherwise than {' or '.join(names)} says{by and ', turned'}{by}"
        remedy = f"It is {wrong}: set that right first."
        if not self.turned:  # one position alone leaves room for iron that looks the same
            remedy = f"It may be {wrong}: turn it by 90 deg and check again."
        self.items = [
            replace(item, remedy=remedy)
            if item.verdict != "pass" and item.instance == instance and "alibrate" in item.remedy
            else item
            for item in self.items
        ]

    def _source(self, reading: Reading) -> HeadingSource:
        """Return what one compass shows; what a question's limit allows counts as two sigmas."""
        found = {i.name: 2.0 * i.value / i.limit for i in self.items if i.instance == reading.instance}
        return HeadingSource.at(
            f"compass {reading.instance}",
            math.degrees(reading.heading_rad),
            AGREEMENT_SIGMA_DEG,
            gyro=found.get("turn", math.nan),
            dip=found.get("dip", math.nan),
            strength=found["field"] if self.world() is not None else math.nan,
        )

    def _add(self, item: CheckItem | None) -> None:
        if item is not None:
            self.items.append(item)
