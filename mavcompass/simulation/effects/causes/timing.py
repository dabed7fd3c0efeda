"""Time: the reading is late, smoothed, stamped wrongly, or the one before."""

from __future__ import annotations

import numpy as np

from mavcompass.frames import FloatArray
from mavcompass.simulation.effects.effect import Effect, Memory, Misfit, Parameter, Rng, Signals, Stage
from mavcompass.simulation.effects.sampling import at_times, first_order_lag

LONGEST_LAG_S = 0.5


def _with_past(signals: Signals, memory: Memory) -> tuple[FloatArray, FloatArray, int]:
    """Put what is remembered before the block; return times, field and the length of the past."""
    time, field = signals.stimulus.time_s, signals.reading.mag_mgauss
    past = memory.get("past")
    if past is not None:
        time, field = np.concatenate([past[0], time]), np.concatenate([past[1], field])
    keep = np.searchsorted(time, time[-1] - LONGEST_LAG_S - 0.1)
    first = min(int(keep), max(time.size - 4, 0))
    memory["past"] = (time[first:], field[first:])
    return time, field, time.size - signals.stimulus.time_s.size


def _lag(signals: Signals, theta: FloatArray, memory: Memory, rng: Rng) -> Signals:
    time, field, past = _with_past(signals, memory)
    return signals.with_mag(at_times(time, field, time[past:] - theta[0]))


def _low_pass(signals: Signals, theta: FloatArray, memory: Memory, rng: Rng) -> Signals:
    time, field = signals.stimulus.time_s, signals.reading.mag_mgauss
    smoothed, memory["state"] = first_order_lag(time, field, float(theta[0]), memory.get("state"))
    return signals.with_mag(smoothed)


def _jitter(signals: Signals, theta: FloatArray, memory: Memory, rng: Rng) -> Signals:
    if rng is None:
        return signals
    time, field, past = _with_past(signals, memory)
    # A reading can only be older than its stamp says: the scatter is folded to one side of its mean.
    error = theta[0] * rng.standard_normal(time.size - past) + 2.0 * theta[0]
    late = np.clip(error, 0.0, LONGEST_LAG_S) - 2.0 * theta[0]
    return signals.with_mag(at_times(time, field, np.minimum(time[past:] - late, time[-1])))


def _stale(signals: Signals, theta: FloatArray, memory: Memory, rng: Rng) -> Signals:
    if rng is None:
        return signals
    field = signals.reading.mag_mgauss
    fresh = rng.random(len(field)) >= theta[0]
    if "held" not in memory:
        fresh[:1] = True
    source = np.maximum.accumulate(np.where(fresh, np.arange(len(field)), -1))
    held = np.where((source >= 0)[:, None], field[source], memory.get("held", 0.0))
    memory["held"] = held[-1]
    return signals.with_mag(held)


def _time_starts(misfit: Misfit) -> list[FloatArray]:
    """Project the residual on minus the field's derivative; add a short and a long guess."""
    time, field = misfit.time_s, misfit.signals.reading.mag_mgauss
    slope = -np.gradient(field, time, axis=0)[misfit.rows]
    y = misfit.residual.mag_mgauss[misfit.rows]
    power = float((slope**2).sum())
    guess = float((slope * y).sum()) / power if power > 0.0 else 0.0
    return [np.array([value]) for value in {min(max(guess, 0.003), 0.4), 0.1}]


EFFECTS = (
    Effect(
        id="transport_lag",
        title="the reading is late",
        stage=Stage.TIMING,
        parameters=(Parameter("lag_s", "s", 0.0, LONGEST_LAG_S, 0.06, 0.01),),
        forward=_lag,
        needs=frozenset({"turning"}),
        aliases=("low_pass", "eddy_current"),
        separated_by="spins at two or more rates",
        source="raw(t) = field(t - tau), 5 to 150 ms",
        starts=_time_starts,
        sitl=lambda values: {"SIM_MAG_DELAY": float(round(1000.0 * values["lag_s"]))},
    ),
    Effect(
        id="low_pass",
        title="the reading is smoothed by a first-order low pass",
        stage=Stage.TIMING,
        parameters=(Parameter("time_constant_s", "s", 0.001, LONGEST_LAG_S, 0.08, 0.01),),
        forward=_low_pass,
        needs=frozenset({"turning"}),
        aliases=("transport_lag", "eddy_current"),
        separated_by="fast oscillation near the corner frequency",
        source="tau dy/dt + y = field, 5 to 200 ms",
        starts=_time_starts,
    ),
    Effect(
        id="timestamp_jitter",
        title="the time stamps scatter",
        stage=Stage.TIMING,
        parameters=(Parameter("sigma_s", "s", 0.0, 0.2, 0.01, 0.005),),
        forward=_jitter,
        kind="random",
        needs=frozenset({"turning"}),
        aliases=("noise_excess", "ac_interference"),
        separated_by="compare the scatter at rest with that of fast turns",
        source="raw(t) = field(t - e), e normal; 1 to 20 ms",
    ),
    Effect(
        id="stale_samples",
        title="readings are repeated",
        stage=Stage.SENSOR,
        parameters=(Parameter("fraction", "1", 0.0, 0.95, 0.2, 0.05),),
        forward=_stale,
        kind="integrity",
        aliases=("transport_lag",),
        separated_by="nothing is needed: equal numbers in a row tell",
        source="with probability p the reading before is given again; 0.1 to 10 %",
    ),
)
