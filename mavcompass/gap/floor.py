"""The floor: what is left when nothing is wrong, and what a baseline teaches about the simulator.

With a baseline recording of the same vehicle the floor is its residual after the simulator has been
tuned to it: the world field, and effects that the baseline itself shows, are folded in with the
uncertainty that the baseline leaves. Without one, the floor is the scatter between neighbouring
readings, the numbers' resolution and the doubt in the attitude reference; the verdict is more careful.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from mavcompass.frames import FloatArray
from mavcompass.gap.adequacy import judge
from mavcompass.gap.hypothesis import Fit
from mavcompass.gap.model import Problem
from mavcompass.gap.noise import (
    USUAL_SCATTER_MGAUSS,
    WORST_SCATTER_MGAUSS,
    Noise,
    SensorNoise,
    estimate_noise,
    group_values,
    rough_sigma,
    wandering,
    white,
)
from mavcompass.gap.nuisance import WORLD_FIELD, Nuisance
from mavcompass.gap.replay import Replay
from mavcompass.gap.search import Search
from mavcompass.simulation.effects.causes.world import gradient_matrix, gradient_origin
from mavcompass.simulation.effects.effect import Effect

_LEAST = {"mag": 1e-3, "acc": 1e-5, "gyro": 1e-6}
_STATED_MGAUSS = 0.3
_REFERENCE_DOUBT_RAD = {
    "columns": math.radians(0.2),
    "gps-yaw": math.radians(0.5),
    "gyro": math.radians(0.4),
    "attitude": math.radians(1.0),
}
_DOUBT_LASTS_S = 5.0
_TIME_DOUBT_S = {"telemetry": 0.03, "direct": 0.01}
_FOLD_WIDENING = 4.0
_MOST_FOLDED = 4
# One good baseline in some hundreds is flagged by chance: it must not cost the diagnosis its sharpness.
_REPRESENTATIVE_P = 1e-5


@dataclass(frozen=True, slots=True, eq=False)
class Floor:
    """Hold the floor.

    Attributes:
        noise: for whitening, per sensor.
        field_rms_mgauss: rms over samples and axes; heading_rms_deg: of the tilt-compensated heading.
        error_mgauss: the baseline's residual, (N, 3), for intervals; empty without a baseline.
        representative: True where a baseline gave it, and the simulation explains that baseline.
        measured: True where a baseline gave it.
        nuisances: those of the recording, with what the baseline taught.
        folded: effects of the baseline, by id, that belong to the nominal simulation from now on.
    """

    noise: Noise
    field_rms_mgauss: float
    heading_rms_deg: float
    error_mgauss: FloatArray
    representative: bool
    nuisances: tuple[Nuisance, ...]
    folded: tuple[str, ...] = ()
    measured: bool = False


def first_noise(replay: Replay) -> Noise:
    """State a first noise from the scatter between neighbouring readings."""
    noise: Noise = {}
    for group in replay.groups:
        if group in replay.doubtful:
            noise[group] = replay.doubtful[group]
            continue
        measured, ideal = group_values(replay.measured, group), group_values(replay.signals.reading, group)
        sigma = rough_sigma(measured - ideal, replay.valid)
        least = max(_LEAST[group], replay.resolution_mgauss if group == "mag" else 0.0)
        if group == "mag":
            least = max(least, _STATED_MGAUSS)
        noise[group] = white(np.maximum(np.nan_to_num(sigma, nan=least), least))
    return noise


def measured_noise(problem: Problem, fit: Fit) -> Noise:
    """Estimate the noise from what a fit leaves."""
    predicted = problem.predict(fit)
    replay = problem.replay
    noise: Noise = {}
    for group in replay.groups:
        if group in replay.doubtful:
            noise[group] = replay.doubtful[group]
            continue
        error = group_values(replay.measured, group) - group_values(predicted, group)
        least = max(_LEAST[group], replay.resolution_mgauss if group == "mag" else 0.0)
        noise[group] = estimate_noise(error, replay.valid, least)
    return noise


def heading_error_rad(replay: Replay, field_mgauss: FloatArray, other_mgauss: FloatArray) -> FloatArray:
    """Return the tilt-compensated heading of one field (N, 3) less that of another, radians, (N,)."""
    r = replay.signals.stimulus.rotation
    # In world axes both fields are levelled; the yaw drops out of the angle between them.
    a = np.einsum("nij,nj->ni", r, field_mgauss)
    b = np.einsum("nij,nj->ni", r, other_mgauss)
    cross = b[:, 0] * a[:, 1] - b[:, 1] * a[:, 0]
    dot = b[:, 0] * a[:, 0] + b[:, 1] * a[:, 1]
    return np.asarray(-np.arctan2(cross, dot))


def rms_deg(angle_rad: FloatArray) -> float:
    """Return the root mean square of angles, in degrees."""
    return math.degrees(math.sqrt(float(np.mean(angle_rad**2)))) if angle_rad.size else math.nan


def rms(error: FloatArray) -> float:
    """Return the root mean square over samples and axes together."""
    return math.sqrt(float(np.mean(error**2))) if error.size else math.nan


def from_baseline(replay: Replay, baseline: Replay, effects: Sequence[Effect]) -> Floor:
    """Tune the simulator to a baseline and measure what it leaves."""
    first = Problem(baseline, first_noise(baseline), baseline.valid, baseline.nuisances)
    null = first.null()
    noise = _without_slow_causes(first, null)
    problem = Problem(baseline, noise, baseline.valid, baseline.nuisances)
    fit = problem.null()
    if _has_gap(problem, fit):
        mean_effects = [e for e in effects if e.kind == "mean" and e.id not in _NEVER_FOLDED]
        fit = Search(problem, mean_effects).run(_MOST_FOLDED).best
        problem = Problem(baseline, measured_noise(problem, fit), baseline.valid, baseline.nuisances)
        fit = problem.refit(fit)
        if fit.terms:
            fit = Search(problem, mean_effects).run(_MOST_FOLDED).best
    noise = measured_noise(problem, fit)
    problem = Problem(baseline, noise, baseline.valid, baseline.nuisances)
    fit = problem.refit(fit)
    predicted = problem.predict(fit)
    error = (baseline.measured.mag_mgauss - predicted.mag_mgauss)[baseline.valid]
    heading = heading_error_rad(baseline, baseline.measured.mag_mgauss, predicted.mag_mgauss)
    noise = {g: noise[g] for g in replay.groups if g in noise} | {
        g: first_noise(replay)[g] for g in replay.groups if g not in noise
    }
    return Floor(
        noise=noise,
        field_rms_mgauss=rms(error),
        heading_rms_deg=rms_deg(heading[baseline.valid]),
        error_mgauss=error,
        representative=_represents(problem, fit),
        nuisances=_taught(replay, baseline, problem, fit),
        folded=tuple(sorted(fit.ids)),
        measured=True,
    )


def _represents(problem: Problem, fit: Fit) -> bool:
    """Tell whether a baseline's noise is that of other recordings too: explained, and not wandering.

    What wanders for seconds (an attitude that the vehicle's own sensors made, above all) does so in another
    way each time.
    """
    steady = problem.noise["mag"].moving == 0.0 and problem.replay.reference.kind == "columns"
    return steady and judge(problem, fit, compare_scatter=False).p > _REPRESENTATIVE_P


_NEVER_FOLDED = frozenset({"hard_iron_step", "ac_interference", "relay_field", "orientation", "clipping"})


def _without_slow_causes(problem: Problem, fit: Fit) -> Noise:
    """Estimate the noise of the residual; where slow causes dominate, keep the scatter between neighbours."""
    measured, stated = measured_noise(problem, fit), problem.noise
    out: Noise = {}
    for group, noise in measured.items():
        dominated = float(np.max(noise.rms / stated[group].sigma)) > 1.6
        out[group] = stated[group] if dominated else noise
    return out


def _has_gap(problem: Problem, fit: Fit) -> bool:
    return judge(problem, fit, compare_scatter=False, thorough=False).flagged


def _taught(replay: Replay, baseline: Replay, problem: Problem, fit: Fit) -> tuple[Nuisance, ...]:
    """Carry the world field and the folded effects over, with the uncertainty that the baseline left."""
    out: list[Nuisance] = []
    covariance, at = fit.covariance, 0
    for nuisance, theta in zip(problem.nuisances, fit.nuisance_thetas, strict=True):
        size = theta.size
        if nuisance.effect is WORLD_FIELD:
            block = covariance[at : at + size, at : at + size]
            field = baseline.signals.stimulus.field_ned_mgauss[0] + theta
            mean = field - replay.signals.stimulus.field_ned_mgauss[0]
            if baseline.field_known and replay.field_known:
                mean = theta.copy()
            mean = mean + _from_start_to_start(replay, baseline, fit)
            precision = np.asarray(np.linalg.inv(_FOLD_WIDENING * block), dtype=np.float64)
            out.append(Nuisance(WORLD_FIELD, mean, precision))
        at += size
    out.extend(n for n in replay.nuisances if n.effect is not WORLD_FIELD)
    for term, theta in zip(fit.terms, fit.thetas, strict=True):
        index = np.flatnonzero(term.free)
        block = covariance[at : at + index.size, at : at + index.size]
        precision = np.zeros((theta.size, theta.size))
        np.fill_diagonal(precision, 1e12 / np.maximum(term.effect.scale, 1e-9) ** 2)
        precision[np.ix_(index, index)] = np.linalg.pinv(_FOLD_WIDENING * block)
        out.append(Nuisance(term.effect, theta.copy(), precision))
        at += index.size
    return tuple(out)


def _from_start_to_start(replay: Replay, baseline: Replay, fit: Fit) -> FloatArray:
    """Return how a folded gradient changes the field from one recording's origin to the other's.

    Only positions of a reference share their datum.
    """
    if "field_gradient" not in fit.ids or not replay.reference.kind == baseline.reference.kind == "columns":
        return np.zeros(3)
    own, other = (gradient_origin(one.signals.stimulus.position_ned_m) for one in (replay, baseline))
    return np.asarray((own - other) @ gradient_matrix(fit.theta("field_gradient")))


def from_recording(replay: Replay) -> Floor:
    """State a floor without a baseline: scatter, the reference's slow doubt, and the doubt in the times.

    The doubt in the attitude wanders, as a first-order process of some seconds; the doubt in the times
    grows with the field's rate of change. Scatter that no data sheet allows is not the floor's.
    """
    noise = first_noise(replay)
    scatter = noise["mag"].sigma
    world = replay.signals.stimulus.field_ned_mgauss[0]
    total, level = float(np.linalg.norm(world)), max(float(np.hypot(world[0], world[1])), 1.0)
    doubt = max(_REFERENCE_DOUBT_RAD[replay.reference.kind], replay.reference.tilt_sigma_rad)
    # A small random rotation moves the field by doubt |B| in two of three directions.
    slow = doubt * total * math.sqrt(2.0 / 3.0)
    white_rms = math.sqrt(float(np.mean(scatter**2)))
    usual = white_rms if white_rms < WORST_SCATTER_MGAUSS else USUAL_SCATTER_MGAUSS
    step = float(np.median(np.diff(replay.time_s)))
    rho = math.exp(-step / _DOUBT_LASTS_S)
    sigma, moving = wandering(scatter, slow, rho)
    late = _TIME_DOUBT_S["telemetry" if replay.telemetry else "direct"]
    change = np.gradient(replay.signals.reading.mag_mgauss, replay.time_s, axis=0)
    whole = math.hypot(white_rms, slow)
    scale = np.sqrt(1.0 + (late * change / sigma) ** 2)
    mag = SensorNoise(np.array([rho]), sigma, np.full(3, whole), np.inf, scale, moving)
    timing = late * math.sqrt(float(np.mean(change[replay.valid] ** 2)))
    return Floor(
        {**noise, "mag": mag},
        math.hypot(usual, slow, timing),
        math.degrees(math.hypot(usual, doubt * total, timing) / level),
        np.zeros((0, 3)),
        False,
        replay.nuisances,
    )


def widened(floor: Floor, problem: Problem, fit: Fit) -> Floor:
    """Widen a stated noise where a fit leaves more than it: the doubt was larger than stated."""
    z = problem.innovations(problem.predict(fit))["mag"][problem.index]
    excess = math.sqrt(float(np.mean(z**2)))
    if excess <= 1.05:
        return floor
    mag = floor.noise["mag"]
    return with_noise(floor, {**floor.noise, "mag": replace(mag, sigma=mag.sigma * excess)})


def with_noise(floor: Floor, noise: Noise) -> Floor:
    """Return the same floor with another noise for whitening."""
    return replace(floor, noise=noise)
