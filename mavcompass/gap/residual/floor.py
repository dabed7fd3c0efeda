"""The floor: what is left when nothing is wrong, as noise, as figures, and as what is known beforehand.

Without a baseline it is stated: scatter between neighbouring readings, the numbers' resolution, the doubt in
attitude and times; the verdict is more careful then. And what scatters beyond it: noise, jittering times.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from mavcompass.frames import FloatArray
from mavcompass.gap.detectors.rapid import quiet_doubt, quiet_scatter
from mavcompass.gap.fit.hypothesis import Fit, Mask, least_gain
from mavcompass.gap.fit.model import Problem
from mavcompass.gap.replay.noise import (
    Noise,
    SensorNoise,
    estimate_noise,
    group_values,
    rough_sigma,
    wandering,
    white,
)
from mavcompass.gap.replay.nominal import Replay, level_mgauss
from mavcompass.gap.replay.nuisance import STATED, Prior, Trust
from mavcompass.gap.result import Cause
from mavcompass.gap.tables import Kind, usual
from mavcompass.simulation.effects import detected_by, get
from mavcompass.simulation.effects.effect import Group
from mavcompass.simulation.physics.signals import Reading


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


def first_noise(replay: Replay) -> Noise:
    """State a first noise from the scatter between neighbouring readings."""

    def stated(group: Group, error: FloatArray) -> SensorNoise:
        least = max(_least_sigma(replay, group), usual.compass.stated_mgauss if group == "mag" else 0.0)
        sigma = rough_sigma(error, replay.valid)
        return white(np.maximum(np.nan_to_num(sigma, nan=least), least))

    return _noise(replay, replay.signals.reading, stated)


def measured_noise(problem: Problem, fit: Fit) -> Noise:
    """Estimate the noise from what a fit leaves."""
    replay = problem.replay

    def estimated(group: Group, error: FloatArray) -> SensorNoise:
        channels = field_channels(replay) if group == "mag" else None
        return estimate_noise(error, replay.valid, _least_sigma(replay, group), channels)

    return _noise(replay, problem.predict(fit), estimated)


def _noise(replay: Replay, made: Reading, of: Callable[[Group, FloatArray], SensorNoise]) -> Noise:
    """Collect the noise of each sensor, of what it was measured beside what is made of it."""
    errors = {g: group_values(replay.measured, g) - group_values(made, g) for g in replay.groups}
    return {g: replay.doubtful[g] if g in replay.doubtful else of(g, errors[g]) for g in replay.groups}


def _least_sigma(replay: Replay, group: str) -> float:
    """Return the least noise that is believed: of a vehicle's own attitude no model is exact to less."""
    if group != "mag":
        return usual.compass.least[group]
    own = 0.0 if replay.reference.kind == "columns" else usual.compass.least_in_flight_mgauss
    return max(usual.compass.least[group], replay.resolution_mgauss, own)


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
    return replace(floor, noise={**floor.noise, "mag": replace(mag, sigma=mag.sigma * excess)})


def kind_of(replay: Replay, floor: Floor) -> Kind:
    """Tell how a recording is known."""
    if floor.representative:
        return "exact"
    if floor.measured:
        return "baseline"
    return "reference" if replay.reference.kind == "columns" else "alone"


def prior_of(replay: Replay, trust: Trust | None) -> Prior:
    """Return the prior of a recording's nuisances, the iron in force among them; None trusts no
    calibration."""
    return replay.prior if trust is None else replay.prior.beside(replay.iron.prior(trust))


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
    return rms((field_mgauss - other_mgauss)[rows]), math.degrees(rms(turned[rows]))


def rms(error: FloatArray) -> float:
    """Return the root mean square over samples and axes together."""
    return math.sqrt(float(np.mean(error**2))) if error.size else math.nan


def from_recording(replay: Replay) -> Floor:
    """State a floor without a baseline: scatter, the reference's slow doubt, and the doubt in the times.

    The doubt in the attitude wanders, as a first-order process of some seconds; the doubt in the times
    grows with the field's rate of change. Scatter that no data sheet allows is not the floor's.
    """
    noise = first_noise(replay)
    scatter = noise["mag"].sigma
    world = replay.signals.stimulus.field_ned_mgauss[0]
    total, level = float(np.linalg.norm(world)), level_mgauss(replay)
    doubt = max(getattr(usual.doubt, f"{replay.reference.kind}_rad"), replay.reference.tilt_sigma_rad)
    white_rms = math.sqrt(float(np.mean(scatter**2)))
    healthy = white_rms < usual.compass.worst_scatter_mgauss
    scattered = white_rms if healthy else usual.compass.scatter_mgauss
    step = float(np.median(np.diff(replay.time_s)))
    rho = math.exp(-step / usual.doubt.lasts_s)
    channels = field_channels(replay)
    # A small random rotation moves the field by doubt |B| in the two directions across it.
    across = np.full(3, math.sqrt(2.0 / 3.0)) if channels is None else np.array(usual.doubt.across)
    slow = doubt * total * across
    each = [
        wandering(np.full(3, white_rms) if channels is not None else scatter, float(v), rho) for v in slow
    ]
    sigma = np.array([one[0][c] for c, one in enumerate(each)])
    late = usual.age.doubt_telemetry_s if replay.telemetry else usual.age.doubt_direct_s
    whole = np.hypot(white_rms, slow)
    mag = SensorNoise(
        np.full((1, 3), rho),
        sigma,
        whole,
        np.inf,
        moving=np.array([one[1] for one in each]),
        channels=channels,
    )
    change = nominal_rate(replay, mag)
    mag = replace(mag, row_scale=np.sqrt(1.0 + (late * change / sigma) ** 2))
    timing = late * math.sqrt(float(np.mean(change[replay.valid] ** 2)))
    trust = STATED if replay.iron.calibrated else None
    # What a calibration usually leaves is no gap: it belongs to the floor.
    doubted = replay.iron.sigma(STATED)
    cured = 0.0 if trust is None else math.hypot(rms(doubted[:3]), rms(doubted[3:]) * total)
    return Floor(
        {**noise, "mag": mag},
        math.hypot(scattered, float(np.sqrt(np.mean(slow**2))), timing, cured),
        math.degrees(math.hypot(scattered, doubt * total, timing, cured) / level),
        np.zeros((0, 3)),
        False,
        prior_of(replay, trust),
        trust=trust,
    )


def with_predictive_variance(floor: Floor, replay: Replay, train: Mask, test: Mask) -> Floor:
    """Raise a floor by what the training rows leave unknown of the held-out ones when nothing is wrong.

    The nuisances' covariance, carried to the held-out field and heading: attitude, place and calibration are
    known there only as well as the rest of the recording tells them.
    """
    problem = Problem(replay, floor.noise, train, floor.prior)
    null = problem.null()
    if not null.covariance.size or not test.any():
        return floor
    field_more, heading_more = _unknown(problem, null, test)
    field_rest, heading_rest = _of_turns(
        replay.signals.stimulus.field_ned_mgauss[0], replay.reference.rest_rad2
    )
    return replace(
        floor,
        field_rms_mgauss=math.sqrt(floor.field_rms_mgauss**2 + field_more + field_rest),
        heading_rms_deg=math.sqrt(floor.heading_rms_deg**2 + heading_more + heading_rest),
    )


def _unknown(problem: Problem, fit: Fit, test: Mask) -> tuple[float, float]:
    """Return the mean squares of field (mG) and heading (deg) that the nuisances leave unknown."""
    rows, states = np.flatnonzero(test), problem.composition.states(fit)
    predicted = states[-1].reading.mag_mgauss
    changes = problem.composition.changes(fit, states, range(len(problem.prior.effects)))["mag"]
    changed = (predicted[:, :, None] + changes).transpose(2, 0, 1)
    heading = [heading_error_rad(problem.replay, one, predicted)[rows] for one in changed]
    field = changes[rows].reshape(3 * rows.size, -1)
    turned = np.degrees(np.stack(heading, axis=1))
    count = fit.nuisances.size
    covariance = fit.covariance[:count, :count]
    field_more, heading_more = (
        float(np.mean(np.einsum("np,pq,nq->n", J, covariance, J))) for J in (field, turned)
    )
    return field_more, heading_more


def _of_turns(field_mgauss: FloatArray, covariance_rad2: FloatArray) -> tuple[float, float]:
    """Return the mean squares of field (mG) and heading (deg) that small turns of the attitude make."""
    north, east, down = field_mgauss
    # A turn v moves the field by v x B, of which heading sees what is level and across.
    moved = np.array([[0.0, down, -east], [-down, 0.0, north], [east, -north, 0.0]])
    across = (north * moved[1] - east * moved[0]) / max(north**2 + east**2, 1.0)
    of_heading = float(across @ covariance_rad2 @ across)
    return float(np.trace(moved @ covariance_rad2 @ moved.T)) / 3.0, math.degrees(math.sqrt(of_heading)) ** 2


@dataclass(frozen=True, slots=True)
class Scatter:
    """Hold a named scatter effect, its size in single readings, and the gain of twice the log-likelihood.

    `doubt` is the size's standard deviation; 0 where it is not known.
    """

    effect: str
    size: float
    gain: float
    doubt: float = 0.0

    @property
    def cause(self) -> Cause:
        """Return it as it is named."""
        name, removes = get(self.effect).names[0], self.size if self.white else 0.0
        return Cause.detected(self.effect, {name: self.size}, {name: self.doubt}, removes)

    @property
    def white(self) -> bool:
        """Tell whether readings scatter alike all the time, and not as they change."""
        return get(self.effect).detector == "scatter"

    def on_rows_mgauss2(self, replay: Replay) -> float:
        """Return the variance of scattering readings on rows that are means of them."""
        return self.size**2 / replay.averaged


def find_scatter(
    problem: Problem, fit: Fit, allowed: frozenset[str], floor: Floor, excess_mgauss2: float = 0.0
) -> Scatter | None:
    """Compare even and rate-dependent excess scatter of the magnetometer with the floor's.

    Even excess needs a representative floor; the scatter of time stamps shows by its dependence on the
    rate of change alone, and then competes against even excess of any size. Without one, only what no data
    sheet allows is called excess; with a baseline that is not exact, what single readings scatter beyond its
    own, `excess_mgauss2`.
    """
    rows, width = problem.usable, problem.replay.averaged
    noise = problem.noise["mag"]
    error = noise.in_channels(problem.replay.measured.mag_mgauss - problem.predict(fit).mag_mgauss)
    error = (error / noise.rms)[rows]
    if noise.row_scale is not None and floor.noise["mag"].row_scale is not None:
        error = error / floor.noise["mag"].row_scale[rows]
    field = problem.signals(fit).reading.mag_mgauss
    change = noise.in_channels(np.gradient(field, problem.replay.time_s, axis=0))[rows] / noise.rms
    x = change**2
    y = error**2
    fourth = float(np.mean(y * y)) / max(float(np.mean(y)), 1e-12) ** 2
    kurtosis = max(fourth - 1.0, 2.0) / 2.0
    if np.isfinite(noise.samples):
        kurtosis *= 1.0 + len(y) / noise.samples
    # Correlation makes fewer independent squares.
    inflation = kurtosis * noise.square_inflation
    even, even_size = _even_gain(y)
    late, late_size = _late_gain(y, x)
    candidates = []
    more, late_times = detected_by("scatter").id, detected_by("jitter").id
    representative = floor.representative
    if representative and more in allowed and even_size > 0.0:
        size = math.sqrt(even_size * width * float(np.mean(noise.rms**2)))
        doubt = 0.5 * size * math.sqrt(2.0 * inflation / y.size) * (1.0 + even_size) / even_size
        candidates.append(Scatter(more, size, even / inflation, doubt))
    trusted = representative or math.sqrt(late_size) > usual.scatter.jitter_s
    late_shows = late_size * float(np.mean(x)) > usual.scatter.least_late**2
    if late_times in allowed and trusted and late_shows:
        candidates.append(Scatter(late_times, math.sqrt(late_size), late / inflation))
    if not floor.measured and more in allowed:
        sigma = quiet_scatter(problem.replay.readings)
        if sigma > usual.compass.worst_scatter_mgauss:
            size = math.sqrt(sigma**2 - usual.compass.scatter_mgauss**2)
            doubt = 0.5 * quiet_doubt(problem.replay.readings) * sigma**2 / size
            candidates.append(Scatter(more, size, float(error.size), doubt))
    # Less than the floor itself is no gap, however surely neighbours scatter.
    excess_shows = excess_mgauss2 > floor.field_rms_mgauss**2
    if floor.measured and not representative and more in allowed and excess_shows:
        left = problem.replay.measured.mag_mgauss - problem.predict(fit).mag_mgauss
        left2 = float(np.mean(left[rows] ** 2))
        # Scatter between neighbours is scatter of the readings only if it shows in what is left.
        if width > 1 or left2 - floor.field_rms_mgauss**2 > 0.5 * excess_mgauss2:
            size = math.sqrt(excess_mgauss2)
            doubt = 0.5 * quiet_doubt(problem.replay.readings) * size
            candidates.append(Scatter(more, size, float(error.size), doubt))
    candidates = [c for c in candidates if c.gain > least_gain(1, usual.scatter.trials)]
    return max(candidates, key=lambda c: c.gain) if candidates else None


def _even_gain(y: FloatArray) -> tuple[float, float]:
    mean = float(y.mean())
    return y.size * (mean - 1.0 - math.log(max(mean, 1e-12))), mean - 1.0


def _late_gain(y: FloatArray, x: FloatArray) -> tuple[float, float]:
    """Maximise the likelihood of variances 1 + a x over a; return its gain, and a."""
    best = (0.0, 0.0)
    for a in np.exp(np.linspace(math.log(1e-7), math.log(0.04), 90)).tolist():
        v = 1.0 + a * x
        best = max(best, (float(np.sum(y - y / v - np.log(v))), a))
    return best


def noise_with(problem: Problem, fit: Fit, scatter: Scatter) -> Noise:
    """Return the floor with a scatter effect added: what the simulator then makes."""
    replay = problem.replay
    error = replay.measured.mag_mgauss - problem.predict(fit).mag_mgauss
    floor = problem.noise["mag"]
    if scatter.white:
        noise = estimate_noise(error, problem.usable, replay.resolution_mgauss, floor.channels)
        return {**problem.noise, "mag": noise}
    change = floor.in_channels(np.gradient(problem.signals(fit).reading.mag_mgauss, replay.time_s, axis=0))
    scale = np.sqrt(1.0 + (scatter.size * change / floor.rms) ** 2)
    if floor.channels is not None:
        return {**problem.noise, "mag": replace(floor, row_scale=scale)}
    scaled = estimate_noise(error / scale, problem.usable, replay.resolution_mgauss)
    return {**problem.noise, "mag": replace(scaled, row_scale=scale)}
