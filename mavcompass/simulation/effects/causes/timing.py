"""Time: the reading is late, smoothed, stamped wrongly, or the one before."""

from __future__ import annotations

from functools import lru_cache

import numpy as np

from mavcompass.frames import FloatArray, rotate_back
from mavcompass.simulation.effects.effect import Effect, Memory, Misfit, Parameter, Rng, Signals, Stage
from mavcompass.simulation.effects.sampling import at_times, first_order_lag, rotation_at
from mavcompass.simulation.physics.signals import RecordedStimulus, Turning

LONGEST_LAG_S = 0.5
# A direction of the field is told where it holds more than this share of its square.
_UNTOLD = 1e-5
# Times, readings, rotations, the world's field and rates, as far as they are remembered.
_Past = tuple[FloatArray, ...]


def late_field(
    signals: Signals, wanted_s: FloatArray, memory: Memory | None = None, time_constant_s: float = 0.0
) -> FloatArray:
    """Return the reading at other times, (M, 3), mG; of a recording also as a first-order low pass has it.

    The world's field turns with the vehicle, which may turn faster than the readings follow each other. What
    readings are of it by a matrix that holds for all of them (iron, a compass that is mounted in another way)
    turns as it does; the rest is interpolated.
    """
    s = signals.stimulus
    parts: _Past = (s.time_s, signals.reading.mag_mgauss, s.rotation, s.field_ned_mgauss, s.rate_radps)
    if memory is not None:
        past: _Past | None = memory.get("past")
        if past is not None:
            parts = tuple(np.concatenate([a, b]) for a, b in zip(past, parts, strict=True))
        keep = int(np.searchsorted(parts[0], parts[0][-1] - LONGEST_LAG_S - 0.1))
        first = min(keep, max(parts[0].size - 4, 0))
        memory["past"] = tuple(part[first:] for part in parts)
    time, field, rotation, field_ned, rate = parts
    late_ned = field_ned[: wanted_s.size]
    if (field_ned != field_ned[0]).any():
        late_ned = late(time, field_ned, wanted_s, time_constant_s)
    if isinstance(s, RecordedStimulus):
        since = turned_since(s.turning, wanted_s, time_constant_s)
        then = rotate_back(since, rotate_back(rotation, late_ned))
    else:
        then = rotate_back(rotation_at(Turning(time, rotation, rate, rotation), wanted_s), late_ned)
    world = rotate_back(rotation, field_ned)
    return then + late_beside(time, world, then, field - world, wanted_s, time_constant_s)


def late_beside(
    time_s: FloatArray,
    world: FloatArray,
    then: FloatArray,
    columns: FloatArray,
    wanted_s: FloatArray,
    time_constant_s: float = 0.0,
) -> FloatArray:
    """Return columns (N, k) at other times, beside the world's field in the body's axes now and then."""
    follows = followed(world, columns)
    return np.asarray(then @ follows + late(time_s, columns - world @ follows, wanted_s, time_constant_s))


def late(
    time_s: FloatArray, columns: FloatArray, wanted_s: FloatArray, time_constant_s: float = 0.0
) -> FloatArray:
    """Return columns (N, k) at other times, interpolated, and as a first-order low pass has them."""
    columns = at_times(time_s, columns, wanted_s)
    return first_order_lag(wanted_s, columns, time_constant_s)[0] if time_constant_s else columns


def turned_since(turning: Turning, wanted_s: FloatArray, time_constant_s: float = 0.0) -> FloatArray:
    """Return the turns (N, 3, 3) of the body from other times to those of the samples, or their mean as a
    first-order low pass weighs it.

    Whatever the attitude is off by at a sample, it is off by just before.
    """
    return _turned_since(turning, wanted_s.tobytes(), time_constant_s)


@lru_cache(maxsize=4)
def _turned_since(turning: Turning, wanted: bytes, time_constant_s: float) -> FloatArray:
    """Do so once for a prediction and all of its derivatives."""
    then = rotation_at(turning, np.frombuffer(wanted), time_constant_s)
    return turning.at_samples.transpose(0, 2, 1) @ then


def followed(world: FloatArray, columns: FloatArray) -> FloatArray:
    """Return by which matrix (3, k) columns (N, k) follow the world's field in the body's axes (N, 3).

    It holds for all rows, beside an offset.
    """
    varies = world - np.ones(len(world)) @ world / len(world)
    least = _UNTOLD * float(np.vdot(world, world)) + 1e-9
    return np.asarray(np.linalg.solve(varies.T @ varies + least * np.eye(3), varies.T @ columns))


def _lag(signals: Signals, theta: FloatArray, memory: Memory, rng: Rng) -> Signals:
    return signals.with_mag(late_field(signals, signals.stimulus.time_s - theta[0], memory))


def low_pass(signals: Signals, theta: FloatArray, memory: Memory, rng: Rng) -> Signals:
    """Return the readings as a first-order low pass with a time constant in seconds, (1,), has them."""
    time, field = signals.stimulus.time_s, signals.reading.mag_mgauss
    if isinstance(signals.stimulus, RecordedStimulus):
        return signals.with_mag(late_field(signals, time, time_constant_s=float(theta[0])))
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
        forward=low_pass,
        needs=frozenset({"turning"}),
        aliases=("transport_lag", "eddy_current"),
        separated_by="fast oscillation near the corner frequency",
        source="tau dy/dt + y = field, 5 to 200 ms",
        starts=_time_starts,
    ),
    Effect(
        id="timestamp_jitter",
        detector="jitter",
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
        detector="repeats",
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
