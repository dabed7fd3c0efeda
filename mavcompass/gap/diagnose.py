"""Diagnose the sim-to-real gap of a recording: where it lies, which effect causes it, how far it shrinks."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, replace
from functools import partial

from mavcompass.errors import UsageError
from mavcompass.gap.answer import Evidence, decide, describe
from mavcompass.gap.attitude import Choice, inertial_faults, without_faults
from mavcompass.gap.blas import single_thread
from mavcompass.gap.left import (
    Floor,
    doubtful_sensors,
    excess_scatter,
    from_baseline,
    from_recording,
    judge,
    with_noise,
)
from mavcompass.gap.replay import (
    Replay,
    SensorNoise,
    half_testable,
    replay,
    shared_period_s,
    traces_to_name,
    untestable_effects,
)
from mavcompass.gap.result import Cause, Diagnosis
from mavcompass.gap.selection import (
    Identified,
    Remainder,
    floor_to_start,
    identify,
    split_blocks,
    what_is_left,
)
from mavcompass.simulation.effects import Effect, catalogue
from mavcompass.simulation.effects.effect import Group
from mavcompass.track import Track

_WITHOUT_WITNESS = 1.5
_THOROUGH = 3.0
_OF_MOTION = frozenset({"linear_acceleration", "vibration_rectification"})
_SENSOR_WORDS: dict[Group, str] = {"mag": "compass", "acc": "accelerometer", "gyro": "gyro"}


def diagnose_gap(
    track: Track,
    baseline: Track | None = None,
    withhold: Iterable[str] = (),
    instance: int = 1,
    reference: Choice = "auto",
    thorough: bool = False,
    progress: Callable[[str], None] = lambda doing: None,
) -> Diagnosis:
    """Explain the gap between the simulation and a recording.

    `baseline` is a recording of the same vehicle in a state that is accepted as good: it gives the
    noise floor and tunes the simulator. `withhold` names effects that must not be used, together with
    their aliases. `thorough` compares up to three times the rows of a long recording. `progress` is told what
    is being done. Raises BadRecording where there is too little to compare, UsageError for an unknown effect.
    """
    started = time.perf_counter()
    withheld = withheld_effects(withhold)
    with single_thread():
        how = _How(instance, reference, thorough, progress)
        result = _diagnose(track, baseline, withheld, how)
    return replace(result, seconds=time.perf_counter() - started)


def withheld_effects(names: Iterable[str]) -> frozenset[str]:
    """Return effects and all that can look like them. Raises UsageError for an unknown name."""
    every = catalogue()
    out: set[str] = set()
    for name in names:
        if name not in every:
            raise UsageError(
                f"There is no effect called {name!r} to withhold.", "`mavcompass gap catalogue` lists them."
            )
        out |= {name, *every[name].aliases}
        out |= {other.id for other in every.values() if name in other.aliases}
    return frozenset(out)


@dataclass(frozen=True, slots=True)
class _How:
    """Hold how a diagnosis is to be made."""

    compass: int
    reference: Choice
    thorough: bool
    progress: Callable[[str], None]


def _diagnose(track: Track, baseline: Track | None, withheld: frozenset[str], how: _How) -> Diagnosis:
    how.progress("finding the attitude")
    every = catalogue().values()
    faults: tuple[Cause, ...] = ()
    if baseline is not None and track.reference_q is None:
        faults = tuple(f for f in inertial_faults(track, baseline) if f.effect not in withheld)
    replayed, before = _replays(without_faults(track, faults), baseline, how)
    untestable = untestable_effects(replayed, every, before is not None and before.telemetry)
    half = half_testable(replayed, every)
    testable = [e for e in every if e.id not in withheld and (e.id in half or e.id not in untestable)]
    how.progress("measuring the floor")
    if before is None:
        floor = from_recording(replayed)
    else:
        unseen = untestable_effects(before, every)
        floor = from_baseline(replayed, before, [e for e in every if e.id not in unseen])
    if faults:
        # The attitude has lost a witness that the baseline had.
        floor = floor.larger(_WITHOUT_WITNESS)
    names = frozenset(e.id for e in testable)
    stale_share, step_mgauss = traces_to_name(replayed, before, float(floor.noise["mag"].rms.mean()), names)
    how.progress(f"weighing {len(testable)} effects")
    identified, remainder, floor = _explained(replayed, before, floor, testable, step_mgauss)
    how.progress("looking at what is left")
    adequacy = judge(remainder.problem, remainder.fit, floor.representative and remainder.comparable)
    traces = bool(faults) or remainder.scatter is not None or stale_share > 0.0 or step_mgauss > 0.0
    answer = decide(identified, floor, remainder, adequacy, traces, half)
    evidence = Evidence(
        track, how.compass, replayed, floor, identified, remainder, adequacy, stale_share, step_mgauss,
        untestable, withheld, faults,
    )  # fmt: skip
    return describe(evidence, answer)


def _replays(track: Track, baseline: Track | None, how: _How) -> tuple[Replay, Replay | None]:
    """Replay the recording and its baseline, with the sensors that can bear witness."""
    compass, reference = how.compass, how.reference
    tracks = [track] if baseline is None else [track, baseline]
    period_s = shared_period_s(tracks, compass) / (_THOROUGH if how.thorough else 1.0)
    replayed = replay(track, compass, reference, period_s)
    before = None
    if baseline is not None:
        before = replay(baseline, compass if compass in baseline.compasses else 1, reference, period_s)
    every = catalogue().values()
    known = [e for e in every if e.id not in untestable_effects(replayed, every)]
    doubtful, useless = doubtful_sensors(replayed, known)
    if before is not None:
        unseen = untestable_effects(before, every)
        # What a baseline's motion makes its accelerometer feel is no cause that would come again.
        steady = [e for e in every if e.id not in unseen and e.id not in _OF_MOTION]
        more, also = doubtful_sensors(before, steady)
        doubtful, useless = {**doubtful, **more}, useless | also
    with_doubt = partial(_doubting, doubtful=doubtful, useless=useless)
    return with_doubt(replayed), with_doubt(before) if before is not None else None


def _doubting(replayed: Replay, doubtful: Mapping[Group, SensorNoise], useless: frozenset[Group]) -> Replay:
    """Let sensors that the simulation cannot explain where nothing is wrong count for less, and say so."""
    notes = list(replayed.notes)
    for group in replayed.groups:
        if group in doubtful or group in useless:
            how = "left out" if group in useless else "it counts for less"
            notes.append(f"The {_SENSOR_WORDS[group]} does not fit the reference in detail: {how}.")
    kept = tuple(g for g in replayed.groups if g not in useless)
    return replace(replayed, groups=kept, doubtful=doubtful, notes=tuple(notes))


def _explained(
    replayed: Replay, baseline: Replay | None, floor: Floor, testable: list[Effect], step_mgauss: float
) -> tuple[Identified, Remainder, Floor]:
    """Search, and search again where the noise turns out to be another than the search assumed."""
    split = split_blocks(replayed.time_s, replayed.valid)
    names = frozenset(e.id for e in testable)
    start = floor_to_start(floor, replayed, baseline, step_mgauss)
    excess = excess_scatter(replayed, baseline) if baseline is not None else 0.0
    identified, widened = identify(replayed, start, split, testable)
    if not floor.measured:
        floor = widened
    remainder = what_is_left(identified, floor, names, step_mgauss, excess)
    if remainder.scatter is None and (start is floor or not floor.measured or step_mgauss > 0.0):
        return identified, remainder, floor
    if remainder.scatter is None:
        # What looked like scatter belongs to what was found: choose again under the floor itself.
        identified, _ = identify(replayed, floor, split, testable)
    elif identified.found.best.terms:
        # Extra scatter makes every gain look larger than it is: choose again under it.
        identified, _ = identify(replayed, with_noise(floor, remainder.problem.noise), split, testable)
    else:
        return identified, remainder, floor
    return identified, what_is_left(identified, floor, names, 0.0, excess), floor
