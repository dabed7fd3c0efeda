"""Diagnose the sim-to-real gap of a recording: where it lies, which effect causes it, how far it shrinks."""

from __future__ import annotations

import time
from collections.abc import Callable, Collection, Iterable
from dataclasses import dataclass, replace

from mavcompass.blas import single_thread
from mavcompass.errors import UsageError
from mavcompass.gap.answer.decision import decide
from mavcompass.gap.answer.description import describe
from mavcompass.gap.answer.evidence import Evidence
from mavcompass.gap.attitude.inertial import accelerometer_fault, sensor_fault, without_fault
from mavcompass.gap.attitude.reference import Choice
from mavcompass.gap.attitude.steering import steered_by
from mavcompass.gap.left.adequacy import judge
from mavcompass.gap.left.doubtful import doubting
from mavcompass.gap.left.floor import Floor, foreseen, from_recording, with_noise
from mavcompass.gap.left.taught import from_baseline
from mavcompass.gap.replay.nominal import Replay, replay
from mavcompass.gap.replay.rows import shared_period_s
from mavcompass.gap.replay.testable import half_testable, untestable_effects
from mavcompass.gap.result import Cause, Diagnosis
from mavcompass.gap.selection.identification import Remainder, identify, what_is_left, with_white
from mavcompass.gap.selection.posterior import Identified
from mavcompass.gap.selection.split import split_blocks
from mavcompass.gap.traces.traces import Traces, find_traces, searched
from mavcompass.simulation.effects import Effect, catalogue
from mavcompass.track import Track

Replayed = dict[tuple[int, int, float, bool], tuple[Track, Replay]]

_WITHOUT_WITNESS = 1.5
_THOROUGH = 3.0


def diagnose_gap(
    track: Track,
    baseline: Track | None = None,
    withhold: Iterable[str] = (),
    instance: int = 1,
    reference: Choice = "auto",
    thorough: bool = False,
    progress: Callable[[str], None] = lambda doing: None,
    *,
    among: Collection[str] | None = None,
    replayed: Replayed | None = None,
) -> Diagnosis:
    """Explain the gap between the simulation and a recording.

    `baseline` is a recording of the same vehicle in a state that is accepted as good: it gives the
    noise floor and tunes the simulator. `withhold` names effects that must not be used, together with
    their aliases. `thorough` compares up to three times the rows of a long recording. `progress` is told what
    is being done. `among` names the effects to weigh, None for all; `replayed` keeps replays for diagnoses of
    the same recordings. Raises BadRecording where there is too little to compare, UsageError for an unknown
    effect.
    """
    started = time.perf_counter()
    withheld = withheld_effects(withhold)
    with single_thread():
        how = _How(instance, reference, thorough, progress, among, {} if replayed is None else replayed)
        evidence = _examined(track, baseline, withheld, how)
        result = describe(evidence, decide(evidence))
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
    among: Collection[str] | None
    replayed: Replayed


def examine(track: Track, baseline: Track | None, withheld: frozenset[str] = frozenset()) -> Evidence:
    """Find all that can be found about a recording, as a diagnosis does before anything is said of it."""
    with single_thread():
        return _examined(track, baseline, withheld, _How(1, "auto", False, lambda doing: None, None, {}))


def _examined(track: Track, baseline: Track | None, withheld: frozenset[str], how: _How) -> Evidence:
    """Go through the steps of docs/gap.md."""
    every = catalogue().values()
    how.progress("finding the attitude")

    # 1. Accelerometer
    shifted: tuple[Cause, ...] = ()
    if baseline is not None and track.reference_q is None:
        shifted = tuple(f for f in accelerometer_fault(track, baseline) if f.effect not in withheld)

    # 2. Replay, and with its attitude the gyro
    replayed, before = _replays(without_fault(track, shifted), baseline, how)
    faults = shifted
    if before is not None:
        now, then = replayed.reference, before.reference
        of_gyro = sensor_fault("gyro offset", now.gyro_bias, then.gyro_bias)
        of_gyro += sensor_fault("gyro gain", now.gyro_scale, then.gyro_scale)
        faults += tuple(f for f in of_gyro if f.effect not in withheld)

    # 3. Doubtful sensors, and with them what the recording can tell
    replayed, before = doubting(replayed, before, every)
    untestable = untestable_effects(replayed, every, before is not None and before.telemetry)
    half = half_testable(replayed, every)
    weighed = every if how.among is None else [e for e in every if e.id in how.among]
    testable = [e for e in weighed if e.id not in withheld and (e.id in half or e.id not in untestable)]

    # 4. Floor
    how.progress("measuring the floor")
    floor = from_recording(replayed) if before is None else from_baseline(replayed, before, every)
    if faults:
        # The autopilot's attitude is made of the same sensors: a witness less than in the baseline.
        floor = floor.larger(_WITHOUT_WITNESS)

    # 5. Traces
    traces, replayed = find_traces(
        replayed, before, float(floor.noise["mag"].rms.mean()), floor.field_rms_mgauss,
        frozenset(e.id for e in testable), floor.representative,
    )  # fmt: skip
    if before is None and traces.rapid:
        floor = from_recording(replayed)

    if traces.stale_share > 0.0 and replayed.trace.frozen:
        # A compass that says one thing tells of nothing else.
        testable = []

    # 6. Split, 7. Search, 8. What is left
    how.progress(f"weighing {len(testable)} effects")
    identified, remainder, floor = _explained(replayed, floor, testable, traces)
    if (
        any(t.effect.kind == "discrete" for t in identified.fit.terms)
        and steered_by(track, how.compass) != "other"
    ):
        # An autopilot that steers by a compass in another orientation leans as it should not: it says nothing
        # of the other sensors.
        faults = ()
    how.progress("looking at what is left")
    adequacy = judge(remainder.problem, remainder.fit, floor.representative and remainder.comparable)

    found = {fault.effect for fault in faults}
    hidden = {effect: why for effect, why in untestable.items() if effect not in found}
    return Evidence(
        track, how.compass, replayed, floor, identified, remainder, adequacy, traces, hidden, half,
        withheld, faults,
    )  # fmt: skip


def _replays(track: Track, baseline: Track | None, how: _How) -> tuple[Replay, Replay | None]:
    """Replay the recording and its baseline, with rows that follow each other alike."""
    tracks = [track] if baseline is None else [track, baseline]
    period_s = shared_period_s(tracks, how.compass) / (_THOROUGH if how.thorough else 1.0)
    if baseline is None:
        return _replayed(track, how.compass, period_s, how, alone=True), None
    compass = how.compass if how.compass in baseline.compasses else 1
    before = _replayed(baseline, compass, period_s, how)
    # What is late in the recording alone is a gap: its rows are no earlier than the baseline's.
    replayed = _replayed(track, how.compass, period_s, how, late_s=before.late_s)
    if before.averaged > replayed.averaged:
        # Means of fewer readings scatter more: a recording that lacks readings is held against the like.
        before = replay(baseline, compass, how.reference, period_s, replayed.averaged, late_s=before.late_s)
    return replayed, before


def _replayed(
    track: Track,
    compass: int,
    period_s: float,
    how: _How,
    alone: bool = False,
    late_s: float | None = None,
) -> Replay:
    """Replay a recording, once for all who keep the replays."""
    key = (id(track), compass, period_s, alone)
    if key not in how.replayed:
        made = replay(track, compass, how.reference, period_s, alone=alone, late_s=late_s)
        how.replayed[key] = (track, made)
    return how.replayed[key][1]


def _explained(
    replayed: Replay, floor: Floor, testable: list[Effect], traces: Traces
) -> tuple[Identified, Remainder, Floor]:
    """Search, and search again where the noise turns out to be another than the search assumed."""
    split = split_blocks(replayed.time_s, replayed.valid)
    names = frozenset(e.id for e in testable)
    if not floor.representative and (floor.measured or replayed.reference.kind != "columns"):
        floor = foreseen(floor, replayed, split.train, split.test)
    # With too small a noise everything looks like an effect: what the numbers tell of it counts before.
    detailed = floor.representative or not floor.measured
    white = 0.0 if detailed or traces.step_mgauss > 0.0 else traces.excess_mgauss2 / replayed.averaged
    added = white + traces.step_mgauss**2 / 12.0
    start = with_noise(floor, with_white(floor.noise, added)) if added > 0.0 else floor
    effects = searched(replayed, testable)
    identified, own = identify(replayed, start, split, effects, noise_known=floor.measured)
    floor = with_noise(own, floor.noise) if floor.measured else own
    remainder = what_is_left(identified, floor, names, traces)
    found = remainder.scatter
    if white > 0.0:
        done = found is not None and found.white
    else:
        done = found is None or not identified.found.best.terms
    if done:
        return identified, remainder, floor
    # Extra scatter makes every gain look larger than it is: choose again under it.
    noisy = with_noise(floor, remainder.problem.noise)
    identified, _ = identify(replayed, noisy, split, effects, noise_known=True)
    return identified, what_is_left(identified, floor, names, replace(traces, step_mgauss=0.0)), floor
