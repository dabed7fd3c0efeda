"""The rows of a compass that a replay compares: raw, not repeated, not too many, and when they were taken.

A message has the last reading, which is then as old as chance has it, up to the time between two messages. In
a turn each hundredth of a second counts. Where the messages come more often than the readings, those that
bring a new one lie within one step after the ticks of the clock, and so tell the clock.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from mavcompass.correction import IDENTITY
from mavcompass.errors import BadRecording
from mavcompass.frames import FloatArray
from mavcompass.gap.attitude.kinematics import averaged
from mavcompass.gap.replay.integrity import Trace, coarse_step, inspect
from mavcompass.gap.tables import usual
from mavcompass.simulation.effects.causes.timing import LONGEST_LAG_S
from mavcompass.simulation.effects.sampling import at_times
from mavcompass.track import MagSeries, Track

_BIN_S = 1e-3
_ROUNDS, _STEPS = 4, 8


def reading_times(time_s: FloatArray, message_s: float, after_loss: NDArray[np.bool_]) -> FloatArray:
    """Return when new readings (N,) that messages brought at some times were taken, but for a common age.

    `message_s` is the time between messages. What follows no even clock stays as it is, and so does what came
    `after_loss` (N,): it may be older than the others, and where messages are lost no attitude is known.
    """
    pieces = max(math.ceil(float(time_s[-1] - time_s[0]) / usual.clock.piece_s), 1)
    edges = np.searchsorted(time_s, np.linspace(time_s[0], time_s[-1], pieces + 1)[1:-1])
    read = np.concatenate([_on_the_clock(piece, message_s) for piece in np.split(time_s, edges)])
    # The first message has a reading that is older, too.
    twice = np.append(np.diff(read) < 0.5 * np.diff(time_s), False)
    read = np.where(twice | after_loss, time_s, read)
    return read if bool((np.diff(read) > 0.0).all()) else time_s


def _on_the_clock(time_s: FloatArray, message_s: float) -> FloatArray:
    if time_s.size < usual.clock.fewest:
        return time_s
    # Of some steps in a row the quicker ones: where none was lost.
    mean = float(np.quantile(time_s[usual.clock.row :] - time_s[: -usual.clock.row], 0.1)) / usual.clock.row
    since = time_s - time_s[0]
    length = int(2 ** math.ceil(math.log2(2.0 * since[-1] / _BIN_S)))
    ticks = np.bincount(np.round(since / _BIN_S).astype(np.int64), minlength=length)
    hertz = np.fft.rfftfreq(length, _BIN_S)
    near = np.abs(hertz * mean - 1.0) < usual.clock.near
    if not near.any():
        return time_s
    best = float(hertz[near][int(np.argmax(np.abs(np.fft.rfft(ticks))[near]))])
    mirrored = 1.0 / message_s - best
    if abs(mirrored * mean - 1.0) < usual.clock.near:
        # Of messages twice as often as readings the mirror image is as sharp: which one goes on as they do?
        steps = np.diff(time_s)
        on = float(np.mean(steps[steps < 1.8 * np.median(steps)]))
        best = min(best, mirrored, key=lambda f: abs(f * on - 1.0))
    beside = 1.0 / since[-1]
    for _ in range(_ROUNDS):
        tried = best + beside * np.linspace(-1.0, 1.0, 2 * _STEPS + 1)
        best = float(tried[int(np.argmax(np.abs(np.exp(2j * np.pi * np.outer(tried, since)).sum(axis=1))))])
        beside /= _STEPS
    # New readings come within a step of the messages after a tick: the rest of the time between two is empty.
    phase = np.sort((since * best) % 1.0)
    kept = math.ceil(usual.clock.within * phase.size) - 1
    width = np.append(phase, phase + 1.0)[kept : kept + phase.size] - phase
    first = int(np.argmin(width))
    if message_s * best > usual.clock.oftener or width[first] > message_s * best + usual.clock.beyond:
        return time_s
    # In the middle of what is empty one tick ends and the next one begins.
    age = (since * best - phase[first] + 0.5 * (1.0 - width[first])) % 1.0
    return np.asarray(time_s - (age - age.mean()) / best)


# How late readings may be when their means are made, in seconds.
_LATE_S = np.arange(0.0, LONGEST_LAG_S, 0.02)


@dataclass(frozen=True, slots=True, eq=False)
class Rows:
    """Hold the compared readings of one compass.

    Attributes:
        time_s: (N,), repeats left out; index: which readings of the compass they are, (N,).
        raw_mgauss: (N, 3), the calibration in force undone.
        corrected_mgauss: (N, 3), with it; None where none is in force, or it is not known.
        telemetry: True where an autopilot repeats readings and sends them late by nature.
        width: how many neighbours are to be averaged to one, an odd number.
        trace: repeats and steps of the numbers as they were logged; usable: rows that are no lost readings,
        (N,).
    """

    time_s: FloatArray
    index: NDArray[np.int64]
    raw_mgauss: FloatArray
    corrected_mgauss: FloatArray | None
    telemetry: bool
    width: int
    trace: Trace
    usable: NDArray[np.bool_]


def compass_rows(
    track: Track, compass: MagSeries, period_s: float = 0.0, most_averaged: int | None = None
) -> Rows:
    """Choose the rows of a compass, averaged to `period_s` where they come faster, of so many at most.

    Raises BadRecording where there are too few.
    """
    sent_s, keep = np.unique(compass.time_s, return_index=True)
    message_s = float(np.median(np.diff(sent_s))) if sent_s.size > 1 else 0.0
    time_s = sent_s
    reported = compass.reported.values[keep]
    logged = inspect(reported, np.asarray(np.isfinite(reported).all(axis=1)), time_s, track.gyro_radps)
    telemetry = track.autopilot != "unknown" or _slower_than_logged(~logged.stale)
    restored = replace(track, compasses={compass.instance: compass}).centred(compass.instance)
    raw = restored.raw_field(compass.instance)[keep]
    if telemetry:
        step = coarse_step(raw, np.asarray(np.isfinite(raw).all(axis=1)))
        logged = replace(logged, step_mgauss=max(step, logged.step_mgauss))
        if step == 0.0:
            # A reading that is sent again says nothing new; one that is frozen for longer is a finding of its
            # own. Coarse numbers repeat by chance.
            fresh = ~logged.stale
            if fresh.sum() < usual.rows.fewest_new and fresh.size >= usual.rows.fewest and logged.frozen:
                # What says one thing as long as it is asked is frozen: that is the finding.
                fresh = np.ones_like(fresh)
            keep, raw = keep[fresh], raw[fresh]
        time_s = compass.time_s[keep]
        if step == 0.0 and fresh.sum() < usual.messages.brought_new * fresh.size:
            lost = np.diff(compass.time_s, prepend=compass.time_s[0]) > usual.messages.lost * message_s
            time_s = reading_times(time_s, message_s, lost[keep])
    inside = any(step.correction != IDENTITY for step in compass.in_force)
    calibrated = compass.correction_known and (compass.not_applied is not None or inside)
    corrected = restored.corrected_field(compass.instance)[keep] if calibrated else None
    finite = np.asarray(np.isfinite(raw).all(axis=1))
    usable = finite
    trace = logged if telemetry else inspect(raw, finite, time_s)
    fine = trace.step_mgauss == 0.0 and compass.quantum_mgauss == 0.0
    if not telemetry and trace.stale_share > 0.0 and fine:
        usable = np.asarray(finite & ~trace.stale)
    # A sensor that stays brings little that is new, which is a finding and no lack of readings.
    few = int(usable.sum())
    if few < (usual.rows.fewest_new if reported.shape[0] >= usual.rows.fewest else usual.rows.fewest):
        raise BadRecording(
            f"{track.source or 'The recording'} has {few} readings of compass {compass.instance}, too few.",
            _more_readings(track, few),
        )
    width = _odd_width(time_s, period_s)
    if most_averaged is not None:
        width = min(width, most_averaged)
    return Rows(time_s, keep, raw, corrected, telemetry, width, trace, usable)


def _more_readings(track: Track, few: int) -> str:
    """Say what would have more readings."""
    most, instance = max((len(compass.reported), i) for i, compass in track.compasses.items())
    if most > max(few, usual.rows.fewest):
        return f"Compass {instance} has {most}: choose it with --compass {instance}, or record for longer."
    return "Record at least half a minute of turning."


def shared_period_s(tracks: Sequence[Track], instance: int) -> float:
    """Return the time between rows, in seconds, that keeps each of some recordings within what is compared.

    A recording and its baseline are averaged alike: noise and its correlation are then the same in both.
    """
    recorded = [
        (track.compasses[instance].time_s, track.reference_q is not None)
        for track in tracks
        if instance in track.compasses and len(track.compasses[instance].reported) > 1
    ]
    needed_s = max(
        (_period_s(t, usual.rows.most if lab else usual.rows.most_in_flight) for t, lab in recorded),
        default=0.0,
    )
    if any(lab for _, lab in recorded):
        return needed_s
    enough_s = max((_period_s(time_s, usual.rows.enough) for time_s, _ in recorded), default=0.0)
    enough_s = max(needed_s, min(enough_s, usual.rows.longest_s))
    kept = min((time_s.size / _odd_width(time_s, enough_s) for time_s, _ in recorded), default=0.0)
    return enough_s if kept >= usual.rows.kept else needed_s


def _period_s(time_s: FloatArray, most: int) -> float:
    """Return the time between so many rows at most; 0 where there are no more."""
    return float(time_s[-1] - time_s[0]) / most if time_s.size > most else 0.0


def _odd_width(time_s: FloatArray, period_s: float) -> int:
    """Return how many neighbours are averaged to rows of a period: an odd number."""
    step = float(np.median(np.diff(time_s)))
    width = max(math.ceil(period_s / max(step, 1e-6) - 0.2), 1)
    return width if width % 2 else width + 1


def middles(count: int, width: int) -> slice:
    """Return the middles of averages over an odd number of neighbours."""
    return slice(None) if width == 1 else slice(width // 2, count - width // 2, width)


def unbroken(time_s: FloatArray, width: int) -> NDArray[np.bool_]:
    """Tell which averages over an odd number of neighbours, at their middles, are not over a silence.

    Meanwhile the field turns far more than between neighbours, which alone show how readings follow it.
    """
    steps = np.diff(time_s)
    broken = steps > usual.messages.silence * float(np.median(steps))
    count = np.concatenate([[0, 0], np.cumsum(broken)])
    half, at = width // 2, np.arange(time_s.size)[middles(time_s.size, width)]
    return np.asarray(count[at + half + 1] == count[at - half + 1])


def swing(
    time_s: FloatArray,
    raw_mgauss: FloatArray,
    upright_mgauss: FloatArray,
    slopes_mgauss_per_s: FloatArray,
    usable: NDArray[np.bool_],
    width: int,
) -> tuple[FloatArray, float]:
    """Return how far readings (N, 3) stand off the mean of their neighbours because the field turns, in mG,
    and how late they are, in seconds.

    Readings follow the field that an upright compass would see, (N, 3) with its slopes, by some matrix: that
    of the calibration, of another iron, of a compass that was turned. The `usable` ones tell which, and how
    late each axis is, by how they swing themselves. With it, a mean of readings is a reading of its middle.
    """
    swings = raw_mgauss - averaged(raw_mgauss, width)
    usable = usable & np.isfinite(swings).all(axis=1) & np.isfinite(upright_mgauss).all(axis=1)
    # What was before the first reading, and in a silence, is not known.
    steps = np.diff(time_s, prepend=-np.inf)
    silent = steps > max(LONGEST_LAG_S, usual.messages.silence * float(np.median(steps)))
    begins = time_s[np.maximum.accumulate(np.where(silent, np.arange(time_s.size), 0))]
    usable &= time_s - begins >= LONGEST_LAG_S
    least = max(usable.sum(), 1) * usual.rows.least_swing_mgauss**2 * np.eye(3)
    found, likeliest = np.zeros_like(raw_mgauss), np.full(3, np.inf)
    together, late_s = math.inf, 0.0
    for tried_s in _LATE_S.tolist():
        late = at_times(time_s, upright_mgauss, time_s - tried_s, slopes_mgauss_per_s)
        turns = late - averaged(late, width)
        some = turns[usable]
        follows = np.linalg.solve(some.T @ some + least, some.T @ swings[usable])
        left = np.sum((swings[usable] - some @ follows) ** 2, axis=0)
        unlikely = usable.sum() * np.log(np.maximum(left, 1e-12))
        unlikely += ((tried_s - usual.age.usual_s) / usual.age.sigma_s) ** 2 / 3.0
        # An eddy current makes each axis late by its own time.
        better = unlikely < likeliest
        found[:, better], likeliest[better] = (turns @ follows)[:, better], unlikely[better]
        if unlikely.sum() < together:
            together, late_s = float(unlikely.sum()), tried_s
    return found, late_s


def _slower_than_logged(is_fresh: NDArray[np.bool_]) -> bool:
    """Tell a compass that is read more slowly than it is logged: repeats in an even rhythm.

    Readings that are lost by chance repeat in runs of all lengths.
    """
    fresh = np.flatnonzero(is_fresh)
    if fresh.size < usual.rows.fewest or fresh.size > (1.0 - usual.messages.slower_share) * is_fresh.size:
        return False
    gaps = np.diff(fresh)
    return float(gaps.std()) < usual.messages.even_rhythm * float(gaps.mean())
