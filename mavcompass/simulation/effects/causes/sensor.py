"""The sensor's electronics: limits, steps, noise, drift, hysteresis, cross-axis response, toggling."""

from __future__ import annotations

import math

import numpy as np

from mavcompass.frames import FloatArray
from mavcompass.simulation.effects.effect import (
    Effect,
    Memory,
    Misfit,
    Parameter,
    Rng,
    Signals,
    Stage,
    axes,
    on_iron,
    on_mag,
)

_FULL_SCALE_MGAUSS = 1000.0
_NEXT = ((0, 1), (0, 2), (1, 0), (1, 2), (2, 0), (2, 1))


def _clipping_starts(misfit: Misfit) -> list[FloatArray]:
    measured = (misfit.signals.reading.mag_mgauss + misfit.residual.mag_mgauss)[misfit.rows]
    top = float(np.abs(measured).max()) if measured.size else 0.0
    return [np.array([max(level, 1.0)]) for level in (top, 0.97 * top, 0.9 * top)]


def _noise(signals: Signals, theta: FloatArray, memory: Memory, rng: Rng) -> Signals:
    field = signals.reading.mag_mgauss
    return signals if rng is None else signals.with_mag(field + theta[0] * rng.standard_normal(field.shape))


def _random_walk(signals: Signals, theta: FloatArray, memory: Memory, rng: Rng) -> Signals:
    if rng is None:
        return signals
    time = signals.stimulus.time_s
    last_time, last = memory.get("state", (time[0], np.zeros(3)))
    step = np.sqrt(np.maximum(np.diff(time, prepend=last_time), 0.0))
    walk = last + np.cumsum(theta[0] * step[:, None] * rng.standard_normal((time.size, 3)), axis=0)
    memory["state"] = (time[-1], walk[-1])
    return signals.with_mag(signals.reading.mag_mgauss + walk)


def _hysteresis(signals: Signals, theta: FloatArray, memory: Memory, rng: Rng) -> Signals:
    field = signals.reading.mag_mgauss
    remanence, width = float(theta[0]), max(float(theta[1]), 1e-6)
    play = _play(field, width, memory.get("held", field[0]))
    memory["held"] = play[-1]
    return signals.with_mag(field + remanence / width * (play - field))


def _play(field: FloatArray, width: float, held: FloatArray) -> FloatArray:
    """Return the play operator p_k = min(max(p_(k-1), m_k - w), m_k + w) of columns (N, 3).

    Each step is a clamp; clamps compose to clamps, so that doubling the reach gives all N in log2 N passes.
    """
    low, high = field - width, field + width
    reach = 1
    while reach < len(field):
        earlier_low, earlier_high = low[:-reach].copy(), high[:-reach].copy()
        low[reach:], high[reach:] = (
            np.minimum(np.maximum(earlier_low, low[reach:]), high[reach:]),
            np.minimum(np.maximum(earlier_high, low[reach:]), high[reach:]),
        )
        reach *= 2
    return np.asarray(np.minimum(np.maximum(held, low), high))


def _hysteresis_starts(misfit: Misfit) -> list[FloatArray]:
    starts = []
    for width in (15.0, 60.0, 200.0):
        moved = _hysteresis(misfit.signals, np.array([1.0, width]), {}, None).reading.mag_mgauss
        shape = (moved - misfit.signals.reading.mag_mgauss)[misfit.rows]
        power = float((shape**2).sum())
        if power > 0.0:
            size = float((shape * misfit.residual.mag_mgauss[misfit.rows]).sum()) / power
            starts.append(np.array([float(np.clip(size, -100.0, 100.0)), width]))
    return starts


def _cross_axis(signals: Signals, theta: FloatArray, memory: Memory, rng: Rng) -> Signals:
    field = signals.reading.mag_mgauss
    out = field.copy()
    for value, (axis, other) in zip(theta[:6], _NEXT, strict=True):
        if value != 0.0:
            out[:, axis] += value / _FULL_SCALE_MGAUSS * field[:, axis] * field[:, other]
    return signals.with_mag(out)


def _toggle(signals: Signals, theta: FloatArray, memory: Memory, rng: Rng) -> Signals:
    count = memory.get("count", 0)
    n = len(signals.reading.mag_mgauss)
    memory["count"] = count + n
    sign = 1.0 - 2.0 * ((count + np.arange(n)) % 2)
    return signals.with_mag(signals.reading.mag_mgauss + sign[:, None] * theta)


EFFECTS = (
    Effect(
        id="clipping",
        title="the sensor saturates",
        stage=Stage.SENSOR,
        parameters=(Parameter("limit_mgauss", "mG", 1.0, 20000.0, 400.0, 5.0),),
        forward=on_mag(lambda field, theta: np.clip(field, -theta[0], theta[0])),
        needs=frozenset({"limit"}),
        aliases=("axis_scale", "hard_iron"),
        separated_by="turn through more attitudes: plateaus show",
        source="raw = clip(field, -L, L)",
        starts=_clipping_starts,
    ),
    Effect(
        id="quantisation",
        detector="steps",
        title="coarse steps of the numbers",
        stage=Stage.SENSOR,
        parameters=(Parameter("step_mgauss", "mG", 0.01, 100.0, 4.0, 1.0),),
        forward=on_mag(lambda field, theta: np.round(field / theta[0]) * theta[0]),
        kind="integrity",
        aliases=("noise_excess",),
        separated_by="nothing is needed: the lattice of the numbers tells",
        source="raw = q round(field / q); IST8310 3 mG per step, RM3100 0.13 mG",
    ),
    Effect(
        id="noise_excess",
        detector="scatter",
        title="more noise than the floor",
        stage=Stage.SENSOR,
        parameters=(Parameter("sigma_mgauss", "mG", 0.0, 200.0, 6.0, 2.0),),
        forward=_noise,
        kind="random",
        aliases=("timestamp_jitter", "ac_interference"),
        separated_by="a still recording beside a moving one",
        source="raw = field + n; HMC5883L and QMC5883L about 2 mG, IST8310 3 mG",
        # Evenly spread between -1 and 1, and ten of these are averaged.
        sitl=lambda values: {"SIM_MAG_RND": values["sigma_mgauss"] * math.sqrt(3.0 * 10.0)},
    ),
    Effect(
        id="bias_random_walk",
        detector="drift",
        title="an offset that wanders",
        stage=Stage.FIELD,
        parameters=(Parameter("sigma_mgauss_per_sqrt_s", "mG/sqrt(s)", 0.0, 20.0, 0.8, 0.3),),
        forward=_random_walk,
        kind="random",
        aliases=("temperature_bias", "hard_iron_step"),
        separated_by="a long still recording; it can eat any slow cause, so it is never named as one",
        source="raw = field + integral of white noise, 0.1 to 2 mG/sqrt(s)",
    ),
    Effect(
        id="hysteresis",
        title="iron that remembers where the field came from",
        stage=Stage.HULL,
        parameters=(
            Parameter("remanence_mgauss", "mG", -100.0, 100.0, 8.0, 3.0),
            Parameter("width_mgauss", "mG", 2.0, 1000.0, 60.0, 20.0),
        ),
        forward=_hysteresis,
        needs=frozenset({"turning"}),
        aliases=("transport_lag", "eddy_current"),
        separated_by="go the same way forth and back, slowly and fast",
        source="the play operator per axis, raw = field + r (play - field) / w; 0.5 to 20 mG",
        starts=_hysteresis_starts,
    ),
    Effect(
        id="cross_axis",
        title="the gain of an axis depends on the field across it",
        stage=Stage.MATRIX,
        parameters=(
            *axes(
                -0.2,
                0.2,
                (0.03, -0.02, 0.02, 0.025, -0.03, 0.015),
                0.01,
                "1 at 1 G",
                ["xyz"[i] + "xyz"[j] for i, j in _NEXT],
            ),
            on_iron(False),
        ),
        forward=_cross_axis,
        needs=frozenset({"turning", "tilt"}),
        aliases=("soft_iron",),
        separated_by="tumble, better in a stronger field",
        source="raw_i = m_i (1 + sum of c_ij m_j / 1 G), magnetoresistive sensors; HMC1053 +/-3 %",
    ),
    Effect(
        id="set_reset_offset",
        detector="alternation",
        title="an offset that changes sign with every reading",
        stage=Stage.FIELD,
        parameters=axes(-200.0, 200.0, (6.0, -4.0, 5.0), 3.0, "mG"),
        forward=_toggle,
        aliases=("quantisation", "ac_interference"),
        separated_by="record every reading, with the toggling on and off",
        source="raw = field +/- b, the bridge's offset under set and reset pulses; 1 to 20 mG",
    ),
)
