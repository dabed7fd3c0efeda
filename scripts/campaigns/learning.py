"""Does a service that learns while the vehicle works offer in time, and never wrongly? Hours of driving.

    python scripts/campaigns/learning.py [--hours 200] [--seed 7] [--off 20] [--kind magnets]

Every hour is another vehicle that drives about: legs of 4 to 25 s at 1 to 3 m/s, bends of 20 to 150 degrees,
10 to 40 deg/s, now and then a stop of up to a minute, uneven ground. Compass 10 times a second with 3 mG of
noise, gyro and accelerometer 25 times a second; the accelerometer feels the bends and the braking; the
estimator's roll and pitch wander by 0.3 degrees. A magnet passes once a minute (30 to 120 mG for some
seconds). The calibration in force is `--off` degrees off, rms over the circle. Kinds: magnets; moved (and
something aboard is moved, by 20 to 80 mG, once in the hour); parked (and a stop beside steel of 20 to
60 mG); motors (and 0 to 20 A at 0.5 mG/A).

The numerical core is asked as the service asks it: every minute in the first ten and after each offer,
then every five. An offer is wrong if taking it would leave more than 1 degree, or not lower the error by the
margin. Every offer is taken, so that the rest of the hour tries a compass that is right.
"""

from __future__ import annotations

import math
import sys
from collections.abc import Iterator
from dataclasses import dataclass, field, replace

import numpy as np
from campaign import ended, options
from made_up import EARTH, SCENARIOS, Iron, body_field, errors_deg, rocking, vehicle_of

from mavcompass.calibration.methods.running import WINDOW_S, calibrate
from mavcompass.calibration.recorded import Recorded
from mavcompass.calibration.result import Limits
from mavcompass.correction import FieldCorrection
from mavcompass.errors import PoorCalibration
from mavcompass.frames import FloatArray
from mavcompass.track import MagSeries, Series, Track
from mavcompass.units import STANDARD_GRAVITY_MPS2

STEP_S, EVERY = 0.04, 2.5
HOUR_S, SOON_S, LATER_S, EAGER_S = 3600.0, 60.0, 300.0, 600.0
# The service's margin_deg and limit_deg; and what an offer may leave.
MARGIN_DEG, SURE_DEG, LIMIT_DEG = 2.0, 0.5, 1.0
SOON_ENOUGH_S = 300.0
KINDS = ("magnets", "moved", "parked", "motors")
BASE = SCENARIOS["wrong steps"]


@dataclass(slots=True)
class Tally:
    """Count what became of the hours."""

    hours: int = 0
    asked: int = 0
    offered_s: list[float] = field(default_factory=list)
    left_deg: list[float] = field(default_factory=list)
    wrong: list[str] = field(default_factory=list)
    never: int = 0


def way(rng: np.random.Generator, length_s: float) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return yaw rate, speed and the ground's tilt (roll, pitch) of a drive, at every step."""
    rate, speed, tilt = [], [], []
    passed = 0.0
    while passed < length_s:
        pace = rng.uniform(1.0, 3.0)
        if rng.random() < 0.05:
            parts = [(rng.uniform(5.0, 60.0), 0.0, 0.0)]
        else:
            turn, at = math.radians(rng.uniform(20.0, 150.0)), math.radians(rng.uniform(10.0, 40.0))
            parts = [
                (rng.uniform(4.0, 25.0), 0.0, pace),
                (turn / at, float(rng.choice([-1.0, 1.0])) * at, pace),
            ]
        for lasts, turning, going in parts:
            count = max(int(lasts / STEP_S), 1)
            rate.append(np.full(count, turning))
            speed.append(np.full(count, going))
            tilt.append(np.tile(np.radians(rng.normal(0.0, 1.5, 2)), (count, 1)))
            passed += count * STEP_S
    smooth = np.ones(13) / 13.0

    def rounded(values: FloatArray) -> FloatArray:
        return np.convolve(np.pad(values, 6, mode="edge"), smooth, mode="valid")

    leaning = np.concatenate(tilt)
    columns = [rounded(np.concatenate(rate)), rounded(np.concatenate(speed))]
    return columns[0], columns[1], np.stack([rounded(leaning[:, 0]), rounded(leaning[:, 1])], axis=1)


def wander(rng: np.random.Generator, time: FloatArray, sigma: float, knots_s: float) -> FloatArray:
    """Return something that wanders about zero with a standard deviation, a new value every `knots_s`."""
    knots = np.arange(0.0, time[-1] + 2.0 * knots_s, knots_s)
    return np.interp(time, knots, rng.normal(0.0, sigma, knots.size))


def magnets(rng: np.random.Generator, time: FloatArray) -> FloatArray:
    """Return the field of magnets that pass, one a minute, (N, 3)."""
    added = np.zeros((time.size, 3))
    for minute in range(int(time[-1] / 60.0)):
        middle, width = 60.0 * minute + rng.uniform(0.0, 60.0), rng.uniform(0.5, 2.5)
        near = np.abs(time - middle) < 5.0 * width
        shape = np.exp(-0.5 * ((time[near] - middle) / width) ** 2)
        added[near] += shape[:, np.newaxis] * rng.normal(0.0, 1.0, 3) * rng.uniform(30.0, 120.0)
    return added


def scaled_to(truth: Iron, off_deg: float) -> Iron:
    """Scale what is wrong with a compass until no correction at all leaves `off_deg`, rms over the circle."""
    low, high = 0.0, 4.0
    for _ in range(40):
        share = 0.5 * (low + high)
        trial = Iron(share * truth.offset, np.eye(3) + share * (truth.gain - np.eye(3)))
        size = math.sqrt(float((errors_deg(FieldCorrection(), trial) ** 2).mean()))
        low, high = (share, high) if size < off_deg else (low, share)
    return trial


def hour(rng: np.random.Generator, off_deg: float, kind: str) -> tuple[Track, list[tuple[float, Iron]]]:
    """Make an hour of one vehicle: its recording, and what is true of its compass from which time on."""
    truth = scaled_to(vehicle_of(BASE, rng), off_deg)
    rate, speed, tilt = way(rng, HOUR_S)
    time = np.arange(rate.size) * STEP_S
    yaw = rng.uniform(0.0, 2.0 * math.pi) + np.cumsum(rate) * STEP_S
    roll, pitch = tilt.T
    raw = truth.raw(body_field(yaw, roll, pitch, EARTH)) + magnets(rng, time)
    truths, current = [(0.0, truth)], None
    if kind == "moved":
        at, by = rng.uniform(900.0, 2700.0), rng.normal(0.0, 1.0, 3)
        by *= rng.uniform(20.0, 80.0) / np.linalg.norm(by)
        raw[time >= at] += by
        truths.append((at, Iron(truth.offset + by, truth.gain)))
    elif kind == "parked":
        stop = rng.uniform(60.0, HOUR_S - 120.0)
        beside = (time > stop) & (time < stop + rng.uniform(20.0, 90.0))
        raw[beside] += rng.normal(0.0, 1.0, 3) * rng.uniform(20.0, 60.0)
    elif kind == "motors":
        load = np.clip(4.0 * np.abs(speed) + wander(rng, time, 4.0, 3.0), 0.0, 20.0)
        raw += load[:, np.newaxis] * rng.normal(0.0, 0.5, 3)
        current = Series.of(time, load)
    heard = np.unique((np.arange(0.0, time.size, EVERY)).astype(int))
    readings = raw[heard] + rng.normal(0.0, 3.0, (heard.size, 3))
    force = np.stack(
        [
            np.gradient(speed, STEP_S) + STANDARD_GRAVITY_MPS2 * np.sin(pitch),
            speed * rate - STANDARD_GRAVITY_MPS2 * np.cos(pitch) * np.sin(roll),
            -STANDARD_GRAVITY_MPS2 * np.cos(pitch) * np.cos(roll),
        ],
        axis=1,
    )
    rolls, pitches = np.gradient(roll, STEP_S), np.gradient(pitch, STEP_S)
    turned = [
        rolls - rate * np.sin(pitch),
        pitches * np.cos(roll) + rate * np.cos(pitch) * np.sin(roll),
        rate * np.cos(pitch) * np.cos(roll) - pitches * np.sin(roll),
    ]
    late = time + rng.normal(0.0, 0.03)
    gyro = np.stack([np.interp(late, time, axis) for axis in turned], axis=1)
    gyro *= 1.0 + rng.normal(0.0, 0.01)
    gyro[:, 2] += math.radians(rng.normal(0.0, 0.02)) + wander(rng, time, math.radians(0.01), 60.0)
    gyro += rng.normal(0.0, math.radians(0.3), gyro.shape)
    estimated = [
        angle + wander(rng, time, math.radians(0.3), 5.0) + rocking(time.size, math.radians(0.02), rng)
        for angle in (roll, pitch)
    ]
    return Track(
        source="made up",
        autopilot="px4",
        vehicle="rover",
        compasses={1: MagSeries(1, Series.of(time[heard], readings))},
        acc_mps2=Series.of(time, force + rng.normal(0.0, 0.3, force.shape)),
        gyro_radps=Series.of(time, gyro),
        attitude_rad=Series.of(time[::3], np.stack([*estimated, yaw], axis=1)[::3]),
        current_a=current,
    ), truths


def asked_at(rest: list[float]) -> Iterator[float]:
    """Return when the core is asked: every minute for ten minutes since the last offer, then every five."""
    now_s = SOON_S
    while now_s <= HOUR_S:
        yield now_s
        now_s += SOON_S if now_s - rest[-1] < EAGER_S else LATER_S


def drive(rng: np.random.Generator, off_deg: float, kind: str, tally: Tally) -> None:
    """Drive one hour and take every offer."""
    track, truths = hour(rng, off_deg, kind)
    force, since = FieldCorrection(), [0.0]
    offered = False
    for now_s in asked_at(since):
        tally.asked += 1
        part = track.between(max(now_s - WINDOW_S, 0.0), now_s)
        # Readings stay raw here; what is in force is told beside them.
        compass = replace(part.compasses[1], not_applied=force)
        part = replace(part, compasses={1: compass})
        try:
            result = calibrate(Recorded(part, 1, EARTH, Limits(SURE_DEG, by_motion=True)))
        except PoorCalibration:
            continue
        if result.sure_gain_deg < MARGIN_DEG:
            continue
        truth = [one for at, one in truths if at <= now_s][-1]
        old, new = (rms_deg(correction, truth) for correction in (force, result.correction))
        if not offered and off_deg > MARGIN_DEG:
            tally.offered_s.append(now_s)
            tally.left_deg.append(new)
        offered = True
        if new > LIMIT_DEG or old - new < MARGIN_DEG:
            words = f"{kind} at {now_s:.0f} s: {old:.2f} -> {new:.2f}, claimed {result.heading_sigma_deg:.2f}"
            tally.wrong.append(words)
        force = result.correction
        since.append(now_s)
    tally.hours += 1
    tally.never += not offered


def rms_deg(correction: FieldCorrection, truth: Iron) -> float:
    """Return a correction's heading error, rms over the circle, at no load."""
    at_rest = replace(correction, motor_mgauss=(0.0, 0.0, 0.0), motor_source="none")
    return math.sqrt(float((errors_deg(at_rest, truth) ** 2).mean()))


def words(kind: str, off_deg: float, tally: Tally) -> str:
    """Say what became of the hours."""
    said = f"{kind}, {off_deg:g} deg off: {tally.hours} hours, asked {tally.asked} times"
    if tally.offered_s:
        soon = 100.0 * np.mean(np.array(tally.offered_s) <= SOON_ENOUGH_S)
        said += (
            f"; first offer after {np.median(tally.offered_s):.0f} s (median), {max(tally.offered_s):.0f} s"
        )
        said += f" (the last), {soon:.0f} % within {SOON_ENOUGH_S / 60:.0f} minutes"
        said += f", leaving {np.median(tally.left_deg):.2f} deg, the worst {max(tally.left_deg):.2f}"
    return f"{said}; no offer in {tally.never}; wrong offers: {len(tally.wrong)}"


def main() -> int:
    """Print the figures, and those so far on standard error."""
    wanted = options(__doc__, hours=50, seed=7, off=20.0, kind=["magnets", *KINDS[1:], "all"])
    tallies = {}
    for kind in KINDS if wanted.kind == "all" else (wanted.kind,):
        tally, rng = Tally(), np.random.default_rng(wanted.seed)
        for done in range(1, wanted.hours + 1):
            drive(rng, wanted.off, kind, tally)
            if done % 10 == 0 and done < wanted.hours:
                print(words(kind, wanted.off, tally), file=sys.stderr, flush=True)
        print(words(kind, wanted.off, tally), flush=True)
        for one in tally.wrong:
            print("   ", one)
        tallies[kind] = tally
    return ended(wanted.json, tallies, any(tally.wrong for tally in tallies.values()))


if __name__ == "__main__":
    raise SystemExit(main())
