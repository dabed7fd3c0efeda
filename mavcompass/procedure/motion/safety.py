"""What ends a motion at once: the pilot, a failsafe, the vehicle's own state, a silent link.

`MotionGuard.check` is a watch of a Context: called after every event, and a sentence from it stops
the procedure, which then commands zero rate, puts back what it changed and writes nothing.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field

from mavcompass import messages as mav
from mavcompass.enums import EkfFlag, MavState
from mavcompass.errors import Refused
from mavcompass.kinds import HOVERING, Kind
from mavcompass.procedure.modes import ModeKeeper, mode_name
from mavcompass.procedure.turning import GyroAngle
from mavcompass.procedure.vehicle_state import VehicleState, metres_from

# Events come at least this often; a longer step is our own computer's, which was busy or asleep.
_LONGEST_STEP_S = 0.2
# Sticks that rest in the middle, by kind; throttles need not.
_CENTRED: dict[Kind, tuple[int, ...]] = {
    "rover": (1,),
    "boat": (1,),
    **dict.fromkeys(HOVERING, (1, 2, 4)),
    "sub": (4,),
}
_CENTRE_US, _HELD_US = 1500, 150
_CIRCLING = (
    "A copter whose compass is far off circles instead of holding its place: calibrate it on the ground, "
    "turned by hand."
)
_ASTRAY = "What a compass steers that is far off goes astray: turn it by hand (--motion hand)."
# No message for so long is a dead link (longer on slow telemetry).
_SILENCE_S = 0.8
# A failsafe says why beside what it does, which the next heartbeat tells.
_LATELY_S = 2.0
# A stick moved so far from where it was at the start is the pilot's hand.
_STICK_US = 80
# More than this is not a turn on the spot.
MOST_RADPS, DRIFT_M, _TILT_RAD = math.radians(200.0), 5.0, math.radians(35.0)
# A copter must be at least so high; and less of a battery is no time for turning.
_HEIGHT_M, _BATTERY_PERCENT = 1.5, 10


@dataclass(slots=True)
class MotionGuard:
    """Watch a vehicle from the moment motion begins; `hear` is a listener, `check` a watch.

    Attributes:
        modes: knows which flight modes are ours. room_m: to stray in from where it was at the start.
        moved_by_us: RC channels that we move ourselves, so that they say nothing about the pilot.
    """

    state: VehicleState
    gyro: GyroAngle
    kind: Kind
    modes: ModeKeeper
    room_m: float = DRIFT_M
    moved_by_us: frozenset[int] = frozenset()
    _sticks: tuple[int, ...] | None = None
    _place: mav.GlobalPositionInt | None = None
    _arrivals: list[float] = field(default_factory=list)
    _heard_s: float = math.nan
    _looked_s: float = math.nan
    _silent_s: float = 0.0

    def begin(self) -> None:
        """Take the state at the start as what must not change.

        Raises Refused where the vehicle is not fit to be turned.
        """
        self._sticks = None
        self._place = self.state.place
        reason = self._unfit() or self._too_low()
        if reason is not None:
            raise Refused(reason, "Nothing was moved or written.")

    def hear(self, heard: mav.Incoming) -> None:
        """Learn the rhythm of the link: on slow telemetry silence is longer."""
        self._arrivals.append(heard.time_s)
        del self._arrivals[:-50]

    def silence_limit_s(self) -> float:
        """Return how long the link may be silent before it counts as dead."""
        if len(self._arrivals) < 10:
            return max(_SILENCE_S, 2.0)
        mean_gap_s = (self._arrivals[-1] - self._arrivals[0]) / (len(self._arrivals) - 1)
        return max(_SILENCE_S, 8.0 * mean_gap_s)

    def check(self, now_s: float) -> str | None:
        """Return the sentence that ends the motion, None while all is well."""
        if self._listened_in_vain_s(now_s) > self.silence_limit_s():
            return "The vehicle fell silent: the link is lost."
        if not self.state.armed:
            return f"The vehicle was disarmed.{self._why(now_s)}"
        if self.modes.is_foreign():
            to = mode_name(self.kind, self.modes.autopilot, self.state.mode)
            return f"The flight mode was changed to {to}.{self._why(now_s)}"
        return self._unfit() or self._strayed()

    def _unfit(self) -> str | None:
        return self._pilot() or self._power() or self._estimator() or self._posture() or self._fence()

    def _why(self, now_s: float) -> str:
        """Return what the vehicle said in the last seconds, if anything: a failsafe names itself."""
        lately = dict.fromkeys(self.state.said_since(now_s - _LATELY_S))
        return f" It said: {'; '.join(lately)}." if lately else ""

    def _listened_in_vain_s(self, now_s: float) -> float:
        """Return how long the vehicle said nothing while we listened: our own sleep is not its silence."""
        if self.state.heard_s != self._heard_s:
            self._heard_s, self._silent_s = self.state.heard_s, 0.0
        else:
            self._silent_s += min(now_s - self._looked_s, _LONGEST_STEP_S)
        self._looked_s = now_s
        return self._silent_s

    def _pilot(self) -> str | None:
        now = _stick_values(self.state.sticks)
        if now is None:
            return None
        if self._sticks is None:
            self._sticks = now
            held = [c for c in _CENTRED.get(self.kind, ()) if abs(now[c - 1] - _CENTRE_US) > _HELD_US]
            if set(held) - self.moved_by_us:
                return "The pilot holds a stick."
        for channel, (pwm, at_start) in enumerate(zip(now, self._sticks, strict=True), start=1):
            if channel not in self.moved_by_us and abs(pwm - at_start) > _STICK_US:
                return "The pilot moved a stick."
        return None

    def _power(self) -> str | None:
        beat, battery = self.state.heartbeat, self.state.battery
        if beat is not None and beat.system_status in (MavState.CRITICAL, MavState.EMERGENCY):
            return "The vehicle reports a failsafe."
        if battery is not None and 0 <= battery.battery_remaining < _BATTERY_PERCENT:
            return f"The battery is at {battery.battery_remaining} %."
        return None

    def _estimator(self) -> str | None:
        ekf = self.state.ekf
        if ekf is None:
            return None
        if ekf.flags & EkfFlag.UNINITIALIZED or not ekf.flags & EkfFlag.ATTITUDE:
            return "The vehicle's attitude estimate is not healthy."
        if self.kind in HOVERING and ekf.flags & EkfFlag.CONST_POS_MODE:
            return "The vehicle has lost its position estimate."
        return None

    def _posture(self) -> str | None:
        attitude = self.state.attitude
        if attitude is not None:
            tilt = math.acos(math.cos(attitude.roll) * math.cos(attitude.pitch))
            if tilt > _TILT_RAD:
                return f"The vehicle is tilted by {math.degrees(tilt):.0f} deg."
        if abs(self.gyro.rate_radps) > MOST_RADPS:
            return f"The vehicle turns too fast ({math.degrees(self.gyro.rate_radps):.0f} deg/s)."
        return None

    def _fence(self) -> str | None:
        fence = self.state.fence
        return "The geofence is breached." if fence is not None and fence.breach_status else None

    def _too_low(self) -> str | None:
        place = self.state.place
        if self.kind in HOVERING and place is not None:
            height_m = place.relative_alt * 1e-3
            if height_m < _HEIGHT_M:
                return f"The vehicle is {height_m:.1f} m above its start, too low to be turned."
        return None

    @property
    def strayed_m(self) -> float:
        """Return how far the vehicle is from where it started, as far as it knows."""
        place, start = self.state.place, self._place
        return 0.0 if place is None or start is None else math.hypot(*metres_from(start, place))

    def _strayed(self) -> str | None:
        self._place = self._place or self.state.place
        if self.strayed_m > self.room_m:
            reason = f"The vehicle moved {self.strayed_m:.1f} m away from where it started."
            return f"{reason} {_CIRCLING if self.kind in HOVERING else _ASTRAY}"
        return self._too_low()


def _stick_values(sticks: mav.RcChannels | None) -> tuple[int, ...] | None:
    """Return the four stick channels; None where there is no receiver."""
    if sticks is None:
        return None
    values = (sticks.chan1_raw, sticks.chan2_raw, sticks.chan3_raw, sticks.chan4_raw)
    return values if all(800 <= v <= 2200 for v in values) else None
