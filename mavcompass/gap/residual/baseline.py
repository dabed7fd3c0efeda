"""What a baseline teaches about the vehicle and its simulator.

A baseline recording of the same vehicle tells how far its calibration in force is to be trusted, what the
calibration and the field's model leave (with the joint covariance that this baseline leaves: what its motion
cannot tell apart stays apart), the noise of each channel, and how that grows where the field turns fast.
"""

from __future__ import annotations

import math
from collections.abc import Collection
from dataclasses import replace

import numpy as np

from mavcompass.frames import FloatArray
from mavcompass.gap.attitude.sensors import north_east_m
from mavcompass.gap.fit.hypothesis import Fit, Term, weak_precision
from mavcompass.gap.fit.model import Problem
from mavcompass.gap.fit.search import Search
from mavcompass.gap.replay.noise import Noise, SensorNoise
from mavcompass.gap.replay.nominal import Replay, level_mgauss, untestable_effects
from mavcompass.gap.replay.nuisance import (
    ANOTHER_IRON,
    IRON_MATRIX,
    IRON_OFFSET,
    REFERENCE_YAW,
    STATED,
    TELEMETRY_AGE,
    TELEMETRY_MEAN,
    WORLD_FIELD,
    Prior,
    Trust,
)
from mavcompass.gap.residual.floor import (
    Floor,
    apart,
    field_channels,
    first_noise,
    measured_noise,
    nominal_rate,
    prior_of,
    rms,
)
from mavcompass.gap.residual.goodness_of_fit import judge
from mavcompass.gap.tables import usual
from mavcompass.simulation.effects.effect import FREQUENCY, LIMIT, Effect

# How much the same vehicle differs from one recording to the next.
_FROM_DAY_TO_DAY = {
    WORLD_FIELD.id: usual.place.daily_mgauss,
    TELEMETRY_AGE: usual.age.daily_s,
    IRON_MATRIX: usual.compass.daily_matrix,
    IRON_OFFSET: usual.compass.daily_offset_mgauss,
    REFERENCE_YAW: usual.autopilot.daily_rad,
}
# Two waits never differ by more than a step of the messages: a normal of half their variance reaches that at
# 3.5 sigma, one of all of it at 2.4, and would take a lag of two steps for a wait.
_BOUNDED = math.sqrt(0.5)


def from_baseline(replay: Replay, baseline: Replay, effects: Collection[Effect]) -> Floor:
    """Tune the simulator to a baseline, with those effects that it can tell, and measure what it leaves."""
    trust, problem, fit = _tuned(baseline)
    sharp = baseline.reference.kind == "columns"
    if sharp and judge(problem, fit, compare_scatter=False).p < usual.baseline.gap_p:
        never = untestable_effects(baseline, effects).keys()
        # What comes and goes, lines and limits, no baseline teaches.
        lasting = (e for e in effects if not e.moves and {FREQUENCY, LIMIT}.isdisjoint(e.names))
        foldable = [e for e in lasting if e.kind == "mean" and e.id not in never]
        for _ in range(2):
            fit = Search(problem, foldable).run(usual.baseline.most_folded)
            if not fit.terms:
                break
            problem = Problem(baseline, measured_noise(problem, fit), baseline.valid, problem.prior)
            fit = problem.refit(fit)
    noise = measured_noise(problem, fit)
    problem = Problem(baseline, noise, baseline.valid, problem.prior)
    fit = problem.refit(fit)
    predicted = problem.predict(fit)
    error = (baseline.measured.mag_mgauss - predicted.mag_mgauss)[baseline.valid]
    law = None if sharp else _growth(problem, fit)
    noise = {g: noise[g] for g in replay.groups if g in noise} | {
        g: first_noise(replay)[g] for g in replay.groups if g not in noise
    }
    field_rms, heading_rms = apart(
        baseline, baseline.measured.mag_mgauss, predicted.mag_mgauss, baseline.valid
    )
    if law is not None:
        noise["mag"], larger = _grown(noise["mag"], law, baseline, replay)
        # The error of the model itself: attitudes and times of another flight are off in another way.
        level = level_mgauss(replay)
        field_rms = math.hypot(field_rms * larger, usual.compass.discrepancy_mgauss)
        heading_rms = math.hypot(heading_rms * larger, math.degrees(usual.compass.discrepancy_mgauss / level))
        # Scatter that is alike in all axes is scatter of the heading too, whatever the baseline's turns
        # showed.
        heading_rms = max(heading_rms, math.degrees(usual.baseline.level_more * field_rms / level))
    return Floor(
        noise=noise,
        field_rms_mgauss=field_rms,
        heading_rms_deg=heading_rms,
        error_mgauss=error,
        representative=_represents(problem, fit),
        prior=_posterior(replay, baseline, problem, fit, trust),
        folded=tuple(sorted(fit.ids)),
        measured=True,
        trust=trust,
    )


def _tuned(baseline: Replay) -> tuple[Trust | None, Problem, Fit]:
    """Fit what is not known of a good vehicle, trusting its calibration as far as this recording allows.

    The calibration is believed unless another iron would explain materially more: no attitude is exact, and
    what it leaves must not be made iron.
    """
    widest = Problem(baseline, first_noise(baseline), baseline.valid, prior_of(baseline, ANOTHER_IRON))
    first, stated = widest.null(), widest.noise
    # Where slow causes dominate, the scatter between neighbours is the noise.
    noise: Noise = {
        group: stated[group]
        if float(np.max(found.rms / stated[group].sigma)) > usual.baseline.dominated
        else found
        for group, found in measured_noise(widest, first).items()
    }
    problem = Problem(baseline, noise, baseline.valid, widest.prior)
    fit = problem.null(first)
    least = _rms_left(problem, fit)
    trust = STATED if baseline.iron.calibrated else None
    trusting = Problem(baseline, noise, baseline.valid, prior_of(baseline, trust))
    believed = trusting.null(None if trust is None else fit)
    # Where the noise is tighter than what is left, a prior is strained by as much.
    off2 = trusting.mahalanobis2(believed) / max(believed.sse / max(3 * trusting.count, 1), 1.0)
    worse = math.sqrt(max(_rms_left(trusting, believed) ** 2 - least**2, 0.0))
    material = 0.0 if baseline.reference.kind == "columns" else usual.baseline.material_mgauss
    if worse <= max(material, usual.baseline.material_share * least) and off2 <= usual.baseline.most_strain:
        return trust, trusting, believed
    return ANOTHER_IRON, problem, fit


def _rms_left(problem: Problem, fit: Fit) -> float:
    left = problem.replay.measured.mag_mgauss - problem.predict(fit).mag_mgauss
    return rms(left[problem.replay.valid])


def _growth(problem: Problem, fit: Fit) -> FloatArray:
    """Return how the squared residual of each channel grows with the square of its rate of change, (3,), s^2.

    Late, averaged and repeated readings, and an attitude at another time, make errors that go with the rate.
    """
    replay, noise = problem.replay, problem.noise["mag"]
    predicted = problem.predict(fit).mag_mgauss
    error = noise.in_channels(replay.measured.mag_mgauss - predicted)[replay.valid] ** 2
    change = nominal_rate(replay, noise)[replay.valid] ** 2
    bounded = np.minimum(error, 16.0 * np.mean(error, axis=0))
    spread = change - change.mean(axis=0)
    slope = (spread * bounded).sum(axis=0) / np.maximum((spread**2).sum(axis=0), 1e-9)
    return np.clip(slope, 0.0, 0.15**2)


def _grown(
    noise: SensorNoise, law: FloatArray, baseline: Replay, replay: Replay
) -> tuple[SensorNoise, float]:
    """Carry a noise over to a recording that turns more or less; return it and how much larger its rms is."""
    before = nominal_rate(baseline, noise)[baseline.valid] ** 2
    still = np.maximum(noise.rms**2 - law * before.mean(axis=0), 0.1 * noise.rms**2)
    here = replace(noise, channels=field_channels(replay))
    now = nominal_rate(replay, here) ** 2
    scale = np.sqrt((still + law * now) / noise.rms**2)
    larger = float(np.sqrt(np.mean(still + law * now[replay.valid].mean(axis=0)) / np.mean(noise.rms**2)))
    return replace(here, row_scale=np.maximum(scale, 0.3)), larger


def _represents(problem: Problem, fit: Fit) -> bool:
    """Tell whether a baseline's noise is that of other recordings too: explained, and not wandering.

    What wanders for seconds (an attitude that the vehicle's own sensors made, above all) does so in another
    way each time.
    """
    steady = not problem.noise["mag"].moving.any() and problem.replay.reference.kind == "columns"
    return steady and judge(problem, fit, compare_scatter=False).p > usual.baseline.representative_p


def _posterior(replay: Replay, baseline: Replay, problem: Problem, fit: Fit, trust: Trust | None) -> Prior:
    """Carry over what a baseline tells of the vehicle and its place, beside what is known of this recording.

    What its readings alone tell, with the joint information L that they leave (`Problem.information`), is
    told of another day with (1 + L D)^-1 L, D being by how much days differ.
    """
    kept = {IRON_MATRIX, IRON_OFFSET, TELEMETRY_AGE, TELEMETRY_MEAN}
    if _same_place(replay, baseline):
        kept.add(WORLD_FIELD.id)
    # A witness of the yaw is off by the same constant as it was in the baseline.
    witnessed = not (replay.reference.yaw_unknown or baseline.reference.yaw_unknown)
    own, there = prior_of(replay, trust), problem.prior.places
    prior = own.beside(*map(_folded, fit.terms, fit.thetas))
    # Of each parameter which one it was there, if any; how much days differ, and how much more it is here.
    source = np.full(prior.mean.size, -1)
    daily, shift = np.zeros(prior.mean.size), np.zeros(prior.mean.size)
    for nuisance, at in own.places.items():
        was = there.get(nuisance, slice(0, 0))
        if nuisance in kept and was.stop - was.start == at.stop - at.start:
            source[at] = np.arange(was.start, was.stop)
        elif nuisance == REFERENCE_YAW and witnessed and was.stop > was.start:
            source[at.start] = was.start
        else:
            continue
        daily[at] = _daily(nuisance, fit.nuisances[was], trust, replay, baseline)
        shift[at] = _shift(nuisance, replay, baseline)
    free = np.concatenate([np.zeros(0, dtype=np.bool_), *(term.free for term in fit.terms)])
    source[own.mean.size :][free] = fit.nuisances.size + np.arange(np.count_nonzero(free))
    place = np.flatnonzero(source >= 0)
    told, toward = (x / usual.baseline.widening for x in problem.information(fit, source[place]))
    over = np.linalg.inv(np.eye(place.size) + told * daily[place] ** 2)
    precision, given = prior.precision.copy(), prior.precision @ prior.mean
    precision[np.ix_(place, place)] += over @ told
    given[place] += over @ (toward + told @ shift[place])
    precision = 0.5 * (precision + precision.T)
    return replace(prior, mean=np.asarray(np.linalg.solve(precision, given)), precision=precision)


def _folded(term: Term, theta: FloatArray) -> Prior:
    """Hold what a fit held where it is; what it moved is as little known beforehand as it was there."""
    precision = (1e-6 * np.maximum(term.effect.scale, 1e-9)) ** -2.0
    precision[term.free] = weak_precision((term,))
    return Prior((term.effect,), np.where(term.free, 0.0, theta), np.diag(precision))


def _daily(
    nuisance: str, there: FloatArray, trust: Trust | None, replay: Replay, baseline: Replay
) -> FloatArray | float:
    """Say how much each parameter of a nuisance differs from one recording to the next."""
    laboratory = replay.reference.kind == "columns"
    daily = 0.0 if laboratory else _FROM_DAY_TO_DAY.get(nuisance, 0.0)
    if nuisance == TELEMETRY_AGE:
        waiting_s = _BOUNDED * max(_waiting_s(replay), _waiting_s(baseline))
        return np.hypot(
            daily, np.minimum(waiting_s, usual.baseline.waiting * np.abs(there + baseline.late_s))
        )
    if nuisance == IRON_OFFSET:
        # A field of the motors is as many mG over the loads that there were.
        over = float(np.ptp(np.concatenate([replay.iron.load, baseline.iron.load])))
        daily = daily * np.concatenate([np.ones(3), np.full(there.size - 3, 1.0 / max(over, 1e-6))])
    # An iron that nobody measured but this baseline takes all its errors with it.
    return usual.baseline.unmeasured * daily if trust is ANOTHER_IRON else daily


def _shift(nuisance: str, replay: Replay, baseline: Replay) -> FloatArray | float:
    """Return by how much a parameter is more here than there, by what both recordings say."""
    if nuisance == TELEMETRY_AGE:
        return baseline.late_s - replay.late_s
    return _field_apart(replay, baseline) if nuisance == WORLD_FIELD.id else 0.0


def _waiting_s(replay: Replay) -> float:
    """Return how much the time for which readings wait for their message differs between two starts.

    A reading waits between nothing and the messages' step, evenly, and the difference of two such times has a
    variance of a sixth of its square. Where the steps of compass and messages drift through each other all
    phases occur in one recording, and their mean is always the same; where they are in step, or some of the
    messages are, that which a recording began with stays.
    """
    fresh, read = replay.trace.fresh_s, replay.readings.time_s
    if fresh.size != read.size or fresh.size < usual.baseline.fewest_readings:
        return 0.0
    step = float(np.median(np.diff(fresh) - replay.trace.held_s[:-1]))
    return math.sqrt(max(step**2 / 6.0 - 2.0 * float(np.var(fresh - read)), 0.0))


def _field_apart(replay: Replay, baseline: Replay) -> FloatArray | float:
    """Return by how much the baseline's field is more than the recording's, NED, where it is a guess."""
    if baseline.field_known and replay.field_known:
        return 0.0
    field, there = (one.signals.stimulus.field_ned_mgauss[0] for one in (replay, baseline))
    return np.asarray(there - field)


def _same_place(replay: Replay, baseline: Replay) -> bool:
    """Tell whether two recordings were made so near to each other that the field is the same."""
    if replay.place is None or baseline.place is None:
        return True
    (lat, lon, _), (there_lat, there_lon, _) = replay.place, baseline.place
    return math.hypot(*north_east_m(there_lat, there_lon, lat, lon)) < usual.place.same_m
