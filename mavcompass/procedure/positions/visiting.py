"""Visit the still positions of a calibration: wait for rest, dwell, turn, again.

The vehicle turns itself by a `SteeredTurn`, or a person turns it. Both give the same: stretches of
the recording, in the vehicle's time, in which it stood still.
"""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from itertools import pairwise
from statistics import median
from typing import ClassVar

from mavcompass import messages as mav
from mavcompass.calibration.observation import StillnessDetector, unrest
from mavcompass.errors import LinkLost
from mavcompass.messages import telemetry
from mavcompass.procedure.script import Context, Script, nothing, pause
from mavcompass.procedure.turning import GyroAngle
from mavcompass.procedure.turning.steered import SLOW_RADPS

_HOLD_EVERY_S = 0.5
_HOLD_WHILE_SETTLING_S = 0.2
_FIRST_ASKED_S, _ASK_EVERY_S = 0.6, 0.14
_MUCH_SURER = 0.85  # noise would fall to 0.71 in twice the time
_SWAYS_S = 1.4  # nothing shorter tells what a vehicle that sways does
_NOISY = 1.5  # a vehicle that needs so many times the usual dwell has noisy sensors
# What happened in a longer silence is not known; nor in more than so many intervals of a slow stream.
_LONGEST_GAP_S, _LONGEST_GAP = 1.0, 2.5
_REST_JUDGED_S = 0.5  # what began to move is noticed within so long: rest is judged by the mean of it
_FEWEST_READINGS = 8  # fewer do not show whether they wander or remember (`calibration.observation.dwells`)
# A clock that goes back by so much belongs to an autopilot that has restarted.
_RESTARTED_S = 5.0
# At the turning points of a swing the tilt rests for a moment.
_CALM_AFTER_S = 1.0
# What noise may leave of a dwell's means. Tilt counts twice and more in the heading, by the dip's tangent.
_TILT_KNOWN_RAD, _FIELD_KNOWN_MGAUSS = math.radians(0.35), 2.0
# After a turn a compass still averages it for a quarter second; then five readings of 10 Hz tell the heading.
_AVERAGES_S, _STANDS_S, _GOES_ON_S = 0.25, 0.5, 5.0


@dataclass(frozen=True, slots=True)
class Window:
    """Hold one still stretch: vehicle time, the gyro's live angle at its end, whether it was at rest."""

    start_s: float
    end_s: float
    turned_rad: float
    rested: bool = True


@dataclass(frozen=True, slots=True)
class DwellSettings:
    """Hold how long to stand still: no shorter than for eight readings, up to the longest.

    Attributes:
        dwell_s: the longest dwell; eighteen fresh readings of a compass read at 10 Hz.
        shortest_s: the shortest, which is still found again in a recording; from then on it ends once the
            heading by it is sure enough, or not much surer than it was after half the time: what sways is
            not averaged out by standing longer.
        enough_deg: how sure is enough, 1 sigma.
        longest_s: of a vehicle whose sensors are so noisy that their mean takes longer to be known, or that
            reports so seldom.
        settle_s: rest before a dwell begins. Rest is judged by the mean of half a second, so by then
            the chassis and the compass's average of 100 ms have settled.
        patience_s: a vehicle that hunts longer than this is dwelt upon as it is; the sway is then in
            the data, where the gyro explains it.
        tilting_patience_s: the same for one that tilts to and fro, as a copter does until its estimator has
            made up its mind about a bent compass. That costs more than time.
    """

    dwell_s: float = 1.7
    shortest_s: float = 0.92
    enough_deg: float = 0.15
    longest_s: float = 6.0
    settle_s: float = 0.1
    patience_s: float = 3.0
    tilting_patience_s: float = 10.0


@dataclass(slots=True)
class Rest:
    """Tell live whether the vehicle stands still, on `wheels` or otherwise; `hear` is a listener.

    `compasses` are those, from 1, whose readings a dwell is for.
    """

    wheels: bool = False
    compasses: tuple[int, ...] = (1,)
    detector: StillnessDetector = field(init=False)
    time_s: float = -math.inf
    heard_s: float = -math.inf
    still_since_s: float | None = None
    why_not: str = "nothing was heard yet"
    _readings: dict[str, deque[float]] = field(default_factory=dict)

    def __post_init__(self) -> None:
        """Begin to watch."""
        self._begin()

    def _begin(self) -> None:
        self.detector = StillnessDetector(hold_s=0.0, wheels=self.wheels)
        self._readings.clear()

    def hear(self, heard: mav.Incoming) -> None:
        """Take one message; RAW_IMU or SCALED_IMU tell of rest, those of other compasses are counted."""
        message = heard.message
        if not isinstance(message, mav.RawImu | mav.ScaledImu):
            return
        time_s = float(telemetry.imu_time_s(message))
        latest = self._readings.setdefault(message.wire_name(), deque(maxlen=_FEWEST_READINGS))
        if not latest or time_s > latest[-1]:
            latest.append(time_s)
        if type(message) not in (mav.RawImu, mav.ScaledImu):
            return
        if time_s < self.time_s - _RESTARTED_S:
            self._begin()
        elif time_s <= self.time_s:
            return
        self.time_s, self.heard_s = time_s, heard.time_s
        state = self.detector.update(time_s, *telemetry.imu_vectors(message))
        self.still_since_s = None if math.isnan(state.since_s) else state.since_s
        self.why_not = state.why_not

    def too_few_since(self, start_s: float) -> bool:
        """Tell whether a compass has spoken less than eight times since then, of those that speak at all."""
        counts: dict[int, int] = {}
        for name, times in self._readings.items():
            instance = telemetry.MAG_MESSAGES[name]
            counts[instance] = max(counts.get(instance, 0), sum(time_s > start_s for time_s in times))
        return any(count < _FEWEST_READINGS for i, count in counts.items() if i in self.compasses)

    def longest_gap_s(self) -> float:
        """Return how long a silence still says nothing, from the usual time between messages."""
        latest = max(self._readings.values(), key=len, default=())
        usual_s = median([b - a for a, b in pairwise(latest)] or [0.0])
        return max(_LONGEST_GAP_S, _LONGEST_GAP * usual_s)

    def needed_s(self, settings: DwellSettings) -> float:
        """Return how long a dwell must last with this vehicle's noise."""
        by_noise_s = self.detector.averaging_s(_TILT_KNOWN_RAD, _FIELD_KNOWN_MGAUSS)
        return max(settings.dwell_s, min(by_noise_s, settings.longest_s))

    def for_s(self) -> float:
        """Return for how long it has been still, seconds of the vehicle's time."""
        return 0.0 if self.still_since_s is None else self.time_s - self.still_since_s


@dataclass(slots=True)
class Mover:
    """Bring the vehicle to its next position; this one leaves it where it stands.

    Attributes:
        gyro, rest: tell how far it has turned, and whether it stands still.
        by_itself: whether the vehicle turns itself, as far and as often as it is asked.
    """

    gyro: GyroAngle
    rest: Rest
    by_itself: ClassVar[bool] = False

    def next(self, context: Context, angle_rad: float, remaining: int) -> Script[None]:
        """Turn by about `angle_rad`; the gyro's angle tells what came of it."""
        return nothing(None)

    def settle(self, context: Context, settings: DwellSettings) -> Script[bool]:
        """Wait until the vehicle has rested for the settling time; False when it hunts on."""
        return (yield from wait_still(context, self, settings))

    def hold(self, context: Context, left_s: float) -> None:
        """Keep it there; called twice a second during a dwell that lasts another `left_s`."""

    def accept(self, context: Context, turned_rad: float) -> bool:
        """Take the position where it dwelt; False where it does not count."""
        return True

    def halt(self, context: Context) -> None:
        """Stop any motion now."""

    def release(self, context: Context) -> Script[None]:
        """Give the vehicle back as it was taken."""
        return nothing(None)


def wait_still(context: Context, mover: Mover, settings: DwellSettings) -> Script[bool]:
    """Wait until the vehicle has rested for the settling time; False when it hunts on.

    Raises LinkLost where no IMU messages come.
    """
    rest = mover.rest
    began_s, heard_at = context.now, rest.time_s
    shown, held_s, tilted_s = False, -math.inf, -math.inf
    while rest.for_s() < settings.settle_s:
        if rest.why_not == "tilting":
            tilted_s = context.now
        tilts = context.now - tilted_s < _CALM_AFTER_S
        if context.now > began_s + (settings.tilting_patience_s if tilts else settings.patience_s):
            if rest.time_s == heard_at:
                raise LinkLost(
                    "No RAW_IMU or SCALED_IMU message came.",
                    "Check that the vehicle streams them on this link (SRn_RAW_SENS, MAV_n_MODE).",
                )
            return False
        if not shown and rest.why_not and context.now > began_s + 1.0:
            context.show("settle", f"Waiting until it stands still: {unrest(rest.why_not)}.")
            shown = True
        if context.now - held_s >= _HOLD_WHILE_SETTLING_S:
            mover.hold(context, settings.dwell_s)
            held_s = context.now
        yield from pause(context, 0.05)
    return True


# Tells how sure the heading by a stretch is, 1 sigma in degrees.
Sureness = Callable[[float, float], float]


def dwell(
    context: Context,
    mover: Mover,
    settings: DwellSettings,
    sureness: Sureness | None = None,
    meanwhile: Callable[[], Script[None]] | None = None,
) -> Script[Window]:
    """Stand still for a dwell; one that is disturbed, or partly not heard, begins anew, twice at the most.

    Where `sureness` tells, it ends as soon as the heading by it is sure enough. `meanwhile` is done once.
    """
    rest, gyro = mover.rest, mover.gyro
    for _ in range(3):
        resting = yield from mover.settle(context, settings)
        start_s, angle, samples = rest.time_s, gyro.angle_rad, gyro.samples
        if meanwhile is not None:
            yield from meanwhile()
            meanwhile = None
        began, held_s = context.now, context.now
        length_s, needed_s, asks_s = 0.0, rest.needed_s(settings), _FIRST_ASKED_S
        known: dict[float, float] = {}
        enough, latest = None, None
        most_s = settings.longest_s if resting else 0.0
        while length_s < needed_s or (length_s < most_s and rest.too_few_since(start_s)):
            if context.now - began > 5.0 * needed_s + 5.0:
                raise LinkLost("The IMU messages stopped coming.", "Bring the link back and run again.")
            if context.now - held_s >= _HOLD_EVERY_S:
                mover.hold(context, needed_s - length_s)
                held_s = context.now
            heard_s, gap_s = rest.time_s, rest.longest_gap_s()
            yield from pause(context, 0.05)
            if (resting and rest.still_since_s is None) or rest.time_s - heard_s > gap_s:
                break
            length_s = rest.time_s - start_s
            if length_s >= needed_s and (latest is None or rest.time_s - latest.end_s >= _REST_JUDGED_S):
                enough, latest = latest or enough, Window(start_s, rest.time_s, gyro.angle_rad)
            if sureness is not None and resting and length_s >= asks_s:
                asks_s = _asked_next(length_s, settings.shortest_s)
                known[length_s] = sureness(start_s, rest.time_s)
                # Noise, unlike swaying, is averaged out by standing longer.
                noisy = rest.needed_s(settings) > _NOISY * settings.dwell_s
                long_enough = length_s >= settings.shortest_s
                if long_enough and _is_enough({} if noisy else known, known[length_s], length_s, settings):
                    needed_s = length_s
        else:
            if resting and gyro.samples > samples:
                _learn_bias(gyro, angle, rest.time_s - start_s)
            return Window(start_s, rest.time_s, gyro.angle_rad, resting)
        if latest is not None:  # long enough, if not for all readings
            return enough or latest
    return Window(start_s, rest.time_s, gyro.angle_rad, rested=False)


def _asked_next(length_s: float, shortest_s: float) -> float:
    """Return at which length to ask again: as soon as a dwell may end, and not before."""
    if length_s < shortest_s:
        return shortest_s
    later_s = length_s + _ASK_EVERY_S
    return min(later_s, _SWAYS_S) if length_s < _SWAYS_S else later_s


def _is_enough(
    known: Mapping[float, float], now_deg: float, length_s: float, settings: DwellSettings
) -> bool:
    """Tell whether a dwell may end, from how sure the heading was after each length before, degrees."""
    if now_deg <= settings.enough_deg:
        return True
    halves_deg = [sure_deg for at_s, sure_deg in known.items() if at_s <= 0.5 * length_s]
    return bool(halves_deg) and length_s >= _SWAYS_S and now_deg > _MUCH_SURER * halves_deg[-1]


def _learn_bias(gyro: GyroAngle, angle_before_rad: float, seconds: float) -> None:
    """Take what the gyro integrated at rest as its bias; live turns need no better one."""
    drift = (gyro.angle_rad - angle_before_rad) / seconds
    if abs(drift) < math.radians(2.0):
        gyro.note_rest(gyro.bias_radps + drift)


def visit(
    context: Context,
    mover: Mover,
    count: int,
    step_rad: float,
    settings: DwellSettings,
    seen: Sequence[Window] = (),
    at_each: Callable[[], Script[None]] | None = None,
    sureness: Sureness | None = None,
    between: Callable[[list[Window]], Script[None]] | None = None,
) -> Script[list[Window]]:
    """Visit positions, `step_rad` apart as well as the vehicle can; the first is where it is.

    With `count` positions `seen` already, one more is visited, half a step between those. `at_each` is
    done at each that the vehicle turns on from, while it dwells, and `between` before it turns on, with what
    was visited; `sureness` ends its dwell, see `dwell`.
    """
    windows, wanted = list(seen), max(count, len(seen) + 1)
    if seen and at_each is not None:
        yield from at_each()
    while len(windows) < wanted:
        index = len(windows)
        if index:
            context.show(
                "turn", f"Turning to position {index + 1} of {wanted}.", (index - 0.5) / (wanted + 1.0)
            )
            angle_rad = _next_turn(mover.gyro, windows, count, step_rad)
            yield from mover.next(context, angle_rad, wanted - index)
        context.show(
            "dwell",
            f"Position {index + 1} of {wanted}: measuring.",
            index / (wanted + 1.0),
            position=float(index + 1),
            turned_deg=math.degrees(mover.gyro.angle_rad),
        )
        meanwhile = at_each if index + 1 < wanted else None
        window = yield from dwell(context, mover, settings, sureness, meanwhile)
        if mover.accept(context, window.turned_rad):
            windows.append(window)
        if between is not None and len(windows) < wanted:
            yield from between(windows)
    return windows


def _next_turn(gyro: GyroAngle, windows: list[Window], count: int, step_rad: float) -> float:
    """Return the turn to the next even step of the circle; what went too far or too short is made up."""
    steps = len(windows) if len(windows) < count else len(windows) - 0.5
    wanted = windows[0].turned_rad + steps * step_rad
    share = (wanted - gyro.angle_rad) / step_rad
    return step_rad * max(0.5, min(1.5, share))


# --- in one turn -----------------------------------------------------------------------------------


def turn_through(
    context: Context,
    mover: Mover,
    count: int,
    step_rad: float,
    settings: DwellSettings,
    seen: Sequence[Window] = (),
    at_first: Callable[[], Script[None]] | None = None,
    sureness: Sureness | None = None,
) -> Script[list[Window]]:
    """Stand at the first position, then turn through all of them without a stop, back to the first.

    The field's mean over any arc is exact once the gyro tells how far it turned inside (S1), so no stop is
    needed for the iron. How late the compass is read is only a constant heading while the rate stays; what
    shows as the rate changes is part of the fit.
    With positions `seen` already it only turns on by one step. `at_first` is done while it stands;
    `sureness` ends its dwell, see `dwell`.
    """
    windows, angle_rad, rest, gyro = list(seen), step_rad * (1 if seen else count), mover.rest, mover.gyro
    if not windows:
        context.show("dwell", "Measuring where it stands.", 0.0)
        windows.append((yield from dwell(context, mover, settings, sureness, at_first)))
    text = f"Turning by {abs(math.degrees(angle_rad)):.0f} deg without a stop."
    context.show("turn", text, 1.0 / (count + 1.0), turned_deg=math.degrees(gyro.angle_rad))
    began_s = rest.time_s
    yield from mover.next(context, angle_rad, 1)
    return [*windows, Window(began_s, rest.time_s, gyro.angle_rad, rested=False)]


def stood_since(context: Context, mover: Mover, turn: Window, settings: DwellSettings) -> Script[Window]:
    """Return the stand after a turn, as soon as it shows the heading: most of it has passed in solving.

    What swings on is taken as it is after a while, its turning explained by the gyro. Raises LinkLost where
    no IMU messages come.
    """
    since_s, began_s, rest, gyro = turn.end_s, math.inf, mover.rest, mover.gyro
    while rest.time_s - since_s < _AVERAGES_S + _STANDS_S:
        yield from pause(context, 0.05)
        began_s = min(began_s, context.now)  # what came while all was solved is heard only now
        if context.now > began_s + settings.patience_s + _GOES_ON_S:
            raise LinkLost("The IMU messages stopped coming.", "Bring the link back and run again.")
        if abs(gyro.rate_radps) > SLOW_RADPS and context.now < began_s + settings.patience_s:
            since_s = rest.time_s
    return Window(since_s + _AVERAGES_S, rest.time_s, gyro.angle_rad)
