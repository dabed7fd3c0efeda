"""All that single readings tell, together: repeats, steps of the numbers, what changes with each, scatter."""

from __future__ import annotations

import math
from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np

from mavcompass.frames import FloatArray
from mavcompass.gap.detectors.rapid import Rapid, burst_mgauss, excess_variance, find_rapid
from mavcompass.gap.replay.nominal import Replay
from mavcompass.gap.result import Cause
from mavcompass.gap.tables import usual
from mavcompass.simulation.effects import Effect, detected_by


def names_stale(replay: Replay, baseline: Replay | None) -> bool:
    """Tell whether the repeats are an effect: more than by chance, than the baseline's, than telemetry's."""
    if replay.telemetry:
        return stale_share(replay, baseline) > usual.repeats.worth_naming
    found, nominal = replay.trace, baseline.trace if baseline is not None else None
    expected = nominal.stale_share if nominal is not None else 0.0
    coarse = found.step_mgauss > 0.0 or replay.resolution_mgauss > 0.0
    if coarse and (baseline is None or _steps_of(replay) != _steps_of(baseline)):
        # Coarse numbers repeat by chance, and no baseline tells how often.
        return False
    count = found.stale.size
    noise = math.sqrt(max(expected * (1.0 - expected), 1.0 / count) / count)
    return found.stale_share > max(usual.repeats.worth_naming, expected + 5.0 * noise)


def stale_share(replay: Replay, baseline: Replay | None) -> float:
    """Return the share of readings that only repeat the one before, beyond what telemetry does by nature."""
    if not replay.telemetry:
        return replay.trace.stale_share
    return max(_frozen_share(replay, baseline), _overdue_share(replay, baseline))


def _frozen_share(replay: Replay, baseline: Replay | None) -> float:
    """Return the share of time in which readings stayed far longer than they do in a healthy vehicle.

    Only where the gyro turned meanwhile, and the next reading jumps: a compass without noise that stands
    still repeats itself for as long, and coarse numbers for as long as the field stays within their step.
    """
    trace = replay.trace
    longest = usual.repeats.telemetry_holds_s
    if baseline is not None and baseline.telemetry and baseline.trace.held_s.size:
        longest = max(
            float(baseline.trace.held_s.max()),
            usual.repeats.seen_twice_s,
            0.5 * float(np.median(np.diff(replay.time_s))),
        )
    # Coarse numbers change only with the field, and how the last one would have changed nobody knows.
    steps = 2.0 * trace.step_mgauss
    missed = trace.jump_mgauss > max(usual.repeats.moved_mgauss, steps)
    if steps > usual.repeats.moved_mgauss:
        missed &= np.isfinite(trace.jump_mgauss)
    held = trace.held_s[
        missed
        & (trace.turned_rad > usual.repeats.moved_rad)
        & (trace.held_s > usual.repeats.far_longer * longest)
    ]
    span = float((trace.fresh_s + trace.held_s).max(initial=replay.time_s[-1]) - replay.time_s[0])
    return min(float(held.sum()) / max(span, 1e-9), 1.0)


def _overdue_share(replay: Replay, baseline: Replay | None) -> float:
    """Return the share of readings that did not come when the baseline's compass always has a new one.

    Of messages in the same rhythm alone, and only where that is far more often than in the baseline.
    """
    if baseline is None or not baseline.telemetry or _steps_of(replay) != _steps_of(baseline):
        return 0.0
    (now, step), (before, usual_step) = _between_new(replay), _between_new(baseline)
    if (
        min(now.size, before.size) < usual.overdue.fewest
        or abs(step / usual_step - 1.0) > usual.overdue.same_rhythm
    ):
        return 0.0
    longest = max(
        float(np.quantile(before, usual.overdue.nearly_all)) + 0.5 * usual_step, 1.5 * float(before.mean())
    )
    expected = (float(np.sum(before > longest)) + 1.0) / before.size
    late = float(np.mean(now > longest))
    if late < usual.overdue.far_more * expected + 5.0 * math.sqrt(expected / now.size):
        return 0.0
    # A sensor about as fast as its messages drifts against them: it misses one now and then, never two.
    if np.sum(now > longest + usual_step) < usual.overdue.missed_twice:
        return 0.0
    return max(1.0 - float(before.mean()) / float(now.mean()), 0.0)


def _between_new(replay: Replay) -> tuple[FloatArray, float]:
    """Return the times between new readings, before which no message was lost, and between messages.

    Whole numbers repeat by chance where the field hardly changes: there they say nothing.
    """
    trace, nominal = replay.trace, replay.readings.nominal_mgauss
    between = np.diff(trace.fresh_s)
    if between.size < usual.overdue.fewest or len(nominal) != trace.fresh_s.size:
        return np.zeros(0), 1.0
    silent = between - trace.held_s[:-1]
    step = float(np.median(silent))
    changed = np.abs(np.diff(nominal, axis=0)).max(axis=1) * float(np.median(between)) / between
    told = (silent < usual.messages.lost * step) & (
        changed >= usual.overdue.changed * replay.resolution_mgauss
    )
    return between[told], step


def _steps_of(replay: Replay) -> tuple[float, float]:
    return replay.trace.step_mgauss, replay.resolution_mgauss


def estimated_step(replay: Replay) -> tuple[float, float]:
    """Return the step of the numbers and its sigma, mG: levels against how many steps they are.

    What rounding makes of a level it makes of each reading there: a level counts once.
    """
    step, readings = replay.trace.step_mgauss, replay.readings
    raw = (readings.error_mgauss + readings.nominal_mgauss)[readings.valid]
    levels, means = [], []
    for column in raw.T:
        level, which, size = np.unique(
            np.round((column - column[0]) / step), return_inverse=True, return_counts=True
        )
        mean = np.bincount(which, column) / size
        levels.append(level - level.mean())
        means.append(mean - mean.mean())
    count, field = np.concatenate(levels), np.concatenate(means)
    square, free = float(count @ count), count.size - 4
    if free < 1:
        return step, step
    fitted = float(field @ count) / square
    return fitted, math.sqrt(float(np.sum((field - fitted * count) ** 2)) / free / square)


def stale_sigma(replay: Replay, share: float) -> float:
    """Return the sigma of a share of readings that repeat, each by chance."""
    count = replay.trace.fresh_s.size / max(1.0 - share, 1e-3)
    return math.sqrt(share * (1.0 - share) / max(count, 1.0))


def names_step(replay: Replay, baseline: Replay | None, noise_mgauss: float) -> bool:
    """Tell whether the step of the numbers is an effect: coarse beside the noise, and not nominal."""
    found, nominal = replay.trace, baseline.trace if baseline is not None else None
    if found.step_mgauss <= usual.steps.much_coarser * replay.resolution_mgauss:
        return False
    if found.step_mgauss <= usual.steps.of_messages_mgauss:
        return False
    if nominal is not None and nominal.step_mgauss > 0.9 * found.step_mgauss:
        return False
    return found.step_mgauss > 0.5 * noise_mgauss


@dataclass(frozen=True, slots=True, eq=False)
class Detected:
    """Hold what single readings tell.

    Attributes:
        stale_share: the share of repeats; step_mgauss: the step of the numbers; zero where not to be named.
        rapid: effects that change with every reading, and were taken out. causes: all that is to be named.
        excess_mgauss2: the variance of white scatter beyond the baseline's, of single readings.
        unexplained: the coordinate of what single readings show beyond the baseline's and the floor, and what
            no name is for: "time" of bursts, "frequency" of a line that may not be named, or none.
    """

    stale_share: float = 0.0
    step_mgauss: float = 0.0
    rapid: tuple[Rapid, ...] = ()
    excess_mgauss2: float = 0.0
    unexplained: str = ""
    causes: tuple[Cause, ...] = ()


def detect(
    replay: Replay,
    baseline: Replay | None,
    noise_mgauss: float,
    floor_mgauss: float,
    names: frozenset[str],
    exact: bool,
) -> tuple[Detected, Replay]:
    """Read the traces off every reading; return the replay without what changes with each of them.

    `names` are the effects that may be named. Where the floor is `exact` and no readings are averaged, the
    search finds by itself what changes from reading to reading.
    """
    stale = stale_share(replay, baseline) if names_stale(replay, baseline) else 0.0
    step, step_doubt = estimated_step(replay) if names_step(replay, baseline, noise_mgauss) else (0.0, 0.0)
    readings, before = replay.readings, None if baseline is None else baseline.readings
    rapid: tuple[Rapid, ...] = ()
    if step == 0.0 and not (exact and replay.averaged == 1):
        for _ in range(usual.rapid.most):
            found = find_rapid(readings, before, usual.rapid.material * floor_mgauss)
            if found is None:
                break
            rapid, readings = (*rapid, found), readings.without(found.change_mgauss)
    # What may not be named stays in the readings, but it is no noise either.
    excess = 0.0 if before is None else excess_variance(readings, before, stale > 0.0)
    # Where nobody says when a reading was taken, what a line leaves may be the times.
    if replay.telemetry and excess < usual.rapid.of_times * sum(one.variance_mgauss2 for one in rapid):
        excess = 0.0
    named = tuple(one for one in rapid if one.effect in names)
    unexplained = "frequency" if len(named) < len(rapid) else ""
    rapid = named
    for one in rapid:
        replay = replay.without(one.change_mgauss)
    repeats, steps, causes = detected_by("repeats"), detected_by("steps"), list[Cause]()
    stale = stale if repeats.id in names else 0.0
    step = step if steps.id in names else 0.0
    if stale > 0.0:
        name = repeats.names[0]
        causes.append(Cause.detected(repeats.id, {name: stale}, {name: stale_sigma(replay, stale)}))
    if step > 0.0:
        name = steps.names[0]
        causes.append(Cause.detected(steps.id, {name: step}, {name: step_doubt}, step / math.sqrt(12.0)))
    causes += [Cause.detected(r.effect, r.parameters, r.sigma, math.sqrt(r.variance_mgauss2)) for r in rapid]
    if before is not None and burst_mgauss(readings, before) > usual.rapid.material * floor_mgauss:
        unexplained = "time"
    return Detected(stale, step, rapid, excess, unexplained, tuple(causes)), replay


def searched(replay: Replay, effects: Iterable[Effect]) -> list[Effect]:
    """Leave out of a search what averaged rows cannot show, and single readings have told."""
    return [e for e in effects if replay.averaged == 1 or e.detector not in ("alternation", "line")]
