"""Diagnose the sim-to-real gap of a recording: where it lies, which effect causes it, how far it shrinks."""

from __future__ import annotations

import time
from collections.abc import Callable, Collection, Iterable
from dataclasses import replace

from mavcompass.blas import single_thread
from mavcompass.errors import UsageError
from mavcompass.gap.answer.decision import decide
from mavcompass.gap.answer.description import describe
from mavcompass.gap.answer.evidence import Evidence
from mavcompass.gap.attitude.reference import Choice, steered_by
from mavcompass.gap.attitude.sensors import sensor_faults
from mavcompass.gap.detectors.detect import Detected, detect, searched
from mavcompass.gap.replay.nominal import Replay, broken, half_testable, replay, untestable_effects
from mavcompass.gap.replay.rows import shared_period_s
from mavcompass.gap.residual.baseline import from_baseline
from mavcompass.gap.residual.floor import Floor, from_recording, with_predictive_variance
from mavcompass.gap.residual.goodness_of_fit import doubting, judge
from mavcompass.gap.result import Diagnosis
from mavcompass.gap.selection.identification import Identified, Residual, identify, residual_of, with_white
from mavcompass.gap.selection.split import split_blocks
from mavcompass.simulation.effects import Effect, catalogue
from mavcompass.track import Track

Replayed = dict[tuple[int, int, float, bool], tuple[Track, Replay]]

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
        evidence = examine(
            track, baseline, withheld, instance, reference, thorough, progress, among=among, replayed=replayed
        )
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


@single_thread()
def examine(
    track: Track,
    baseline: Track | None,
    withheld: frozenset[str] = frozenset(),
    compass: int = 1,
    reference: Choice = "auto",
    thorough: bool = False,
    progress: Callable[[str], None] = lambda doing: None,
    *,
    among: Collection[str] | None = None,
    replayed: Replayed | None = None,
) -> Evidence:
    """Find all that can be found about a recording, in the steps of docs/gap.md, before anything is said."""
    every = catalogue().values()
    progress("finding the attitude")

    # 1. Replay, and with its attitude the gyro and the accelerometer
    kept = {} if replayed is None else replayed
    now, before = _replays(track, baseline, compass, reference, thorough, kept)
    faults = () if before is None else sensor_faults(now.reference.errors, before.reference.errors)
    faults = tuple(fault for fault in faults if fault.effect not in withheld)

    # 2. Doubtful sensors, and with them what the recording can tell
    now, before = doubting(now, before, every)
    split = split_blocks(now.time_s, now.valid)
    if not (split.train.any() and split.test.any()):
        raise broken(track.source)
    untestable = untestable_effects(now, every, before is not None and before.telemetry)
    half = half_testable(now, every)
    weighed = every if among is None else [e for e in every if e.id in among]
    testable = [e for e in weighed if e.id not in withheld and (e.id in half or e.id not in untestable)]

    # 3. Floor
    progress("measuring the floor")
    floor = from_recording(now) if before is None else from_baseline(now, before, every)

    # 4. Detected
    detected, now = detect(
        now, before, float(floor.noise["mag"].rms.mean()), floor.field_rms_mgauss,
        frozenset(e.id for e in testable), floor.representative,
    )  # fmt: skip
    if before is None and detected.rapid:
        floor = from_recording(now)
    if detected.stale_share > 0.0 and now.trace.frozen:
        # A compass that says one thing tells of nothing else.
        testable = []

    # 5. Split, 6. Search, 7. What is left
    progress(f"weighing {len(testable)} effects")
    identified, remainder, floor = _explained(now, floor, testable, detected)
    if identified.fit.is_turned and steered_by(track, compass) != "other":
        # An autopilot that steers by a compass in another orientation leans as it should not: it says nothing
        # of the other sensors.
        faults = ()
    progress("looking at what is left")
    goodness = judge(remainder.problem, remainder.fit, floor.representative and remainder.comparable)

    hidden = {effect: why for effect, why in untestable.items() if effect not in {f.effect for f in faults}}
    return Evidence(
        track, compass, now, floor, identified, remainder, goodness, detected, hidden, half,
        withheld, faults,
    )  # fmt: skip


def _replays(
    track: Track, baseline: Track | None, compass: int, reference: Choice, thorough: bool, kept: Replayed
) -> tuple[Replay, Replay | None]:
    """Replay the recording and its baseline, with rows that follow each other alike; `kept` is shared."""
    tracks = [track] if baseline is None else [track, baseline]
    period_s = shared_period_s(tracks, compass) / (_THOROUGH if thorough else 1.0)

    def made(one: Track, instance: int, alone: bool = False, late_s: float | None = None) -> Replay:
        key = (id(one), instance, period_s, alone)
        if key not in kept:
            kept[key] = (one, replay(one, instance, reference, period_s, alone=alone, late_s=late_s))
        return kept[key][1]

    if baseline is None:
        return made(track, compass, alone=True), None
    other = compass if compass in baseline.compasses else 1
    before = made(baseline, other)
    # What is late in the recording alone is a gap: its rows are no earlier than the baseline's.
    now = made(track, compass, late_s=before.late_s)
    if before.averaged > now.averaged:
        # Means of fewer readings scatter more: a recording that lacks readings is held against the like.
        before = replay(baseline, other, reference, period_s, now.averaged, late_s=before.late_s)
    if now.iron.source == before.iron.source:
        now = replace(now, iron=replace(now.iron, usual_load=before.iron.usual_load))
    return now, before


def _explained(
    replayed: Replay, floor: Floor, testable: list[Effect], detected: Detected
) -> tuple[Identified, Residual, Floor]:
    """Search, and search again where the noise turns out to be another than the search assumed."""
    split = split_blocks(replayed.time_s, replayed.valid)
    names = frozenset(e.id for e in testable)
    if not floor.representative and (floor.measured or replayed.reference.kind != "columns"):
        floor = with_predictive_variance(floor, replayed, split.train, split.test)
    # With too small a noise everything looks like an effect: what the numbers tell of it counts before.
    detailed = floor.representative or not floor.measured
    white = 0.0 if detailed or detected.step_mgauss > 0.0 else detected.excess_mgauss2 / replayed.averaged
    added = white + detected.step_mgauss**2 / 12.0
    start = replace(floor, noise=with_white(floor.noise, added)) if added > 0.0 else floor
    effects = searched(replayed, testable)
    identified, own = identify(replayed, start, split, effects, noise_known=floor.measured)
    floor = replace(own, noise=floor.noise) if floor.measured else own
    remainder = residual_of(identified, floor, names, detected)
    found = remainder.scatter
    expected = found is not None and found.white if white > 0.0 else found is None
    if expected:
        return identified, remainder, floor
    # Extra scatter makes every gain look larger than it is: choose again under it.
    noisy = replace(floor, noise=remainder.problem.noise)
    identified, _ = identify(replayed, noisy, split, effects, noise_known=True)
    return identified, residual_of(identified, floor, names, replace(detected, step_mgauss=0.0)), floor
