"""Make the sealed cases. Imports nothing but numpy: what is made here shares no line with what is judged.

A case is a vehicle, a motion and what its sensors report of it. Every number is rounded as it is made, so
that `seal` is the same on every machine. Body axes are forward, right, down; the world's north, east, down;
milligauss, radians, seconds.
"""

from __future__ import annotations

import hashlib
import math
from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from compassbench.motions import (
    GRAVITY,
    RNG,
    STEP_S,
    F,
    Motion,
    columns,
    drive,
    flight,
    hand,
    leaning,
    little,
    matrices,
    turn,
    wander,
)

SEED = 58_2026
AMPERES = 20.0
UTC_S = 1_780_272_000.0  # 2026-06-01
# Latitude, longitude, altitude, and the field there by WMM2025 (north, east, down, mG); and its sigma.
PLACES = (
    ((47.4, 8.5, 450.0), (215.25, 13.5, 433.08)),
    ((-35.36, 149.17, 584.0), (230.07, 51.78, -530.75)),
    ((37.4, -122.1, 10.0), (224.58, 50.76, 412.08)),
    ((1.35, 103.8, 20.0), (410.49, 1.6, -93.2)),
    ((59.9, 10.7, 100.0), (150.88, 13.14, 492.97)),
    ((-23.5, -46.6, 760.0), (160.16, -64.35, -148.84)),
)
WMM_SIGMA = (1.37, 0.89, 1.41)
ROTATIONS = {  # body <- how the compass lies, whole right angles
    "yaw 90": ((0, -1, 0), (1, 0, 0), (0, 0, 1)),
    "yaw 180": ((-1, 0, 0), (0, -1, 0), (0, 0, 1)),
    "yaw 270": ((0, 1, 0), (-1, 0, 0), (0, 0, 1)),
    "roll 180": ((1, 0, 0), (0, -1, 0), (0, 0, -1)),
    "roll 180 yaw 90": ((0, 1, 0), (1, 0, 0), (0, 0, -1)),
}


@dataclass(frozen=True)
class Truth:
    """Hold what is true: reading = gain (field in body) + offset + motor amperes; angles at each reading.

    Attributes:
        gain (3, 3), None where it is not known; offset (3,), motor (3,) per ampere; `loads` are the
            amperes that a result is judged at, `from_s` the time from which on all this holds.
        field (3,) in the world; euler (M, 3): roll, pitch, yaw at the compass's times, true north.
    """

    gain: F | None
    offset: F
    motor: F
    field: F
    euler: F
    loads: tuple[float, ...] = (0.0,)
    from_s: float = -math.inf


@dataclass(frozen=True)
class Case:
    """Hold one case as the vehicle reports it. `truth` is for the judge alone.

    Attributes:
        time (N,): of accelerometer, gyro and attitude (N, 3) and current (N,); the attitude's yaw is steered
            by the compass under test, through a filter of five seconds.
        mag_time (M,), mag (M, 3): the compass, nothing corrected.
        course (N, 2): velocity north and east by the receiver. place: latitude, longitude, altitude.
        world (3,): the field by the model at the place. answerable: False where refusing is right.
        given: for headings, the offset and matrix of the calibration in force, off by some 1.5 mG.
        baseline: for gaps, the same vehicle with nothing wrong.
    """

    kind: str
    index: int
    time: F
    acc: F
    gyro: F
    attitude: F
    mag_time: F
    mag: F
    place: tuple[float, float, float]
    world: F
    truth: Truth
    vehicle: str
    autopilot: str = "px4"
    current: F | None = None
    course: F | None = None
    answerable: bool = True
    given: tuple[F, F] | None = None
    baseline: Case | None = None

    def gyro_at_readings(self) -> F:
        """Return the rates at the compass's times, (M, 3)."""
        return columns(self.mag_time, self.time, self.gyro)


@dataclass(frozen=True)
class Kind:
    """Say what cases of one kind are made of; fields in milligauss, currents in amperes."""

    about: str
    motions: tuple[Callable[[RNG], Motion], ...]
    offset: tuple[float, float] = (20.0, 200.0)
    gain: float = 0.12
    cross: float = 0.06
    noise: tuple[float, float] = (1.0, 4.0)
    motor: tuple[float, float] = (0.0, 0.0)
    disturbed: bool = False
    turned: bool = False
    clipped: bool = False
    repeated: bool = False
    course: bool = False
    answerable: bool = True
    rate_hz: float = 10.0
    task: str = "calibration"
    count: int = 80


KINDS: dict[str, Kind] = {
    "turn": Kind("four stops or a slow circle on the level", (turn,)),
    "hand": Kind("turned by hand all over the sphere, 90 s", (hand,), rate_hz=25.0),
    "drive": Kind("a rover's drive with bends, braking, uneven ground", (drive,), course=True),
    "flight": Kind("a multirotor's flight, the load's field with its current", (flight,), motor=(0.3, 1.5)),
    "iron": Kind(
        "hard iron of the Earth's strength, soft iron to 25 %",
        (turn, hand),
        offset=(200.0, 450.0),
        gain=0.25,
        cross=0.12,
    ),
    "motor": Kind("a drive with a strong motor field, to 60 mG", (drive,), motor=(1.5, 3.0), course=True),
    "noise": Kind("noise of 8 to 20 mG at each reading", (turn, drive), noise=(8.0, 20.0)),
    "disturbed": Kind("magnets pass, or steel stands beside a stop", (turn, drive), disturbed=True),
    "mounted": Kind("compass turned by right angles, course known", (drive,), turned=True, course=True),
    "clipped": Kind(
        "8 to 30 % of readings at the sensor's end", (turn, hand), clipped=True, answerable=False
    ),
    "little": Kind("10 to 40 degrees of turning in all", (little,), answerable=False),
    "repeats": Kind(
        "late averages, repeated, cut to whole numbers, some lost", (turn, drive), repeated=True, rate_hz=25.0
    ),
}
HEADING = {
    "level": Kind("turning on the level", (turn,)),
    "lean": Kind("stops that lean by up to 30 degrees", (leaning,)),
    "drive": Kind("a rover's drive", (drive,), course=True),
    "flight": Kind("a multirotor's flight", (flight,), course=True),
    "magnets": Kind("a drive past magnets", (drive,), disturbed=True, course=True),
}
KINDS |= {f"heading {name}": replace(kind, task="heading", count=25) for name, kind in HEADING.items()}
# What is wrong with the flight but not with the baseline, and the names under which it is as right.
EFFECTS = {
    "none": (),
    "hard_iron": ("hard_iron",),
    "soft_iron": ("soft_iron", "axis_scale", "cross_axis", "non_orthogonality"),
    "motor_current": ("motor_current",),
    "hard_iron_step": ("hard_iron_step", "relay_field"),
    "noise_excess": ("noise_excess", "ac_interference"),
    "transport_lag": ("transport_lag", "low_pass", "stale_samples"),
}
KINDS |= {
    f"gap {name}": Kind(name, (drive, flight), (1e-3, 2e-3), 0.0, 0.0, course=True, task="gap", count=15)
    for name in EFFECTS
}


KINDS |= {
    "real broad": Kind("turned by hand, optical reference (BROAD)", (), count=3),
    "real firmware": Kind("four turns flown by ArduPilot 4.6.3 in its simulator", (), count=4),
}


@dataclass(frozen=True)
class Vehicle:
    """Hold what a vehicle brings along on every way it goes."""

    gain: F
    offset: F
    motor: F
    noise: float
    lag: float


def case_of(kind: str, index: int) -> Case:
    """Make one case, or read one; the same at every call."""
    made = KINDS[kind]
    if not made.motions:
        from compassbench import recordings

        return recordings.case_of(kind, index)
    rng = np.random.default_rng([SEED, *kind.encode(), index])
    gain, offset = _iron(made, rng)
    motor = rng.normal(0.0, 1.0, 3)
    motor *= rng.uniform(*made.motor) / np.linalg.norm(motor)
    noise, lag = math.exp(rng.uniform(*np.log(made.noise))), 0.09 if made.repeated else rng.normal(0.0, 0.02)
    vehicle = Vehicle(gain, offset, motor, noise, abs(lag))
    earth = np.array(PLACES[index % len(PLACES)][1]) + rng.normal(0.0, WMM_SIGMA)
    case = _reported(kind, index, vehicle, earth, rng)
    if made.task == "heading":
        cure = np.linalg.inv(gain)
        return replace(case, given=(-offset + rng.normal(0.0, 1.5, 3), cure))
    if made.task == "gap":
        return replace(
            _reported(kind, index, *_gone_wrong(made.about, vehicle, rng), earth, rng), baseline=case
        )
    return case


def _gone_wrong(effect: str, vehicle: Vehicle, rng: RNG) -> tuple[Vehicle]:
    """Put one effect on a vehicle, of a size that bends headings by some degrees."""
    by = rng.normal(0.0, 1.0, 3)
    by /= np.linalg.norm(by)
    if effect in ("hard_iron", "hard_iron_step"):
        vehicle = replace(vehicle, offset=by * rng.uniform(15.0, 60.0))
    elif effect == "soft_iron":
        bent = rng.uniform(-0.1, 0.1, (3, 3))
        vehicle = replace(vehicle, gain=np.eye(3) + 0.5 * (bent + bent.T))
    elif effect == "motor_current":
        vehicle = replace(vehicle, motor=by * rng.uniform(1.0, 3.0))
    elif effect == "noise_excess":
        vehicle = replace(vehicle, noise=vehicle.noise * rng.uniform(3.0, 6.0))
    elif effect == "transport_lag":
        vehicle = replace(vehicle, lag=rng.uniform(0.15, 0.4))
    return (vehicle,)


def _reported(kind: str, index: int, vehicle: Vehicle, earth: F, rng: RNG) -> Case:
    """Let a vehicle go its way and report it."""
    made = KINDS[kind]
    way = made.motions[index % len(made.motions)]
    motion = way(rng)
    count = len(motion.euler)
    time = np.arange(count) * STEP_S
    place, world = PLACES[index % len(PLACES)]
    loaded = bool(made.motor[1]) or made.task == "gap"
    current = np.round(AMPERES * motion.effort, 2) if loaded else None
    body_from_world = np.swapaxes(matrices(motion.euler), 1, 2)
    bent = (body_from_world @ earth) @ vehicle.gain.T
    if current is not None:
        bent += current[:, np.newaxis] * vehicle.motor
    begun = time[:, np.newaxis] > (
        time[-1] * rng.uniform(0.3, 0.7) if made.about == "hard_iron_step" else -1.0
    )
    raw = bent + vehicle.offset * begun
    if made.disturbed:
        raw += _disturbance(motion, time, rng)
    # An autopilot flies by a calibration, if a poor one: half of the offset is known to it.
    attitude = _attitude(motion, bent + 0.5 * vehicle.offset, earth, rng)
    mag_time, mag = _readings(made, vehicle, time, raw, rng)
    acc, gyro = _inertial(motion, body_from_world, rng)
    loads = (0.0,) if current is None else tuple(float(load) for load in np.percentile(current, (10, 50, 90)))
    euler = columns(mag_time - vehicle.lag, time, np.unwrap(motion.euler, axis=0))
    course = motion.velocity[:, :2] + rng.normal(0.0, 0.1, (count, 2))
    return Case(
        kind=kind,
        index=index,
        time=np.round(time, 4),
        acc=np.round(acc, 3),
        gyro=np.round(gyro, 5),
        attitude=np.round(attitude, 5),
        mag_time=np.round(mag_time, 4),
        mag=mag,
        place=place,
        world=np.array(world),
        truth=Truth(vehicle.gain, vehicle.offset, vehicle.motor, earth, euler, loads),
        vehicle="copter" if way in (flight, hand) else "rover",
        autopilot="ardupilot" if made.repeated else "px4",
        current=current,
        course=np.round(course, 2) if made.course else None,
        answerable=made.answerable,
    )


def _iron(made: Kind, rng: RNG) -> tuple[F, F]:
    gain = np.diag(1.0 + rng.uniform(-made.gain, made.gain, 3))
    for row, column in ((0, 1), (0, 2), (1, 2)):
        gain[row, column] = gain[column, row] = rng.uniform(-made.cross, made.cross)
    offset = rng.normal(0.0, 1.0, 3)
    offset *= math.exp(rng.uniform(*np.log(made.offset))) / np.linalg.norm(offset)
    if made.turned:
        turned = np.array(list(ROTATIONS.values())[int(rng.integers(len(ROTATIONS)))], dtype=float)
        gain, offset = turned @ gain, turned @ offset
    return gain, offset


def _disturbance(motion: Motion, time: F, rng: RNG) -> F:
    """Return the field of magnets that pass, or of steel beside one stop, (N, 3)."""
    added = np.zeros((time.size, 3))
    if motion.velocity.any():
        for _ in range(int(time[-1] / 20.0)):
            shape = np.exp(-0.5 * ((time - rng.uniform(0.0, time[-1])) / rng.uniform(0.5, 1.5)) ** 2)
            added += shape[:, np.newaxis] * rng.normal(0.0, 1.0, 3) * rng.uniform(30.0, 120.0)
        return added
    yaw = motion.euler[:, 2]
    near = np.exp(-0.5 * ((yaw - rng.uniform(yaw.min(), yaw.max())) / math.radians(20.0)) ** 2)
    return added + near[:, np.newaxis] * rng.normal(0.0, 1.0, 3) * rng.uniform(20.0, 60.0)


def _attitude(motion: Motion, steered: F, earth: F, rng: RNG) -> F:
    """Return what the autopilot's filter shows: roll and pitch a little off, its yaw by the compass."""
    euler = np.unwrap(motion.euler, axis=0)
    off = [wander(rng, len(euler), math.radians(0.3), 8.0) for _ in range(2)]
    tilt = matrices(np.stack([euler[:, 0], euler[:, 1], np.zeros(len(euler))], axis=1))
    level = np.einsum("nij,nj->ni", tilt, steered)
    shown = math.atan2(earth[1], earth[0]) - np.arctan2(level[:, 1], level[:, 0])
    error = np.angle(np.exp(1j * (shown - euler[:, 2])))
    held, share = np.empty(error.size), STEP_S / 5.0
    now = float(error[0])
    for k, one in enumerate(error.tolist()):
        now += share * math.remainder(one - now, 2.0 * math.pi)
        held[k] = now
    roll, pitch, yaw = euler[:, 0] + off[0], euler[:, 1] + off[1], euler[:, 2] + held
    return np.stack([roll, pitch, np.angle(np.exp(1j * yaw))], axis=1)


def _readings(made: Kind, vehicle: Vehicle, time: F, raw: F, rng: RNG) -> tuple[F, F]:
    """Return the compass's times and what it reports then."""
    at = np.arange(0.0, time[-1], 1.0 / made.rate_hz)
    if made.repeated:
        fresh = np.floor(at / 0.1 + 1e-9).astype(int)
        blocks = np.arange(fresh[-1] + 1) * 0.1
        mean = np.mean([columns(blocks - late, time, raw) for late in np.arange(0.0, 0.1, 0.02)], axis=0)
        mean += rng.normal(0.0, vehicle.noise, mean.shape)
        mag = np.trunc(mean[fresh])
        kept = rng.random(at.size) > 0.05
        at, mag = at[kept], mag[kept]
        twice = np.sort(np.concatenate([np.arange(at.size), rng.integers(0, at.size, at.size // 20)]))
        return at[twice], mag[twice]
    mag = columns(at - vehicle.lag, time, raw) + rng.normal(0.0, vehicle.noise, (at.size, 3))
    if made.clipped:
        end = np.quantile(np.abs(mag).max(axis=1), 1.0 - rng.uniform(0.08, 0.3))
        mag = np.clip(mag, -end, end)
    return at, np.round(mag, 2)


def _inertial(motion: Motion, body_from_world: F, rng: RNG) -> tuple[F, F]:
    """Return the specific force and the rates that the sensors report."""
    count = len(motion.euler)
    force = np.einsum("nij,nj->ni", body_from_world, motion.acceleration - [0.0, 0.0, GRAVITY])
    force += rng.normal(0.0, 0.02, 3) + rng.normal(0.0, 0.1, (count, 3))
    step = body_from_world[:-1] @ np.swapaxes(body_from_world[1:], 1, 2)
    rate = np.stack([step[:, 2, 1], step[:, 0, 2], step[:, 1, 0]], axis=1) / STEP_S
    rate = np.concatenate([rate, rate[-1:]])
    bias = rng.normal(0.0, math.radians(0.1), 3)
    gyro = rate * (1.0 + rng.normal(0.0, 0.005, 3)) + bias + rng.normal(0.0, math.radians(0.2), (count, 3))
    return force, gyro


def seal(kind: str, count: int | None = None) -> str:
    """Return the hash of what cases of a kind report, and of what is true of them; None for all."""
    whole = hashlib.sha256()
    for index in range(KINDS[kind].count if count is None else count):
        case = case_of(kind, index)
        for one in (case, case.baseline):
            if one is None:
                continue
            truth = one.truth
            for part in (
                *(one.time, one.acc, one.gyro, one.attitude, one.mag_time, one.mag, one.current, one.course),
                *(truth.gain, truth.offset, truth.motor, truth.field, *(one.given or ())),
            ):
                if part is not None:
                    whole.update(np.ascontiguousarray(np.round(part * 1e5).astype(np.int64)))
    return whole.hexdigest()
