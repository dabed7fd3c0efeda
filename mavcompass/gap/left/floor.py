"""The floor: what is left when nothing is wrong, as noise, as figures, and as what is known beforehand."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from mavcompass.frames import FloatArray
from mavcompass.gap.fit import Fit, Problem
from mavcompass.gap.replay import (
    Noise,
    Prior,
    Replay,
    SensorNoise,
    Trust,
    estimate_noise,
    group_values,
    rough_sigma,
    white,
)
from mavcompass.gap.tables import Kind
from mavcompass.simulation.effects.effect import Group

_LEAST = {"mag": 1e-3, "acc": 1e-5, "gyro": 1e-6}
_STATED_MGAUSS, _LEAST_IN_FLIGHT_MGAUSS = 0.3, 0.8
# A fit that leaves less of the noise than this tells nothing of it.
_LEAST_LEFT = 0.2


@dataclass(frozen=True, slots=True, eq=False)
class Floor:
    """Hold the floor.

    Attributes:
        noise: for whitening, per sensor.
        field_rms_mgauss: rms over samples and axes; heading_rms_deg: of the tilt-compensated heading.
        error_mgauss: the baseline's residual, (N, 3), for intervals; empty without a baseline.
        representative: True where a baseline gave it, and the simulation explains that baseline.
        measured: True where a baseline gave it.
        prior: the nuisances of the recording, with what the baseline taught.
        folded: effects of the baseline, by id, that belong to the nominal simulation from now on.
        trust: how far the calibration in force was found to be right; None where none is in force.
    """

    noise: Noise
    field_rms_mgauss: float
    heading_rms_deg: float
    error_mgauss: FloatArray
    representative: bool
    prior: Prior
    folded: tuple[str, ...] = ()
    measured: bool = False
    trust: Trust | None = None

    def larger(self, factor: float) -> Floor:
        """Return a floor that lies higher."""
        return replace(
            self,
            field_rms_mgauss=self.field_rms_mgauss * factor,
            heading_rms_deg=self.heading_rms_deg * factor,
        )


def first_noise(replay: Replay) -> Noise:
    """State a first noise from the scatter between neighbouring readings."""
    noise: Noise = {}
    for group in replay.groups:
        if group in replay.doubtful:
            noise[group] = replay.doubtful[group]
            continue
        measured, ideal = group_values(replay.measured, group), group_values(replay.signals.reading, group)
        sigma = rough_sigma(measured - ideal, replay.valid)
        least = max(_least_sigma(replay, group), _STATED_MGAUSS if group == "mag" else 0.0)
        noise[group] = white(np.maximum(np.nan_to_num(sigma, nan=least), least))
    return noise


def measured_noise(problem: Problem, fit: Fit) -> Noise:
    """Estimate the noise from what a fit leaves, which is less than there was by what it has used up."""
    predicted, left = problem.predict(fit), _left_by(problem, fit)
    replay = problem.replay
    noise: Noise = {}
    for group in replay.groups:
        if group in replay.doubtful:
            noise[group] = replay.doubtful[group]
            continue
        error = group_values(replay.measured, group) - group_values(predicted, group)
        found = estimate_noise(
            error,
            replay.valid,
            _least_sigma(replay, group),
            field_channels(replay) if group == "mag" else None,
        )
        share = left[group]
        if found.channels is not None and problem.noise[group].channels is None:
            share = np.full(3, float(share.mean()))
        noise[group] = replace(found, sigma=found.sigma / np.sqrt(share), rms=found.rms / np.sqrt(share))
    return noise


def _left_by(problem: Problem, fit: Fit) -> dict[Group, FloatArray]:
    """Return the mean square that a fit leaves of noise of variance one, per sensor and channel, (3,).

    Of readings with the derivatives J and a prior of precision P a fit leaves I - H with the leverages
    H = J (J^T J + P)^-1 J^T (Hoaglin and Welsch, The American Statistician 32, 1978): a short baseline leaves
    little of its own noise beside an attitude of many curves.
    """
    count = fit.covariance.shape[0]
    if not count:
        return {group: np.ones(3) for group in problem.groups}
    states = problem.composition.states(fit.terms, fit.thetas, fit.nuisance_thetas)
    members = range(len(problem.nuisances) + len(fit.terms))
    J = problem.columns(fit.terms, fit.thetas, fit.nuisance_thetas, states, members)
    leverage = np.einsum("ij,ij->i", J @ fit.covariance, J).reshape(len(problem.groups), -1, 3)
    left = np.maximum(1.0 - leverage.mean(axis=1), _LEAST_LEFT)
    return dict(zip(problem.groups, left, strict=True))


def _least_sigma(replay: Replay, group: str) -> float:
    """Return the least noise that is believed: of a vehicle's own attitude no model is exact to less."""
    if group != "mag":
        return _LEAST[group]
    own = 0.0 if replay.reference.kind == "columns" else _LEAST_IN_FLIGHT_MGAUSS
    return max(_LEAST[group], replay.resolution_mgauss, own)


def widened(floor: Floor, problem: Problem, fit: Fit) -> Floor:
    """Widen a stated noise where a fit leaves more than it: the doubt was larger than stated."""
    z = problem.innovations(problem.predict(fit))["mag"][problem.index]
    excess = np.sqrt(np.mean(z**2, axis=0))
    if float(np.sqrt(np.mean(excess**2))) <= 1.05:
        return floor
    if floor.noise["mag"].channels is None:
        excess = np.full(3, float(np.sqrt(np.mean(excess**2))))
    excess = np.maximum(excess, 1.0)
    mag = floor.noise["mag"]
    return with_noise(floor, {**floor.noise, "mag": replace(mag, sigma=mag.sigma * excess)})


def kind_of(replay: Replay, floor: Floor) -> Kind:
    """Tell how a recording is known."""
    if floor.representative:
        return "exact"
    if floor.measured:
        return "baseline"
    return "reference" if replay.reference.kind == "columns" else "alone"


def with_noise(floor: Floor, noise: Noise) -> Floor:
    """Return the same floor with another noise for whitening."""
    return replace(floor, noise=noise)


def prior_of(replay: Replay, trust: Trust | None) -> Prior:
    """Return the prior of a recording's nuisances, the iron in force among them; None trusts no
    calibration."""
    iron = () if trust is None else replay.iron.nuisances(trust)
    return Prior.of((*replay.nuisances, *iron))


def field_channels(replay: Replay) -> FloatArray | None:
    """Return the turn from raw readings to channels along and across the world's field, (N, 3, 3).

    The first is along the field: no error of the attitude shows in it. The second is level: errors of the
    yaw. None where the attitude has no errors to speak of.
    """
    if replay.reference.kind == "columns":
        return None
    field = replay.signals.stimulus.field_ned_mgauss[0]
    along = field / max(float(np.linalg.norm(field)), 1e-9)
    level = np.array([-along[1], along[0], 0.0])
    level /= max(float(np.linalg.norm(level)), 1e-9)
    turn = np.stack([along, level, np.cross(along, level)])
    return np.asarray(turn @ replay.signals.stimulus.rotation @ np.linalg.inv(replay.iron.matrix))


def nominal_rate(replay: Replay, noise: SensorNoise) -> FloatArray:
    """Return how fast the nominal field turns, in the noise's channels, (N, 3), mG/s."""
    turning = np.gradient(replay.nominal_mgauss, replay.time_s, axis=0)
    return noise.in_channels(np.asarray(turning))


def heading_error_rad(replay: Replay, field_mgauss: FloatArray, other_mgauss: FloatArray) -> FloatArray:
    """Return the tilt-compensated heading of one field (N, 3) less that of another, radians, (N,)."""
    r = replay.signals.stimulus.rotation
    # In world axes both fields are levelled; the yaw drops out of the angle between them. A heading is made
    # of readings that the calibration in force has corrected.
    a = np.einsum("nij,nj->ni", r, replay.iron.field(field_mgauss))
    b = np.einsum("nij,nj->ni", r, replay.iron.field(other_mgauss))
    cross = b[:, 0] * a[:, 1] - b[:, 1] * a[:, 0]
    dot = b[:, 0] * a[:, 0] + b[:, 1] * a[:, 1]
    return np.asarray(-np.arctan2(cross, dot))


def heading_scatter(replay: Replay, field_mgauss: FloatArray) -> FloatArray:
    """Return how a heading scatters, radians, where each axis of a raw field (N, 3) does by a milligauss,
    (N,)."""
    moved = [heading_error_rad(replay, field_mgauss + axis, field_mgauss) for axis in np.eye(3)]
    return np.sqrt(np.sum(np.square(moved), axis=0))


def apart(
    replay: Replay, field_mgauss: FloatArray, other_mgauss: FloatArray, rows: NDArray[np.bool_ | np.int64]
) -> tuple[float, float]:
    """Return by how much two fields (N, 3) differ on some rows, as rms: field (mG) and heading (deg)."""
    turned = heading_error_rad(replay, field_mgauss, other_mgauss)
    return rms((field_mgauss - other_mgauss)[rows]), rms_deg(turned[rows])


def rms_deg(angle_rad: FloatArray) -> float:
    """Return the root mean square of angles, in degrees."""
    return math.degrees(math.sqrt(float(np.mean(angle_rad**2)))) if angle_rad.size else math.nan


def rms(error: FloatArray) -> float:
    """Return the root mean square over samples and axes together."""
    return math.sqrt(float(np.mean(error**2))) if error.size else math.nan
