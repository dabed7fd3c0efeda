"""The heading of every compass, message by message: plain numbers, no arrays, a few microseconds each.

With the unit vector d that points down, in body axes, and the field m, also in body axes:

    forward = x - (x d) d,   right = d x forward,   heading = atan2(-m right, m forward)

which is the tilt-compensated heading written without angles: only the horizontal part of m counts.
"""

from __future__ import annotations

import math
from cmath import exp, phase
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

from mavcompass import messages as mav
from mavcompass.attitude.level import Level
from mavcompass.attitude.vectors import Vector, dot
from mavcompass.correction import FieldCorrection
from mavcompass.earth_field import EarthField
from mavcompass.frames import FloatArray
from mavcompass.heading.doubt import TILT_SIGMA_RAD, UNKNOWN_CALIBRATION_SIGMA_RAD, CalibrationDoubt
from mavcompass.heading.fault_isolation import HeadingSource, isolate_faults
from mavcompass.heading.true_north import NorthLearner, NorthSeen, TrueNorth

_TWO_PI = 2.0 * math.pi
# Autopilots average the compass over 100 ms and repeat it: a turning vehicle's reading is old by about this
# much, and by as much more or less: the age that is taken, the newest and the oldest.
_LAGS_S = 0.1, 0.0, 0.2
_QUANTUM_SIGMA_MGAUSS = 1.0 / math.sqrt(12.0)
# What the field's strength tells of the calibration is averaged over some fifty readings a sector, and looked
# at so often.
_KEEP, _LOOK_S = 0.98, 0.5
# Compasses are held against each other over so long, while both are heard and the lag of neither matters.
_AGREE_S, _TOGETHER_S, _SLOW_RADPS = 10.0, 1.0, math.radians(10.0)


@dataclass(frozen=True, slots=True)
class Heading:
    """Hold one heading.

    Attributes:
        time_s: arrival, on the link's clock. boot_s: its moment, on the vehicle's.
        instance: the compass, from 1.
        magnetic_rad, true_rad: in [0, 2 pi); true is None where the declination is not known.
        sigma_rad, true_sigma_rad: standard deviation of the magnetic heading, and of the true one.
        level_mgauss: the field along forward, right and down of the levelled vehicle.
        turned_rad: the gyro's angle at that moment.
        newer_rad, older_rad: by how much more it would be were the reading as new, or as old, as it may be.
    """

    time_s: float
    boot_s: float
    instance: int
    magnetic_rad: float
    true_rad: float | None
    sigma_rad: float
    level_mgauss: Vector
    turned_rad: float = 0.0
    newer_rad: float = 0.0
    older_rad: float = 0.0
    true_sigma_rad: float | None = None

    @property
    def from_gyro_rad(self) -> float:
        """Return how far it is ahead of the gyro's angle, which is comparable between moments."""
        return self.magnetic_rad - self.turned_rad

    @property
    def total_mgauss(self) -> float:
        """Return the length of the field."""
        return math.hypot(*self.level_mgauss)

    @property
    def horizontal_mgauss(self) -> float:
        """Return the length of its horizontal part."""
        return math.hypot(self.level_mgauss[0], self.level_mgauss[1])

    @property
    def dip_rad(self) -> float:
        """Return its angle below the horizon."""
        return math.atan2(self.level_mgauss[2], self.horizontal_mgauss)


class LiveCompass:
    """Turn one compass's readings into headings with sigma.

    Attributes:
        calibration_sigma_rad: heading sigma of the calibration in force.
        world: the Earth's field at the vehicle, None while its place is unknown.
        latest: the last heading, None before the first.
        north: what makes it a true one, None while the place is unknown. fixes: what that is learnt from.
        own_sigma_rad: its sigma by what this compass alone shows. beyond_rad: how far it may be off beyond
            that by what others show, see `Agreement`.
    """

    def __init__(self, instance: int) -> None:
        self.instance = instance
        self.calibration_sigma_rad = UNKNOWN_CALIBRATION_SIGMA_RAD
        self.world: EarthField | None = None
        self.latest: Heading | None = None
        self.north: TrueNorth | None = None
        self._affine: tuple[Vector, Vector, Vector, Vector] | None = None
        self.restart()

    def restart(self) -> None:
        """Forget how noisy and how far off the field was: the correction in force has changed."""
        self.own_sigma_rad = self.beyond_rad = 0.0
        self._before: Vector | None = None
        self._new_s = 0.0  # the vehicle's time when the reading was new
        self._doubt, self._looked_s = CalibrationDoubt(0.0, self.world), -math.inf
        self._by_sector: list[float] = []
        self._scatter2 = 0.0
        self.fixes = NorthLearner()
        self.set_north(())

    def set_world(self, world: EarthField | None) -> None:
        """Say what the field should be."""
        self.world, self._looked_s = world, -math.inf
        self._doubt.world = world
        self.set_north(() if self.north is None else (*self.north.learnt, *self.north.doubted))

    def set_north(self, seen: Sequence[NorthSeen]) -> None:
        """Say by how much true north was seen ahead of magnetic here."""
        self.north = None if self.world is None else TrueNorth.of(self.world, seen)

    def hear_receiver(self, gps: mav.GpsRawInt) -> None:
        """Take a fix, beside the latest heading."""
        if self.latest is not None:
            self.fixes.hear(self.latest.boot_s, self.latest.magnetic_rad, gps)

    def learn_north(self, kind: str) -> None:
        """Look at what the fixes show of a kind of vehicle."""
        self.set_north(self.fixes.seen(kind))

    def set_uncorrected(self, correction: FieldCorrection, rotation: FloatArray) -> None:
        """Say that this autopilot reports raw readings in sensor axes, and how to make a field of them."""
        matrix = correction.matrix @ rotation
        offset = correction.matrix @ correction.offsets_mgauss
        rows = [(float(r[0]), float(r[1]), float(r[2])) for r in (*matrix, offset)]
        self._affine = (rows[0], rows[1], rows[2], rows[3])

    def update(self, time_s: float, boot_s: float, reading_mgauss: Vector, level: Level) -> Heading | None:
        """Take one reading; None where it has no horizontal part to speak of."""
        m = reading_mgauss
        if self._affine is not None:
            rx, ry, rz, offset = self._affine
            m = (dot(rx, m) + offset[0], dot(ry, m) + offset[1], dot(rz, m) + offset[2])
        is_new, self._before = m != self._before, m
        if is_new:  # a repeated reading is as old as it is
            self._new_s = boot_s
        (field, magnetic, turned), *others = (
            _levelled(m, *level.at(self._new_s - late_s)) for late_s in _LAGS_S
        )
        horizontal = math.hypot(field[0], field[1])
        if horizontal < 1.0:
            return None
        newer, older = (math.remainder(psi - at - (magnetic - turned), _TWO_PI) for _, psi, at in others)
        if is_new:
            self._doubt.add(*field, keep=_KEEP)
        now_rad = level.at(boot_s)[1]
        magnetic += now_rad - turned
        self.own_sigma_rad = self._sigma_rad(
            time_s, field, horizontal, level.sigma_rad, max(abs(newer), abs(older))
        )
        sigma = min(math.hypot(self.own_sigma_rad, self.beyond_rad), math.pi)
        true = true_sigma = None
        if self.north is not None:
            true = (magnetic + self.north.turn_rad) % _TWO_PI
            true_sigma = min(math.hypot(sigma, self.north.sigma_rad), math.pi)
        told = (time_s, boot_s, self.instance, magnetic % _TWO_PI, true, sigma)
        self.latest = Heading(*told, field, now_rad, newer, older, true_sigma)
        return self.latest

    def _sigma_rad(self, time_s: float, field: Vector, horizontal: float, tilt: float, late: float) -> float:
        """Combine calibration, noise, tilt and lag; see `heading.doubt`."""
        if time_s - self._looked_s >= _LOOK_S:
            usual = horizontal if self.world is None else self.world.horizontal_mgauss
            self._doubt.sigma_mgauss, self._looked_s = self.calibration_sigma_rad * usual, time_s
            self._by_sector = self._doubt.by_direction(horizontal)
            self._scatter2 = self._doubt.scatter_mgauss**2 + _QUANTUM_SIGMA_MGAUSS**2
        toward = math.atan2(field[1], field[0]) / _TWO_PI
        calibration = self._by_sector[math.floor(toward * len(self._by_sector))]
        tilt = field[2] / horizontal * math.hypot(tilt, TILT_SIGMA_RAD)
        noise2 = self._scatter2 / (horizontal * horizontal)
        return min(math.sqrt(calibration * calibration + noise2 + tilt * tilt + late * late), math.pi)


def _levelled(m: Vector, down: Vector, turned_rad: float) -> tuple[Vector, float, float]:
    """Return a reading's field in the level, its heading, and the gyro's angle that was given."""
    dx, dy, dz = down
    ahead = math.sqrt(dy * dy + dz * dz)  # length of the horizontal part of the body's x axis
    if ahead < 1e-3:
        return (0.0, 0.0, 0.0), 0.0, turned_rad
    # forward = (1 - dx^2, -dx dy, -dx dz) / ahead and right = (0, dz, -dy) / ahead
    along = m[0] * ahead - dx * (dy * m[1] + dz * m[2]) / ahead
    across = (dz * m[1] - dy * m[2]) / ahead
    return (along, across, dx * m[0] + dy * m[1] + dz * m[2]), math.atan2(-across, along), turned_rad


class Agreement:
    """Hold a vehicle's compasses against each other: what stands apart claims no less than that."""

    def __init__(self) -> None:
        self.restart()

    def restart(self) -> None:
        """Forget how they stood: a calibration was changed."""
        self._apart: dict[int, complex] = {}  # each heading less the first compass's, averaged
        self._heard_s: dict[int, float] = {}
        self._looked_s = -math.inf

    def hear(self, heading: Heading, compasses: Mapping[int, LiveCompass], rate_radps: float) -> None:
        """Take a heading by one of the compasses, while the vehicle turns so fast; tell all what follows."""
        first, instance, now_s = compasses[min(compasses)].latest, heading.instance, heading.time_s
        if first is None or now_s - first.time_s > _TOGETHER_S or abs(rate_radps) > _SLOW_RADPS:
            return
        kept = math.exp((self._heard_s.get(instance, -math.inf) - now_s) / _AGREE_S)
        apart = exp(1j * (heading.magnetic_rad - first.magnetic_rad))
        self._apart[instance] = apart + kept * (self._apart.get(instance, apart) - apart)
        self._heard_s[instance] = now_s
        if now_s - self._looked_s < _LOOK_S:
            return
        self._looked_s = now_s
        found = isolate_faults(
            [
                HeadingSource(f"compass {i}", (phase(apart), math.nan, math.nan), compasses[i].own_sigma_rad)
                for i, apart in self._apart.items()
            ]
        )
        for k, i in enumerate(self._apart):
            compasses[i].beyond_rad = found.beyond_rad(k)
