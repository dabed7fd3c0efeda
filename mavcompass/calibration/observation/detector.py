"""Tell live, reading by reading, whether a vehicle stands still, and how noisy its sensors are."""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np

from mavcompass.units import STANDARD_GRAVITY_MPS2

STILL_RATE_RADPS = math.radians(3.0)
STILL_TILT_RATE_RADPS = math.radians(6.0)
# Hunting inside these limits can be averaged over; more of it makes a new position.
LONGEST_SWING_RAD = math.radians(14.0)
RATE_SMOOTHING_S = 0.5
# White noise of the tilt rate has a mean of its own: the length of two noisy components.
TILT_FLOOR = 1.3
# Two readings of a noisy compass lie so many sigmas of one component apart once in a hundred thousand.
_FIELD_CHANCE = 7.5
# Steadier than that no field is between two readings at rest.
_FIELD_STEP_MGAUSS = 60.0
_NOISE_SAMPLES = 40
WHEELED = frozenset({"rover", "ackermann-rover"})
# The mean forces of so long before and after a moment are compared: a change of this much leans the
# accelerometer by half a degree; what chance gives is no change.
_HALF_S, _LEAST_STEP_MPS2, _CHANCE = 0.25, 0.08, 5.0

# What `Stillness.why_not` means, for a person.
UNREST = {
    "rotating": "it still turns",
    "hunting": "its nose still swings",
    "tilting": "it still rocks",
    "rolling": "it still rolls",
    "field changing": "the magnetic field changes; is iron or a current moving near it?",
    "starting": "the first readings",
}


def unrest(why_not: str) -> str:
    """Say for a person why something does not count as still, by `Stillness.why_not` or in words already."""
    return UNREST.get(why_not, why_not) or "not for long enough"


@dataclass(frozen=True, slots=True)
class Stillness:
    """Say whether a vehicle stands still.

    Attributes:
        still: True once it has been quiet for the detector's hold time.
        since_s: the time since when it has been quiet (nan while it is not).
        why_not: "rotating", "hunting", "tilting", "rolling", "field changing", "starting", or "" when still.
        rate_radps: mean rate about the vertical over the last half second, clockwise positive.
        turned_rad: the angle turned since the detector was made.
    """

    still: bool
    since_s: float
    why_not: str
    rate_radps: float
    turned_rad: float


class WhiteNoise:
    """Follow the white noise of a vector, per component, by the second differences of its latest samples.

    Smooth motion hardly shows in these, and the median is not moved by a few that are no noise. Samples that
    are repeated show none.
    """

    def __init__(self) -> None:
        self._before: deque[tuple[float, ...]] = deque(maxlen=2)
        self._bends: deque[tuple[float, ...]] = deque(maxlen=_NOISE_SAMPLES)

    def hear(self, values: tuple[float, ...]) -> None:
        """Take the next sample."""
        if len(self._before) == 2:
            first, second = self._before
            self._bends.append(
                tuple(abs(a - 2.0 * b + c) for a, b, c in zip(first, second, values, strict=True))
            )
        self._before.append(values)

    @property
    def sigma(self) -> float:
        """Return the root of the mean square of the components' sigmas; 0 while too little was heard."""
        if len(self._bends) < 8:
            return 0.0
        medians = [sorted(column)[len(column) // 2] for column in zip(*self._bends, strict=True)]
        return math.hypot(*medians) / math.sqrt(len(medians)) / (0.6745 * math.sqrt(6.0))


class RollingWitness:
    """Tell live, reading by reading, whether a vehicle on wheels brakes or gathers way.

    Steered wheels that go straight may still roll: no gyro sees that, while a braking of 1 m/s^2 leans the
    accelerometer's down by six degrees. It is seen where it begins and ends: there the specific force changes
    by more than the body's turning explains.
    """

    def __init__(self) -> None:
        self._felt: deque[tuple[float, ...]] = deque()  # time, force, angle turned

    def hear(self, time_s: float, gyro_radps: tuple[float, ...], acc_mps2: tuple[float, ...]) -> None:
        """Take the next reading, body axes."""
        angle = [0.0, 0.0, 0.0]
        if self._felt:
            before = self._felt[-1]
            lasted_s = time_s - before[0]
            angle = [a + lasted_s * rate for a, rate in zip(before[4:], gyro_radps, strict=True)]
        self._felt.append((time_s, *acc_mps2, *angle))
        while self._felt[0][0] < time_s - 2.0 * _HALF_S:
            self._felt.popleft()

    def rolls(self, noise_mps2: float) -> bool:
        """Tell whether the force of the last quarter of a second is another than that of the one before."""
        felt = np.array(self._felt)
        late = felt[:, 0] > felt[-1, 0] - _HALF_S
        if late.all() or not np.isfinite(felt).all():
            return False
        before, after = felt[~late].mean(axis=0), felt[late].mean(axis=0)
        turned = np.cross(after[4:] - before[4:], 0.5 * (before[1:4] + after[1:4]))
        step = float(np.linalg.norm(after[1:4] - before[1:4] + turned))
        chance = _CHANCE * noise_mps2 * math.sqrt(2.0 / min(late.sum(), (~late).sum()))
        return step > math.hypot(_LEAST_STEP_MPS2, chance)


class StillnessDetector:
    """Tell, reading by reading, whether the vehicle stands still enough to average the compass.

    It has no clock: the time comes with the readings. `hold_s` is how long quiet must last before the
    vehicle counts as still. What has `wheels` may roll although nothing turns.
    """

    def __init__(self, hold_s: float = 1.0, wheels: bool = False) -> None:
        self._hold_s = hold_s
        self._wheels = RollingWitness() if wheels else None
        self._window: deque[tuple[float, float, float]] = deque()
        self._tilt_noise, self._force_noise, self._field_noise = WhiteNoise(), WhiteNoise(), WhiteNoise()
        self._turned = self._rate = 0.0
        self._last: tuple[float, float] | None = None
        self._quiet_since = math.nan
        self._quiet_from = (0.0, (0.0, 0.0, 0.0))
        self._down = (0.0, 0.0, 1.0)
        self._reason = "starting"

    def update(
        self,
        time_s: float,
        gyro_radps: Iterable[float],
        acc_mps2: Iterable[float],
        mag_mgauss: Iterable[float],
    ) -> Stillness:
        """Take one reading of each sensor, body FRD, and judge.

        A reading older than the one before (a late or repeated packet) changes nothing.
        """
        (gx, gy, gz), (ax, ay, az) = map(float, gyro_radps), map(float, acc_mps2)
        mx, my, mz = map(float, mag_mgauss)
        if self._last is not None and time_s <= self._last[0]:
            return self._state(self._last[0])
        self._follow_gravity(time_s, (ax, ay, az))
        dx, dy, dz = self._down
        rate = gx * dx + gy * dy + gz * dz
        tilt_rate = math.hypot(gx - rate * dx, gy - rate * dy, gz - rate * dz)
        if self._last is not None:
            self._turned += 0.5 * (rate + self._last[1]) * (time_s - self._last[0])
        self._last = (time_s, rate)
        self._tilt_noise.hear((gx - rate * dx, gy - rate * dy, gz - rate * dz))
        self._force_noise.hear((ax, ay, az))
        self._field_noise.hear((mx, my, mz))
        if self._wheels is not None:
            self._wheels.hear(time_s, (gx, gy, gz), (ax, ay, az))
        self._window.append((time_s, rate, tilt_rate))
        while self._window[0][0] < time_s - RATE_SMOOTHING_S:
            self._window.popleft()
        self._rate = self._mean(1)
        self._judge(time_s, (mx, my, mz))
        return self._state(time_s)

    def averaging_s(self, tilt_rad: float, field_mgauss: float) -> float:
        """Return how long to average until white noise leaves so little of the tilt and of the field.

        Both are sigmas of the mean, of one component.
        """
        if len(self._window) < 2:
            return 0.0
        interval_s = (self._window[-1][0] - self._window[0][0]) / (len(self._window) - 1)
        tilt = self._force_noise.sigma / (STANDARD_GRAVITY_MPS2 * tilt_rad)
        field = self._field_noise.sigma / field_mgauss
        return max(tilt, field) ** 2 * interval_s

    def _follow_gravity(self, time_s: float, acc: tuple[float, float, float]) -> None:
        length = math.hypot(*acc)
        if not math.isfinite(length) or length < 1.0:
            return
        gain = 1.0 if self._last is None else min((time_s - self._last[0]) / 0.5, 1.0)
        x, y, z = (old - gain * (a / length + old) for old, a in zip(self._down, acc, strict=True))
        size = math.hypot(x, y, z) or 1.0
        self._down = (x / size, y / size, z / size)

    def _judge(self, time_s: float, mag: tuple[float, float, float]) -> None:
        # A noise takes a sort: it is asked only where less than it allows is exceeded.
        tilt = self._mean(2)
        if abs(self._rate) > 3.0 * STILL_RATE_RADPS:
            self._stir("rotating")
        elif abs(self._rate) > STILL_RATE_RADPS:
            self._stir("hunting")
        elif tilt > (limit := STILL_TILT_RATE_RADPS) and tilt > limit + TILT_FLOOR * self._tilt_noise.sigma:
            self._stir("tilting")
        elif self._wheels is not None and self._wheels.rolls(self._force_noise.sigma):
            self._stir("rolling")
        elif math.isnan(self._quiet_since):
            self._begin(time_s, mag)
        else:
            turned, field = self._quiet_from
            if abs(self._turned - turned) > LONGEST_SWING_RAD:
                self._begin(time_s, mag)
                self._reason = "hunting"
            elif self._field_moved(math.dist(mag, field), abs(self._turned - turned)):
                self._begin(time_s, mag)
                self._reason = "field changing"

    def _field_moved(self, by_mgauss: float, turned_rad: float) -> bool:
        """Tell whether a reading at rest lies farther from another than chance and a small turn take it."""
        least, by_mgauss = _FIELD_STEP_MGAUSS, by_mgauss - 300.0 * turned_rad
        return by_mgauss > least and by_mgauss > math.hypot(least, _FIELD_CHANCE * self._field_noise.sigma)

    def _mean(self, column: int) -> float:
        return sum([row[column] for row in self._window]) / len(self._window)

    def _stir(self, reason: str) -> None:
        self._quiet_since = math.nan
        self._reason = reason

    def _begin(self, time_s: float, mag: tuple[float, float, float]) -> None:
        self._quiet_since = time_s
        self._quiet_from = (self._turned, mag)

    def _state(self, time_s: float) -> Stillness:
        still = not math.isnan(self._quiet_since) and time_s - self._quiet_since >= self._hold_s
        why_not = "" if still else self._reason
        return Stillness(still, self._quiet_since, why_not, self._rate, self._turned)
