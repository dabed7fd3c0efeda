"""Time: the reading is late, smoothed, stamped wrongly, or the one before."""

from __future__ import annotations

from functools import lru_cache

import numpy as np

from mavcompass.frames import FloatArray, cross, rotate_back
from mavcompass.simulation.effects.effect import Effect, Memory, Misfit, Parameter, Rng, Signals, Stage
from mavcompass.simulation.effects.sampling import at_times, central_differences, first_order_lag
from mavcompass.simulation.physics.signals import Stimulus

LONGEST_LAG_S = 0.5
# A direction of the field is told where it holds more than this share of its square.
_UNTOLD = 1e-4
# Any matrix will do, so that some of the readings are enough for it.
_ENOUGH = 100
# Times, readings, the world's field in the body's axes and its slopes, as far as they are remembered.
_Past = tuple[FloatArray, ...]


def late_field(signals: Signals, wanted_s: FloatArray, memory: Memory | None = None) -> FloatArray:
    """Return the reading at other times, (M, 3), mG.

    The world's field turns with the vehicle, which may turn faster than the readings follow each other: its
    slopes come from the body's rate. What readings are of it by a matrix that holds for all of them (iron, a
    compass that is mounted in another way) turns as it does; the slopes of the rest come from its neighbours.
    """
    world, turning = _turning(signals.stimulus)
    parts: _Past = (signals.stimulus.time_s, signals.reading.mag_mgauss, world, turning)
    if memory is not None:
        past: _Past | None = memory.get("past")
        if past is not None:
            parts = tuple(np.concatenate([a, b]) for a, b in zip(past, parts, strict=True))
        keep = int(np.searchsorted(parts[0], parts[0][-1] - LONGEST_LAG_S - 0.1))
        first = min(keep, max(parts[0].size - 4, 0))
        memory["past"] = tuple(part[first:] for part in parts)
    time, field, world, turning = parts
    slopes = turning + slopes_beside(time, world, turning, field - world)
    return at_times(time, field, wanted_s, slopes)


@lru_cache(maxsize=1)
def _turning(s: Stimulus) -> tuple[FloatArray, FloatArray]:
    """Return the world's field in the body's axes and its slopes, (N, 3) each.

    Derivatives ask again and again in one state of the world.
    """
    world = rotate_back(s.rotation, s.field_ned_mgauss)
    turning = cross(world, s.rate_radps)
    if (s.field_ned_mgauss != s.field_ned_mgauss[0]).any():
        turning += rotate_back(s.rotation, central_differences(s.time_s, s.field_ned_mgauss))
    return world, turning


def slopes_beside(
    time_s: FloatArray, world: FloatArray, turning: FloatArray, columns: FloatArray
) -> FloatArray:
    """Return the slopes of columns (N, k) beside the world's field in the body's axes and its slopes, (N, 3).

    What they are of it, by a matrix that holds for all rows and beside an offset, turns as it does.
    """
    some = slice(None, None, max(len(world) // _ENOUGH, 1))
    varies = world[some] - world[some].mean(axis=0)
    least = _UNTOLD * float(np.sum(world[some] ** 2)) + 1e-9
    matrix = np.linalg.solve(varies.T @ varies + least * np.eye(3), varies.T @ columns[some])
    return np.asarray(turning @ matrix + central_differences(time_s, columns - world @ matrix))


def _lag(signals: Signals, theta: FloatArray, memory: Memory, rng: Rng) -> Signals:
    return signals.with_mag(late_field(signals, signals.stimulus.time_s - theta[0], memory))


def _low_pass(signals: Signals, theta: FloatArray, memory: Memory, rng: Rng) -> Signals:
    time, field = signals.stimulus.time_s, signals.reading.mag_mgauss
    smoothed, memory["state"] = first_order_lag(time, field, float(theta[0]), memory.get("state"))
    return signals.with_mag(smoothed)


def _jitter(signals: Signals, theta: FloatArray, memory: Memory, rng: Rng) -> Signals:
    if rng is None:
        return signals
    time = signals.stimulus.time_s
    # A reading can only be older than its stamp says: the scatter is folded to one side of its mean.
    error = theta[0] * rng.standard_normal(time.size) + 2.0 * theta[0]
    late = np.clip(error, 0.0, LONGEST_LAG_S) - 2.0 * theta[0]
    return signals.with_mag(late_field(signals, np.minimum(time - late, time[-1]), memory))


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
