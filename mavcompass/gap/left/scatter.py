"""Effects that do not shift readings but scatter them: more noise, jittering time stamps."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np

from mavcompass.frames import FloatArray
from mavcompass.gap.fit.hypothesis import Fit, least_gain
from mavcompass.gap.fit.model import Problem
from mavcompass.gap.left.floor import Floor
from mavcompass.gap.replay.noise import Noise, estimate_noise
from mavcompass.gap.replay.nominal import Replay
from mavcompass.gap.result import Cause
from mavcompass.gap.tables import usual
from mavcompass.gap.traces.rapid import quiet_doubt, quiet_scatter
from mavcompass.simulation.effects import detected_by, get


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
        return Cause.told(self.effect, {name: self.size}, {name: self.doubt}, removes)

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
