"""By how much true north is ahead of a compass's magnetic one, and what that rests on.

The model's declination is good to some tenths of a degree, rocks and steel aside. What moves along its nose,
or has a second antenna, sees how far its true heading is ahead of the magnetic one: by D, the declination and
the compass's mounting about the vertical together, which no single vehicle can tell apart. Of means over
seconds near one heading psi, at ground speed v and turning at r,

    y = D + b . u(psi) + c . u(2 psi) + w . u(psi) / v + (T + l / v) r + s + noise,                    (D2)

u the unit vector of an angle; b, c the deviation that a calibration left; w wind, current and what the
receiver's velocity is off by, which wander; T how late the receiver is, l how far it is before the wheels; s
the slip, which wanders, too. All but D are Gaussian, of sizes and correlation times that are not known: those
of a grid count by their likelihood. So D is as sure as headings and minutes allow, and what was seen at one
heading only, where a deviation looks the same, is not sure.
"""

from __future__ import annotations

import itertools
import math
from collections import deque
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from mavcompass import messages as mav
from mavcompass.earth_field import EarthField
from mavcompass.frames import FloatArray, circular_mean, wrap_pi
from mavcompass.messages import telemetry

# One sigma by which what moves ahead does so beside its nose, all along: of wheels (workshops set a car's
# thrust angle within a quarter of a degree), of a keel beside its screw, of wings and rudder as trimmed.
STEADY_RAD = {
    "rover": math.radians(0.2),
    "ackermann-rover": math.radians(0.2),
    "boat": math.radians(1.0),
    "plane": math.radians(1.0),
}
# The same of antennas, as they are aligned, and of a compass, as it is mounted about the vertical.
ANTENNA_RAD, MOUNTED_RAD = math.radians(1.5), math.radians(3.0)
# Beyond so many sigmas of the mounting it is none: a wrong orientation, or driven backwards.
_BEYOND = 3.0
# Slower than this the receiver's noise turns its course; slower to turn than this, it is straight.
_COURSE_MPS, _STRAIGHT_RADPS = 2.0, math.radians(8.0)
# What drives ahead does so for most of the time; fewer seconds show nothing.
_MOSTLY, _FEWEST_S = 0.8, 5
# Local anomalies that matter begin at a degree: what is not known to that tells of none.
_TOLD_RAD = math.radians(1.0)
# Receivers are 0.1 to 0.2 s late (GPS_DELAY_MS, EKF2_GPS_DELAY), and within a metre of the wheels.
_LATE_S, _LEVER_M = 0.2, 0.5
_FLOOR_RAD = math.radians(0.05)
_SECTORS, _SHORTEST_S, _MOST_MEANS = 24, 5.0, 48
# Sizes of b (of c: half), w and s; how long w and s last.
_GRID = np.array(
    list(
        itertools.product(
            np.radians([0.5, 2.0, 8.0]),
            [0.03, 0.3, 3.0],
            np.radians([0.15, 0.7]),
            [60.0, 1e6],
            [10.0, 100.0],
        )
    )
)
# Live, so many fixes are kept: ten minutes of five a second.
_MOST_FIXES = 3000
_WORDS = {"gps-course": "course", "gps-yaw": "the second antenna"}


@dataclass(frozen=True, slots=True)
class NorthSeen:
    """Hold by how much a true heading was seen ahead of the magnetic one.

    Attributes:
        by: "gps-course" or "gps-yaw". turn_rad: D. seconds: that were seen.
        chance_rad, steady_rad: one sigma of what time and headings average out, and of what they do not.
    """

    by: str
    turn_rad: float
    chance_rad: float
    steady_rad: float
    seconds: float

    @property
    def sigma_rad(self) -> float:
        """Return one sigma."""
        return math.hypot(self.chance_rad, self.steady_rad)

    @property
    def told(self) -> bool:
        """Tell whether it is sure enough to tell of a local anomaly."""
        return self.chance_rad < _TOLD_RAD

    def words(self) -> str:
        """Say what it was seen by, and for how long."""
        lasted = f"{self.seconds / 60.0:.0f} minutes" if self.seconds >= 90.0 else f"{self.seconds:.0f} s"
        return f"{lasted} of {_WORDS[self.by]}"


@dataclass(frozen=True, slots=True)
class TrueNorth:
    """Hold what is added to a compass's magnetic heading to make it a true one.

    Attributes:
        turn_rad, sigma_rad: that, and one sigma. world: the Earth's field by the model.
        learnt: what it rests on; where that is nothing, on the model. doubted: what else was seen.
    """

    turn_rad: float
    sigma_rad: float
    world: EarthField
    learnt: tuple[NorthSeen, ...] = ()
    doubted: tuple[NorthSeen, ...] = ()

    @classmethod
    def of(cls, world: EarthField, seen: Sequence[NorthSeen] = ()) -> TrueNorth:
        """Combine the model's declination with what was seen, by inverse variance.

        What was seen holds the compass's mounting, too: beside it the model is no surer than that. What is
        not sure, or further off than a mounting can be, does not count.
        """
        model = world.declination_sigma_rad
        mounted = math.hypot(model, MOUNTED_RAD)
        beyond = {one: float(wrap_pi(one.turn_rad - world.declination_rad)) for one in seen}
        counts = {
            one: one.told and abs(off) < _BEYOND * math.hypot(mounted, one.sigma_rad)
            for one, off in beyond.items()
        }
        learnt, doubted = (tuple(one for one in seen if counts[one] is which) for which in (True, False))
        if not learnt:
            return cls(world.declination_rad, model, world, (), doubted)
        weight = sum(one.sigma_rad**-2.0 for one in learnt) + mounted**-2.0
        turn = sum(beyond[one] * one.sigma_rad**-2.0 for one in learnt) / weight
        return cls(float(wrap_pi(world.declination_rad + turn)), weight**-0.5, world, learnt, doubted)

    def words(self) -> str:
        """Say what it rests on, and what does not count."""
        degrees, world = math.degrees, self.world
        said = f"declination {degrees(world.declination_rad):+.1f} deg by the model"
        if self.learnt:
            told = " and ".join(one.words() for one in self.learnt)
            turn, sigma = degrees(self.turn_rad), degrees(self.sigma_rad)
            said = f"learnt from {told} here: {turn:+.1f} +- {sigma:.1f} deg, mounting included; {said}"
        said += f", sigma {degrees(world.declination_sigma_rad):.2f} deg"
        for one in self.doubted:
            off, sigma = (degrees(a) for a in (one.turn_rad, one.sigma_rad))
            why = "go through all headings" if not one.told else "no compass is mounted so far off"
            said += f"; not told by {one.words()} ({off:+.0f} +- {sigma:.1f} deg): {why}"
        return said

    def proofs(self, instance: int) -> Iterator[tuple[str, float, float]]:
        """Yield how far a compass is off by each source that is sure: a sentence, degrees, sigma."""
        for one in (*self.learnt, *(one for one in self.doubted if one.told)):
            off = math.degrees(wrap_pi(one.turn_rad - self.world.declination_rad))
            sigma = math.degrees(math.hypot(one.sigma_rad, self.world.declination_sigma_rad))
            side = f"{abs(off):.1f} deg {'right' if off > 0.0 else 'left'} of what compass {instance} says"
            yield f"By {one.words()} the vehicle points {side} (sigma {sigma:.1f}).", off, sigma

    def to_json(self) -> dict[str, Any]:
        """Return it as plain values."""
        shown = {
            "turn_deg": self.turn_rad,
            "sigma_deg": self.sigma_rad,
            "declination_deg": self.world.declination_rad,
            "declination_sigma_deg": self.world.declination_sigma_rad,
        }
        told = {name: round(math.degrees(value), 3) for name, value in shown.items()}
        return {**told, "learnt_by": [one.by for one in self.learnt], "rests_on": self.words()}


class NorthLearner:
    """Keep the latest fixes of a live receiver beside a compass's headings."""

    def __init__(self) -> None:
        self._rows: deque[tuple[float, ...]] = deque(maxlen=_MOST_FIXES)
        self._heard = 0

    @property
    def numbers(self) -> tuple[int, int]:
        """Return the numbers of the first fix that is kept, and of the next to come."""
        return self._heard - len(self._rows), self._heard

    def hear(self, boot_s: float, magnetic_rad: float, gps: mav.GpsRawInt) -> None:
        """Take a fix, and the heading of its moment; one that tells no heading is left."""
        north, east, _ = telemetry.ground_velocity_mps(gps).tolist()
        antenna_rad = float(telemetry.second_antenna_rad(gps))
        if self._rows and boot_s < self._rows[-1][0]:
            self._rows.clear()  # the vehicle was started again
        if math.hypot(north, east) > _COURSE_MPS or not math.isnan(antenna_rad):
            self._rows.append((boot_s, magnetic_rad, north, east, antenna_rad))
            self._heard += 1

    def seen(self, kind: str) -> tuple[NorthSeen, ...]:
        """Tell what they show of a kind of vehicle."""
        rows = np.array(self._rows).reshape(-1, 5)
        return north_seen(kind, rows[:, 0], rows[:, 1], rows[:, 2:4], rows[:, 4])


def north_seen(
    kind: str, time_s: FloatArray, magnetic_rad: FloatArray, velocity_mps: FloatArray, antenna_rad: FloatArray
) -> tuple[NorthSeen, ...]:
    """Compare magnetic headings with the course and a second antenna's yaw.

    Args:
        kind: of vehicle; a course says nothing of the nose of what also moves sideways.
        time_s, magnetic_rad: (N,), slow and upright. velocity_mps: over ground, north and east, (N, 2).
        antenna_rad: true yaw, (N,). All may be nan.
    """
    seen = []
    speed = np.hypot(velocity_mps[:, 0], velocity_mps[:, 1])
    off = np.arctan2(velocity_mps[:, 1], velocity_mps[:, 0]) - magnetic_rad
    moves = np.flatnonzero(np.isfinite(off) & (speed > _COURSE_MPS))
    if kind in STEADY_RAD and moves.size:
        ahead = np.cos(off[moves] - 0.5 * circular_mean(2.0 * off[moves])) > 0.0
        ahead ^= ahead.mean() < 0.5
        if ahead.mean() >= _MOSTLY:  # else it drives backwards as often
            rows = moves[ahead]
            seen.append(("gps-course", STEADY_RAD[kind], rows, off[rows], 1.0 / speed[rows]))
    rows = np.flatnonzero(np.isfinite(antenna_rad - magnetic_rad))
    seen.append(("gps-yaw", ANTENNA_RAD, rows, (antenna_rad - magnetic_rad)[rows], np.zeros(rows.size)))
    fits = [
        (by, steady, _fit(time_s[rows], magnetic_rad[rows], off, slow))
        for by, steady, rows, off, slow in seen
    ]
    return tuple(NorthSeen(by, fit[0], fit[1], steady, fit[2]) for by, steady, fit in fits if fit is not None)


def _fit(
    time_s: FloatArray, psi_rad: FloatArray, off_rad: FloatArray, slowness: FloatArray
) -> tuple[float, float, float] | None:
    """Fit (D2): D, one sigma of it, radians, and how many seconds told it; None where too few did."""
    if time_s.size < _FEWEST_S:
        return None
    centre = circular_mean(off_rad)
    columns = (time_s, wrap_pi(off_rad - centre), slowness, np.cos(psi_rad), np.sin(psi_rad))
    _, second = np.unique(np.floor(time_s), return_inverse=True)
    time, off, slow, cos, sin = _means(second, *columns)
    if time.size < _FEWEST_S:
        return None
    psi = np.unwrap(np.arctan2(sin, cos))
    rate = np.gradient(psi, time)
    straight = np.abs(rate) < _STRAIGHT_RADPS
    if int(straight.sum()) < _FEWEST_S:
        return None
    columns = tuple(c[straight] for c in (time, off, slow, np.cos(psi), np.sin(psi), rate, off**2))
    sector = np.floor(np.mod(psi[straight], 2.0 * math.pi) / (2.0 * math.pi) * _SECTORS)
    lasts_s, means = _SHORTEST_S, _MOST_MEANS + 1
    while means > _MOST_MEANS:
        _, which = np.unique(np.floor(columns[0] / lasts_s) * _SECTORS + sector, return_inverse=True)
        means, lasts_s = int(which.max()) + 1, 1.3 * lasts_s
    time, off, slow, cos, sin, rate, square = _means(which, *columns)
    count = np.bincount(which)
    within2 = float((count * (square - off**2)).sum()) / max(which.size - count.size, 1)
    turn, chance = _likeliest(time, np.arctan2(sin, cos), off, slow, rate, within2 / count + _FLOOR_RAD**2)
    return float(wrap_pi(centre + turn)), chance, float(which.size)


def _means(which: NDArray[np.intp], *columns: FloatArray) -> tuple[FloatArray, ...]:
    """Average columns (N,) over the rows of each number in `which`, (N,)."""
    return tuple(np.bincount(which, column) / np.bincount(which) for column in columns)


def _likeliest(
    time: FloatArray, psi: FloatArray, off: FloatArray, slow: FloatArray, rate: FloatArray, noise2: FloatArray
) -> tuple[float, float]:
    """Return D of means (K,) and its sigma, by all of the grid."""
    size, wind, slip, wind_s, slip_s = (column[:, np.newaxis, np.newaxis] for column in _GRID.T)
    apart, between_s = np.subtract.outer(psi, psi), np.abs(np.subtract.outer(time, time))
    slower = np.outer(slow, slow)
    known = np.outer(rate, rate) * (_LATE_S**2 + _LEVER_M**2 * slower) + np.diag(noise2)
    bent = size**2 * (np.cos(apart) + 0.25 * np.cos(2.0 * apart))
    pushed = wind**2 * slower * np.cos(apart) * np.exp(-between_s / wind_s)
    # The last two rows of the factor of [[K, X], [X', 1e12]] are X' of the lower factor's inverse.
    count, both = psi.size, np.stack([np.ones(psi.size), off])
    whole = np.zeros((len(_GRID), count + 2, count + 2))
    whole[:, :count, :count] = known + bent + pushed + slip**2 * np.exp(-between_s / slip_s)
    whole[:, count:, :count] = both
    whole[:, count:, count:] = 1e12 * np.eye(2)
    factor = np.linalg.cholesky(whole)  # which reads the lower half
    ones, offs = factor[:, count, :count], factor[:, count + 1, :count]
    sure = (ones**2).sum(axis=1)
    found = (ones * offs).sum(axis=1) / sure
    spread = 2.0 * np.log(np.diagonal(factor, axis1=1, axis2=2)[:, :count]).sum(axis=1) + np.log(sure)
    log = -0.5 * (spread + (offs**2).sum(axis=1) - found**2 * sure)
    share = np.exp(log - log.max())
    share /= share.sum()
    turn = float(share @ found)
    return turn, math.sqrt(float(share @ (1.0 / sure + (found - turn) ** 2)))
