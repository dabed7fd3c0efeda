"""The autopilot's own heading after a calibration: how far off it is, and bringing it to the calibrated one.

What steers the vehicle is the autopilot's estimator, not the compass, and that takes a compass which has
just become right over slowly. On ArduPilot 4.5.7 it was seen 3 to 5 degrees off after a minute, 140 degrees
where it had ceased to believe the compass, and drifting away where it had set the compass aside.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np

from mavcompass.calibration.observation import unrest
from mavcompass.calibration.result import CalibrationResult, surest
from mavcompass.earth_field import earth_field_of
from mavcompass.errors import LinkError, PoorCalibration, Refused
from mavcompass.frames import FloatArray
from mavcompass.kinds import HOVERING
from mavcompass.procedure.desk import Desk
from mavcompass.procedure.dialect import GIVEN_BACK, Overrides
from mavcompass.procedure.report import AutopilotHeading, yaw_error_rad
from mavcompass.procedure.script import Context, Script, pause

# Less is not worth an intervention: it is what a filter leaves whose compass is perfect, of the gyro's drift
# (0.5 to 1.6 degrees on ArduPilot 4.5.7), and three times what one reading of the compass tells (0.25).
_WORTH_DEG = 0.75
# Later on more is: what is left may be what the tilt tells wrong, of the compass or of the autopilot.
_STILL_WORTH_DEG = 1.0
# An estimator that is told to believe its compass (`prompt_estimator`) follows within this time, its gyro's
# bias too: 2 to 7 s were seen in flight on ArduPilot 4.5.7; what stands has the bias alone left to learn.
_PROMPTLY_S, _AT_MOST_S, _BIAS_ALONE_S = 6.5, 9.0, 4.0
# An error that grows at a rate comes to so many seconds of it, by measurements on ArduPilot 4.5.7: the old
# compass has bent the filter's gyro bias, which it unlearns in a minute or two.
_SWING_S = 17.0
# Without a compass nothing ever stops it.
_MINUTE_S = 60.0
_GOOD_DEG = 1.8
# The slope of the error is that of the last seconds; of so many at least, else it is not known.
_SLOPE_S, _SLOPE_AT_LEAST_S = 8.0, 3.2
# The yaw of PX4 on the ground goes to and fro in 5 to 20 s. So long it is watched, and by what was seen then
# it is judged: what its sensors' noise may do to it later is no matter of the calibration.
_WANDER_S, _WANDER_AT_LEAST_S = 20.0, 14.0
_SAMPLE_S = 1.2
# What noise may leave of a sample; noisy sensors take longer samples, and everything with them.
_TILT_KNOWN_RAD, _FIELD_KNOWN_MGAUSS, _LONGEST_SAMPLE_S = math.radians(0.5), 3.0, 5.0
# Slower, ArduPilot's own rovers and boats count as stopped (ATC_STOP_SPEED).
_STOPPED_MPS = 0.1
# Its filter lags, and so does its telemetry.
_LAG_S = 0.8
_PATIENCE_S, _PATIENCE_WITHOUT_A_WAY_S = 120.0, 45.0
# An autopilot that loads a calibration when it is disarmed is waited for so long, and then left to do it.
_LANDING_PATIENCE_S, _LOADS_WITHIN_S = 60.0, 3.0
# What was done so often and has not brought it right will not.
_TIMES = 4
_BELIEVING = "believing its compass for some seconds"


@dataclass(slots=True)
class OwnHeading:
    """Watch the autopilot's own heading and bring it to the calibrated one.

    Attributes:
        overrides: what is held at other values for a while.
        result: the calibrated compass that the heading is compared with; None before there is one.
        before_deg: the error at the start, before the vehicle was turned.
        by: what brought it there. samples: vehicle time, error and its sigma, and the yaw that was told,
            degrees, since the last intervention.
        not_loaded: True while the autopilot flies on with the calibration that it took off with.
    """

    desk: Desk
    year: float
    overrides: Overrides
    result: CalibrationResult | None = None
    before_deg: float = math.nan
    by: list[str] = field(default_factory=list)
    samples: list[tuple[float, float, float, float]] = field(default_factory=list)
    not_loaded: bool = False
    _values: Mapping[str, float] = field(default_factory=dict)
    _written_s: float = math.nan
    _latest_deg: float = math.nan
    _bent_deg: float = 0.0
    _has_a_way: bool = True
    _follows: bool = False
    _turned: FloatArray | None = None
    _not_before_s: float = -math.inf

    # --- while the calibration goes on ----------------------------------------------------------------

    def keep_up(self) -> Script[None]:
        """Have the autopilot take its compass's yaw over, right or wrong, before the vehicle turns on.

        What a settled estimator and a bent compass disagree by in a turn goes into the estimator's gyro
        bias, and that outlasts the bend by minutes. One that has just taken a yaw over blames its yaw. What
        has way on is left alone: were that yaw more than a right angle off, it would seem to go backwards,
        and the autopilot would brake and steer the wrong way round (a boat with 300 mG of iron ran off so).
        """
        if self._has_a_way and self.desk.state.speed_mps < _STOPPED_MPS:
            yield from self._switch()

    def found(
        self,
        results: Sequence[CalibrationResult],
        windows: Sequence[tuple[float, float]],
        bent_deg: float = 0.0,
    ) -> None:
        """Measure the error at the dwells, before anything is written: `before_deg` is that of the first.

        `bent_deg` is known of what turned it between them.
        """
        self.result = surest(results)
        # What was recorded is by the mounting that is set; a calibration of the right one is not for that.
        self._turned = self.result.mounting.turned if self.result.accepted else None
        for window in windows:
            self._sample(*window)
        if self.samples:
            self.before_deg = self.samples[0][1]
            self._bent_deg = max(bent_deg, *(abs(sample[1]) for sample in self.samples))
        self.samples.clear()

    def expect(self) -> Script[None]:
        """Have an estimator follow its compass promptly from the write on; one that flies, where worth it."""
        values = {} if self.desk.dialect.loads_disarmed else self._prompt_values()
        if values and (self._bent_deg > _WORTH_DEG or not self.flying):
            self._follows = yield from self.overrides.hold(self._context, values)

    def written(self, values: Mapping[str, float]) -> Script[None]:
        """Have the autopilot take the new heading over; `values` are the parameters that were written."""
        self._written_s, self._values, self._turned = self._context.now, values, None
        self.not_loaded = self.desk.dialect.loads_disarmed and self.desk.state.armed
        yield from self._put_right()

    def give_back(self) -> Script[None]:
        """Give the estimator its settings back, once what the old compass bent of its gyro is unlearned."""
        if self._follows:
            yield from pause(self._context, self._written_s + _BIAS_ALONE_S - self._context.now)
            yield from self.overrides.release(self._context, GIVEN_BACK)
            self._follows = False

    def _until_it_follows(self) -> Script[None]:
        """Wait until an estimator has followed its compass, all of a sample long."""
        began_s, self._not_before_s = self._context.now, self.desk.rest.time_s + _LAG_S + self._sample_s
        yield from pause(self._context, _PROMPTLY_S)
        while self._context.now - began_s < _AT_MOST_S:
            self._look()
            if self.samples and abs(self.error_deg) < 0.5 * _WORTH_DEG:
                return
            yield from pause(self._context, 0.5)

    def settle(self) -> Script[None]:
        """Wait, with progress, until the heading is right and will stay so, helping where there is a way.

        A stop ends the waiting: what was written stands.
        """
        told = False
        try:
            if self.not_loaded and not (yield from self._load()):
                self._look()
                return
            began_s = self._context.now
            while self._context.now - began_s < self._patience_s() and math.isfinite(self.before_deg):
                self._look()
                if self._may_help() and (yield from self._put_right()):
                    began_s = self._context.now
                    continue
                if self.worst_deg <= _GOOD_DEG or (self.set_aside and math.isfinite(self.worst_deg)):
                    return
                as_good_as_it_gets = abs(self.error_deg) <= _STILL_WORTH_DEG or not self._has_a_way
                if 2.0 * self.wander_deg > _GOOD_DEG and as_good_as_it_gets:
                    return
                if self._context.now - began_s > _SLOPE_AT_LEAST_S * self._slowness + 1.0:
                    left_s = self._patience_s() - (self._context.now - began_s)
                    off_deg = abs(self.error_deg)
                    how = "still follows" if off_deg > _GOOD_DEG else "has followed and is watched"
                    how = f"the autopilot {how}, {off_deg:.1f} deg off now"
                    if not self.samples:
                        how = f"its own heading is measured once it rests ({unrest(self.desk.rest.why_not)})"
                    text = f"All is written; {how} (at most {left_s:.0f} s more; you may stop here)."
                    self._context.show("heading", text, live=float(told))
                    told = True
                yield from pause(self._context, 1.0)
        except (Refused, LinkError) as trouble:
            self._context.show(
                "heading", f"{trouble.what} What was written stays; its heading is not waited for."
            )

    def look(self) -> Script[None]:
        """Measure the error as it is now, once."""
        yield from pause(self._context, self._sample_s + _LAG_S)
        self._look()

    def note(self, time_s: float, error_deg: float, sigma_deg: float, yaw_deg: float) -> None:
        """Take one sample of the error, and the yaw that had it."""
        self._latest_deg = error_deg
        self.samples.append((time_s, error_deg, sigma_deg, yaw_deg))

    def restarted(self) -> None:
        """Begin anew after a restart of the autopilot."""
        self.by, self._latest_deg = ["a restart"], math.nan
        self.samples.clear()
        self._has_a_way, self._not_before_s = True, -math.inf

    def outcome(self) -> AutopilotHeading:
        """Return what came of it."""
        return AutopilotHeading(
            error_before_deg=self.before_deg,
            error_after_deg=self.error_deg,
            by=", ".join(dict.fromkeys(self.by)) or "its own filter",
            seconds=self._context.now - self._written_s,
            worst_deg=self.worst_deg,
            wander_deg=self.wander_deg,
            set_aside=self.set_aside,
            not_loaded=self.not_loaded,
            flying=self.flying,
            flies=self.desk.identity.kind in HOVERING,
        )

    # --- what is known of it ------------------------------------------------------------------------

    @property
    def flying(self) -> bool:
        """Tell whether the vehicle is in the air."""
        return self.desk.identity.kind in HOVERING and self.desk.state.armed

    @property
    def error_deg(self) -> float:
        """Return the error as it is now, or was before an intervention; nan where it was never measured.

        Where it goes to and fro, the latest sample counts as far as that is known to be no noise.
        """
        wander_deg, mean_deg = self.wander_deg, self._mean_deg
        if wander_deg == 0.0:
            return self._latest_deg
        share = wander_deg**2 / (wander_deg**2 + self.samples[-1][2] ** 2) if wander_deg > 0.0 else 0.0
        return mean_deg + share * (self._latest_deg - mean_deg)

    @property
    def slope_dps(self) -> float:
        """Return how fast the error changes, degrees per second; nan while that cannot be told."""
        recent = self._recent(_SLOPE_S * self._slowness, _SLOPE_AT_LEAST_S * self._slowness)
        return math.nan if recent is None else float(np.polyfit(recent[0], recent[1], 1)[0])

    @property
    def wander_deg(self) -> float:
        """Return by how much the error goes to and fro, 1 sigma; nan while that was not seen for long enough.

        ArduPilot's does not. What the samples scatter by of their own noise is none of it, nor what they do
        beyond the yaw that is told: where the vehicle stands, that is the level's.
        """
        if not self.desk.dialect.loads_disarmed:
            return 0.0
        recent = self._recent(_WANDER_S, _WANDER_AT_LEAST_S)
        if recent is None:
            return math.nan
        _, error, sigma, yaw = recent
        # What noise alone scatters by, by chance, is not taken for nothing: it tells no less than its doubt.
        noise2 = float((sigma**2).mean())
        told2 = float(np.var(np.unwrap(yaw, period=360.0)))
        return math.sqrt(max(min(float(error.var()) - noise2, told2), noise2 / len(error)))

    @property
    def _mean_deg(self) -> float:
        """Return what the error goes to and fro about."""
        recent = self._recent(_WANDER_S, 0.0)
        return self._latest_deg if recent is None else float(recent[1].mean())

    @property
    def worst_deg(self) -> float:
        """Return the largest error to expect from now on; nan while that cannot be told."""
        if wander_deg := self.wander_deg:
            # What goes to and fro has a slope at any moment, which does not last.
            return abs(self._mean_deg) + 2.0 * wander_deg
        slope_dps = self.slope_dps
        if math.isnan(slope_dps):
            return math.nan
        seconds = _MINUTE_S if self.set_aside else _SWING_S
        return max(abs(self.error_deg), abs(self.error_deg + seconds * slope_dps))

    @property
    def set_aside(self) -> bool:
        """Tell whether the autopilot no longer uses any compass: its variance is then exactly zero."""
        ekf = self.desk.state.ekf
        return ekf is not None and ekf.compass_variance == 0.0

    def _recent(self, longest_s: float, least_s: float) -> FloatArray | None:
        """Return times before the last sample, errors, sigmas, yaws, (4, N); None for too little."""
        if not self.samples:
            return None
        samples = np.asarray(self.samples).T
        samples[0] -= samples[0, -1]
        recent = samples[:, samples[0] >= -longest_s]
        return None if -recent[0, 0] < least_s else recent

    # --- steps --------------------------------------------------------------------------------------

    @property
    def _context(self) -> Context:
        return self.desk.context

    def _patience_s(self) -> float:
        helps = self._has_a_way and self.samples and not self.flying
        return _PATIENCE_S if helps else _PATIENCE_WITHOUT_A_WAY_S

    @property
    def _sample_s(self) -> float:
        """Return how long a sample must be with this vehicle's noise."""
        by_noise_s = self.desk.rest.detector.averaging_s(_TILT_KNOWN_RAD, _FIELD_KNOWN_MGAUSS)
        return max(_SAMPLE_S, min(by_noise_s, _LONGEST_SAMPLE_S))

    @property
    def _slowness(self) -> float:
        return self._sample_s / _SAMPLE_S

    def _load(self) -> Script[bool]:
        """Wait until the vehicle is disarmed, and have it load what was written; False where it flies on."""
        context, state = self._context, self.desk.state
        end_s = context.now + _LANDING_PATIENCE_S
        if state.armed:
            context.show("heading", "Land and disarm it: the autopilot loads the new values on the ground.")
        while state.armed and context.now < end_s:
            yield from pause(context, 0.5)
        if state.armed:
            return False
        yield from pause(context, _LOADS_WITHIN_S)
        self.not_loaded = not (yield from self._put_right())
        return not self.not_loaded

    def _prompt_values(self) -> Mapping[str, float]:
        return self.desk.dialect.prompt_estimator(self.desk.parameters, self.flying)

    def _may_help(self) -> bool:
        """Tell whether taking the compass's yaw over leaves less error: not while it grows, or is unknown.

        An estimator that has slid off, or keeps a bias of its gyro, comes back slowly or not at all.
        """
        error_deg = abs(self.error_deg)
        growing_dps = self.slope_dps * math.copysign(1.0, self.error_deg)
        may = self._has_a_way and not self.flying and not self.set_aside and not math.isnan(self.wander_deg)
        return may and error_deg > _STILL_WORTH_DEG and growing_dps * _SWING_S < error_deg

    def _put_right(self) -> Script[bool]:
        """Have the autopilot take its compass's yaw over, and say so; False where it knows no way."""
        desk, how, off_deg = self.desk, "", abs(self.error_deg)
        loads = desk.dialect.loads_disarmed
        if self._follows:
            how = yield from self._follow()
        elif loads and self._values and not desk.state.armed:
            how = yield from self.overrides.load(self._context, desk.parameters, self._values)
        elif not (loads or self.flying):
            how = yield from self.overrides.put_back_after(self._context, self._believing(), GIVEN_BACK)
        self._has_a_way = bool(how) and self.by.count(how) < _TIMES
        if how:
            text = f"The autopilot was {off_deg:.1f} deg off; it now uses the new heading."
            self._context.show("heading", text)
            self.by.append(how)
            self.samples.clear()
            self._not_before_s = desk.rest.time_s + _LAG_S + self._sample_s
        return bool(how)

    def _believing(self) -> Script[str]:
        values, context, began_s = self._prompt_values(), self._context, self._context.now
        believes = bool(values) and (yield from self.overrides.hold(context, values))
        how = yield from self._follow() if believes else self._switch()
        yield from pause(context, began_s + _BIAS_ALONE_S - context.now if believes else 0.0)
        return how

    def _follow(self) -> Script[str]:
        """Have an estimator that believes its compass take its yaw over; return how."""
        how = yield from self._switch()
        if not how:
            yield from self._until_it_follows()
        return f"{how}, {_BELIEVING}" if how else _BELIEVING

    def _switch(self) -> Script[str]:
        how = yield from self.desk.dialect.take_compass_yaw(self._context, self.desk.parameters, self.flying)
        self._has_a_way = bool(how)
        return how

    def _look(self) -> None:
        """Measure the error over the last second, where the vehicle has rested in it."""
        rest = self.desk.rest
        if rest.time_s >= self._not_before_s and (rest.for_s() >= self._sample_s or self.flying):
            self._sample(rest.time_s - self._sample_s, rest.time_s)

    def _sample(self, start_s: float, end_s: float) -> None:
        track = self.desk.builder.build()
        world = earth_field_of(track, self.year)
        if world is None or self.result is None:
            return
        try:
            told = yaw_error_rad(track, self.result, world, start_s, end_s, self._turned)
        except (PoorCalibration, KeyError):
            return
        self.note(end_s, *map(math.degrees, told))
