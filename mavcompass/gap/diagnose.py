"""Diagnose the sim-to-real gap of a recording: where it lies, which effect causes it, how far it shrinks."""

from __future__ import annotations

import hashlib
import time
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from mavcompass.errors import UsageError
from mavcompass.gap import integrity
from mavcompass.gap.adequacy import Adequacy, judge
from mavcompass.gap.advise import next_flights
from mavcompass.gap.blas import single_thread
from mavcompass.gap.floor import (
    Floor,
    from_baseline,
    from_recording,
    rms,
    trusted_groups,
    with_noise,
)
from mavcompass.gap.identify import Identified, identify
from mavcompass.gap.locate import where
from mavcompass.gap.model import Fit, Problem
from mavcompass.gap.naming import named_causes, trace_causes
from mavcompass.gap.noise import Noise
from mavcompass.gap.nuisance import Nuisance
from mavcompass.gap.picture import picture
from mavcompass.gap.reference import Choice
from mavcompass.gap.replay import Replay, replay
from mavcompass.gap.result import Bar, Closing, Diagnosis, Verdict
from mavcompass.gap.scatter import Scatter, drift_gain, find_scatter, noise_with
from mavcompass.gap.search import Search, least_gain
from mavcompass.gap.shrink import closings, waterfall
from mavcompass.gap.split import split_blocks
from mavcompass.gap.testable import untestable_effects
from mavcompass.simulation.effects import catalogue
from mavcompass.simulation.effects.effect import Group
from mavcompass.track import Track

_SURE = 0.90
_FEWEST_TO_JUDGE = 150
_REMAINDER = 0.05
# Where even the baseline is not explained in detail, more may be left beside a name, and is flagged.
_REMAINDER_UNTRUSTED = 0.3
_WORTH_LISTING = 0.01
_SENSOR_WORDS: dict[Group, str] = {"mag": "compass", "acc": "accelerometer", "gyro": "gyro"}


def diagnose_gap(
    track: Track,
    baseline: Track | None = None,
    withhold: Iterable[str] = (),
    instance: int = 1,
    reference: Choice = "auto",
) -> Diagnosis:
    """Explain the gap between the simulation and a recording.

    `baseline` is a recording of the same vehicle in a state that is accepted as good: it gives the
    noise floor and tunes the simulator. `withhold` names effects that must not be used, together with
    their aliases. Raises BadRecording where there is too little to compare, UsageError for an unknown
    effect.
    """
    started = time.perf_counter()
    withheld = withheld_effects(withhold)
    with single_thread():
        result = _diagnose(track, baseline, withheld, instance, reference)
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


@dataclass(slots=True)
class _Verdict:
    """Collect the parts of the answer."""

    verdict: Verdict
    named: Fit
    flagged: bool
    coordinate: str | None


def _diagnose(
    track: Track, baseline: Track | None, withheld: frozenset[str], compass: int, reference: Choice
) -> Diagnosis:
    every = catalogue()
    replayed = replay(track, compass, reference)
    before = (
        replay(baseline, compass if compass in baseline.compasses else 1, reference) if baseline else None
    )
    witness = before if before is not None else replayed
    out_of_reach = untestable_effects(witness, every.values())
    trusted = trusted_groups(witness, [e for e in every.values() if e.id not in out_of_reach])
    replayed = _only(replayed, trusted)
    before = _only(before, trusted) if before is not None else None
    trace = integrity.inspect(replayed)
    nominal_trace = integrity.inspect(before) if before else None
    stale = integrity.names_stale(trace, nominal_trace, replayed) and "stale_samples" not in withheld
    if trace.stale_share > 0.0 and not replayed.telemetry and trace.step_mgauss == 0.0:
        replayed = replace(replayed, valid=replayed.valid & ~trace.stale)
    allowed = [e for e in every.values() if e.id not in withheld]
    untestable = untestable_effects(replayed, every.values())
    testable = [e for e in allowed if e.id not in untestable]
    if before is not None:
        floor = from_baseline(
            replayed, before, [e for e in every.values() if e.id not in untestable_effects(before, [e])]
        )
    else:
        floor = from_recording(replayed)
    split = split_blocks(replayed.time_s, replayed.valid)
    identified, floor = identify(replayed, floor, split, testable)
    names = frozenset(e.id for e in testable)
    step = integrity.names_step(trace, nominal_trace, replayed, float(floor.noise["mag"].rms.mean()))
    step = step and "quantisation" in names
    noisy, refitted, scatter = _with_scatter(identified, floor, names, trace.step_mgauss if step else 0.0)
    if scatter is not None and identified.fit.terms:
        # Extra scatter makes every gain look larger than it is: choose again under it.
        identified, _ = identify(replayed, with_noise(floor, noisy.noise), split, testable)
        noisy, refitted, scatter = _with_scatter(identified, floor, names, 0.0)
    # A saturated reading has no scatter, a rounded one another than the floor's.
    comparable = scatter is None and not step and "clipping" not in refitted.ids
    adequacy = judge(noisy, refitted, floor.representative and comparable)
    drift = floor.representative and _drifts(identified)
    answer = _decide(identified, floor, adequacy, drift, bool(scatter or stale or step), noisy, refitted)
    return _assemble(
        track, compass, replayed, floor, identified, answer, adequacy, scatter,
        trace.stale_share if stale else 0.0, trace.step_mgauss if step else 0.0,
        untestable, withheld, refitted,
    )  # fmt: skip


def _only(replayed: Replay, trusted: tuple[Group, ...]) -> Replay:
    """Leave out sensors that the simulation cannot explain where nothing is wrong, and say so."""
    kept = tuple(g for g in replayed.groups if g in trusted)
    left_out = [_SENSOR_WORDS[g] for g in replayed.groups if g not in trusted]
    notes = [f"The {word} does not fit the attitude reference in detail: left out." for word in left_out]
    return replace(replayed, groups=kept, notes=(*replayed.notes, *notes))


def _with_scatter(
    identified: Identified, floor: Floor, names: frozenset[str], step_mgauss: float
) -> tuple[Problem, Fit, Scatter | None]:
    """Refit the chosen effects on all rows; look for extra scatter, and put it into the noise."""
    replayed = identified.problem.replay
    everything = Problem(replayed, floor.noise, replayed.valid, floor.nuisances)
    if step_mgauss > 0.0:
        everything = _with_step(everything, step_mgauss)
    chosen = identified.fit
    fit = everything.fit(chosen.terms, chosen.thetas, chosen.nuisance_thetas)
    everything = _without_plateaus(everything, fit)
    fit = everything.fit(fit.terms, fit.thetas, fit.nuisance_thetas)
    scatter = find_scatter(everything, fit, names, floor.representative and step_mgauss == 0.0)
    if scatter is None:
        return everything, fit, None
    noisy = Problem(everything.replay, noise_with(everything, fit, scatter), everything.rows, floor.nuisances)
    return noisy, noisy.fit(fit.terms, fit.thetas, fit.nuisance_thetas), scatter


def _without_plateaus(problem: Problem, fit: Fit) -> Problem:
    """Leave out readings at the limit of a saturated sensor: they have no noise to be judged by."""
    if "clipping" not in fit.ids:
        return problem
    limit = float(fit.theta("clipping")[0])
    near = limit - 4.0 * float(problem.noise["mag"].rms.max())
    free = (np.abs(problem.replay.measured.mag_mgauss) < near).all(axis=1)
    valid = problem.replay.valid & free
    if valid.sum() < _FEWEST_TO_JUDGE:
        return problem
    return Problem(replace(problem.replay, valid=valid), problem.noise, valid, problem.nuisances)


def _baseline_replay(baseline: Track | None, compass: int, reference: Choice) -> Replay | None:
    if baseline is None:
        return None
    return replay(baseline, compass if compass in baseline.compasses else min(baseline.compasses), reference)


def _with_step(problem: Problem, step_mgauss: float) -> Problem:
    """Add the rounding's own noise, step^2 / 12, to the floor's."""
    noise: Noise = dict(problem.noise)
    mag = noise["mag"]
    added = step_mgauss**2 / 12.0
    noise["mag"] = replace(mag, sigma=np.sqrt(mag.sigma**2 + added), rms=np.sqrt(mag.rms**2 + added))
    return Problem(problem.replay, noise, problem.rows, problem.nuisances)


def _drifts(identified: Identified) -> bool:
    """Tell whether a wandering offset explains the gap better than the named effects do.

    It may stand beside any explored set that is smaller than the best one.
    """
    best, problem = identified.found.best, identified.first
    search = Search(problem, [])
    search.terms = identified.search.terms
    own = search.score(best)
    rivals = [f for f in identified.found.explored.values() if len(f.terms) <= len(best.terms)]
    rivals = sorted({f.ids: f for f in [*rivals, best]}.values(), key=search.score)[:6]
    cost = search.cost(1)
    for fit in rivals:
        gain, size = drift_gain(problem, fit)
        if size > 0.0 and gain > least_gain(4) and search.score(fit) - gain + cost < own - 6.0:
            return True
    return False


def _decide(
    identified: Identified,
    floor: Floor,
    adequacy: Adequacy,
    drift: bool,
    traces: bool,
    problem: Problem,
    refitted: Fit,
) -> _Verdict:
    fit = identified.fit
    none = identified.found.null
    flagged = adequacy.flagged
    coordinate = adequacy.coordinate
    if flagged and not floor.representative:
        rows = problem.usable
        left = rms((problem.replay.measured.mag_mgauss - problem.predict(refitted).mag_mgauss)[rows])
        flagged = left > 1.5 * floor.field_rms_mgauss
    if drift:
        return _Verdict("unknown", none, True, coordinate if flagged else "time")
    if not fit.terms and not traces:
        return _Verdict("unknown" if flagged else "no_gap", none, flagged, coordinate if flagged else None)
    if flagged:
        confirmed = _confirmed(problem, refitted, floor)
        if confirmed or not fit.terms:
            return _Verdict("named_with_remainder", fit, True, coordinate)
        return _Verdict("unknown", none, True, coordinate)
    weight = dict(identified.found.weights).get(fit.ids, 1.0)
    sure = weight >= _SURE or not fit.terms
    return _Verdict("named" if sure else "ambiguous", fit, False, None)


def _confirmed(problem: Problem, fit: Fit, floor: Floor) -> bool:
    """Tell whether named effects stand although something is left.

    They must hold nearly all of the gap: a look-alike of an unknown cause leaves much of it. What is left
    is measured above the floor, by the whitened sum of squares where the floor can be trusted in detail,
    otherwise by the field's mean square.
    """
    nominal, after = problem.predict(fit, effects=False), problem.predict(fit)
    share = _REMAINDER if floor.representative else _REMAINDER_UNTRUSTED
    if floor.representative:
        r0, r1 = problem.residual(nominal), problem.residual(after)
        before_excess, after_excess = float(r0 @ r0) - r0.size, float(r1 @ r1) - r1.size
    else:
        measured, rows = problem.replay.measured.mag_mgauss, problem.usable
        before_excess = rms((measured - nominal.mag_mgauss)[rows]) ** 2 - floor.field_rms_mgauss**2
        after_excess = rms((measured - after.mag_mgauss)[rows]) ** 2 - floor.field_rms_mgauss**2
    return before_excess > 0.0 and after_excess < share * before_excess


def _assemble(
    track: Track, compass: int, replayed: Replay, floor: Floor, identified: Identified, answer: _Verdict,
    adequacy: Adequacy, scatter: Scatter | None, stale_share: float, step_mgauss: float,
    untestable: dict[str, str], withheld: frozenset[str], refitted: Fit,
) -> Diagnosis:  # fmt: skip
    problem, split = identified.problem, identified.split
    named = answer.named
    added = step_mgauss**2 / 12.0
    if scatter is not None and answer.verdict != "unknown":
        added += _added_variance(scatter, problem, named, split.test)
    field, heading = closings(problem, named, split.test, floor, added)
    if named.terms and _worse_on(problem, named, split.test):
        # A name that makes held-out data worse is no explanation.
        answer = _Verdict("unknown", identified.found.null, True, adequacy.tests[0].coordinate)
        named = answer.named
        field, heading = closings(problem, named, split.test, floor)
    field, heading = _never_worse(field), _never_worse(heading)
    causes = named_causes(identified, named)
    if answer.verdict != "unknown":
        causes += trace_causes(scatter, stale_share, step_mgauss)
    look_alikes = () if named.terms else named_causes(identified, identified.fit)
    bars: tuple[Bar, ...] = ()
    if 1 <= len(named.terms) <= 4:
        bars = waterfall(lambda ids: _subset(identified, ids), problem, named.ids, split.test)
    rivals = _rivals(identified) if identified.found.best.terms else ()
    path = Path(track.source) if track.source else None
    return Diagnosis(
        path=track.source,
        sha256=hashlib.sha256(path.read_bytes()).hexdigest() if path and path.is_file() else None,
        duration_s=float(replayed.time_s[-1] - replayed.time_s[0]),
        samples=int(replayed.valid.sum()),
        autopilot=track.autopilot,
        compass=compass,
        reference=replayed.reference.kind,
        verdict=answer.verdict,
        causes=causes,
        look_alikes=look_alikes,
        ambiguity_set=tuple((tuple(sorted(ids)), w) for ids, w in identified.found.weights if ids),
        where=where(problem.with_rows(replayed.valid), named),
        field=field,
        heading=heading,
        waterfall=bars,
        unknown=answer.flagged,
        unknown_coordinate=answer.coordinate,
        tests=tuple((t.name, t.p) for t in adequacy.tests[:12]),
        not_testable=tuple(sorted(untestable.items())),
        next_flight=next_flights(rivals, replayed.signals.stimulus.field_ned_mgauss[0], floor.noise),
        folded=floor.folded,
        withheld=tuple(sorted(withheld)),
        seconds=0.0,
        notes=(
            *replayed.notes,
            *(f"{e} was considered and dropped: {why}." for e, why in identified.dropped),
        ),
        picture=picture(problem, named, split.test),
    )


def _worse_on(problem: Problem, fit: Fit, test: np.ndarray) -> bool:
    """Tell whether the effects make held-out readings of all sensors less likely."""
    held = problem.with_rows(test)
    before, after = held.residual(held.predict(fit, effects=False)), held.residual(held.predict(fit))
    return float(after @ after) > float(before @ before)


def _never_worse(closing: Closing) -> Closing:
    """Say no change where effects that show elsewhere (accelerometer, gyro) leave one figure as it was.

    All sensors together became better; one that has no part in it differs by its noise.
    """
    if closing.after <= closing.nominal:
        return closing
    return replace(closing, after=closing.nominal, shrink=0.0)


def _added_variance(scatter: Scatter, problem: Problem, fit: Fit, test: np.ndarray) -> float:
    if scatter.effect == "noise_excess":
        return scatter.size**2
    field = problem.signals(fit).reading.mag_mgauss
    change = np.gradient(field, problem.replay.time_s, axis=0)[test]
    return float(np.mean((scatter.size * change) ** 2))


def _subset(identified: Identified, ids: frozenset[str]) -> Fit:
    fit = identified.fit
    if ids == fit.ids:
        return fit
    keep = [i for i, t in enumerate(fit.terms) if t.effect.id in ids]
    problem = identified.problem
    # What is not an effect stays as the whole explanation has it, so that steps add up from the nominal.
    held = [
        Nuisance(n.effect, theta, np.eye(theta.size) * 1e14 / np.square(n.effect.scale))
        for n, theta in zip(problem.nuisances, fit.nuisance_thetas, strict=True)
    ]
    steady = Problem(problem.replay, problem.noise, problem.rows, held)
    return steady.fit([fit.terms[i] for i in keep], [fit.thetas[i] for i in keep], fit.nuisance_thetas)


def _rivals(identified: Identified) -> Sequence[tuple[frozenset[str], Fit]]:
    explored = identified.found.explored
    return [(ids, explored[ids]) for ids, _ in identified.found.weights if ids in explored and ids]
