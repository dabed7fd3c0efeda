"""Currents: motors, power lines, relays, alternating fields."""

from __future__ import annotations

import math
from collections.abc import Mapping

import numpy as np
from numpy.typing import NDArray

from mavcompass.frames import FloatArray
from mavcompass.simulation.effects.effect import Effect, Memory, Misfit, Parameter, Rng, Signals, Stage, axes
from mavcompass.simulation.effects.sampling import or_zero, spread

# Lines of rotors and mains, aliased by the sampling; what is slower is drift, and a load of its own.
SLOWEST_LINE_HZ = 0.3
_MOTORS = 8
_RELAY_SOURCES = 2 + _MOTORS
_FEWEST_SWITCHED = 8


def _motor_current(signals: Signals, theta: FloatArray, memory: Memory, rng: Rng) -> Signals:
    current = or_zero(signals.stimulus.current_a)
    return signals.with_mag(signals.reading.mag_mgauss + current[:, None] * theta)


def _per_motor(signals: Signals, theta: FloatArray, memory: Memory, rng: Rng) -> Signals:
    motors = np.abs(or_zero(signals.stimulus.motors[:, :_MOTORS]))
    return signals.with_mag(
        signals.reading.mag_mgauss + motors @ theta.reshape(_MOTORS, 3)[: motors.shape[1]]
    )


def _varying_motors(signals: Signals) -> NDArray[np.bool_]:
    free = np.zeros((_MOTORS, 3), dtype=np.bool_)
    motors = np.abs(signals.stimulus.motors[:, :_MOTORS])
    if motors.size:
        free[: motors.shape[1]] = (spread(motors) > 1e-3)[:, None]
    return free.ravel()


def _alternating(signals: Signals, theta: FloatArray, memory: Memory, rng: Rng) -> Signals:
    phase = 2.0 * math.pi * theta[6] * signals.stimulus.time_s
    waves = np.stack([np.sin(phase), np.cos(phase)], axis=1)
    return signals.with_mag(signals.reading.mag_mgauss + waves @ theta[:6].reshape(2, 3))


def _alternating_starts(misfit: Misfit) -> list[FloatArray]:
    """Find the strongest line of the residual's spectrum up to half the sampling rate."""
    rows = np.flatnonzero(misfit.rows)
    time = misfit.time_s
    if rows.size < 40:
        return []
    step = float(np.median(np.diff(time)))
    span = float(time[-1] - time[0])
    index = np.round((time[rows] - time[0]) / step).astype(np.int64)
    size = 1 << math.ceil(math.log2(4 * (index[-1] + 1)))
    y = np.zeros((size, 3))
    centred = misfit.residual.mag_mgauss[rows] / misfit.sigma_mgauss
    y[index] = centred - centred.mean(axis=0)
    power = (np.abs(np.fft.rfft(y, axis=0)) ** 2).sum(axis=1)
    frequency = np.fft.rfftfreq(size, step)
    # Slower than four cycles per recording is drift, not an alternating field.
    power[frequency < max(4.0 / span, SLOWEST_LINE_HZ)] = 0.0
    starts = []
    for _ in range(2):
        peak = int(np.argmax(power))
        if power[peak] <= 0.0:
            break
        f = float(frequency[peak])
        phase = 2.0 * math.pi * f * time[rows]
        waves = np.stack([np.sin(phase), np.cos(phase)], axis=1)
        amplitudes, *_ = np.linalg.lstsq(waves, misfit.residual.mag_mgauss[rows], rcond=None)
        starts.append(np.array([*np.clip(amplitudes.ravel(), -300.0, 300.0), max(f, 0.01)]))
        power[max(0, peak - 8) : peak + 9] = 0.0
    return starts


def _load(signals: Signals, source: int) -> FloatArray | None:
    s = signals.stimulus
    if source == 0:
        return s.throttle
    if source == 1:
        return s.current_a
    return s.motors[:, source - 2] if source - 2 < s.motors.shape[1] else None


def _relay(signals: Signals, theta: FloatArray, memory: Memory, rng: Rng) -> Signals:
    load = _load(signals, round(float(theta[3])))
    if load is None:
        return signals
    on = (or_zero(load) > theta[4]).astype(np.float64)
    return signals.with_mag(signals.reading.mag_mgauss + on[:, None] * theta[:3])


def _relay_starts(misfit: Misfit) -> list[FloatArray]:
    """Try every recorded load with the threshold that fits best; keep the best two.

    Of rows sorted by the load, those above a threshold are a tail: the gain of a constant on the last k
    of n, against the mean of the others, is |their sum|^2 / (k (1 - k / n)), once the mean of all is taken
    out.
    """
    y = misfit.residual.mag_mgauss[misfit.rows] / misfit.sigma_mgauss
    y = y - y.mean(axis=0)
    if len(y) < 4 * _FEWEST_SWITCHED:
        return []
    found: list[tuple[float, FloatArray]] = []
    for source in range(_RELAY_SOURCES):
        load = _load(misfit.signals, source)
        if load is None or float(spread(load)) <= 1e-3:
            continue
        known = or_zero(load)[misfit.rows]
        order = np.argsort(-known, kind="stable")
        known, total = known[order], np.cumsum(y[order], axis=0)
        count = np.arange(1, known.size + 1)
        weight = count * (1.0 - count / known.size)
        gain = (total**2).sum(axis=1) / np.maximum(weight, 0.5)
        # A threshold lies between two loads that differ, with readings enough on both sides.
        gain[:-1][known[:-1] <= known[1:]] = 0.0
        gain[:_FEWEST_SWITCHED] = 0.0
        gain[-_FEWEST_SWITCHED:] = 0.0
        best = int(np.argmax(gain))
        if gain[best] > 0.0:
            field = total[best] / weight[best] * misfit.sigma_mgauss
            threshold = 0.5 * (known[best] + known[best + 1])
            found.append((float(gain[best]), np.array([*field, float(source), threshold])))
    found.sort(key=lambda item: -item[0])
    return [start for _, start in found[:2]]


def _motors_script(values: Mapping[str, float]) -> str:
    fields = {m + 1: [values[f"motor{m + 1}_{a}"] for a in "xyz"] for m in range(_MOTORS)}
    each = (
        f"do local m = motor({number}); add(b, {', '.join(f'm * {one:.6g}' for one in field)}) end"
        for number, field in fields.items()
        if any(field)
    )
    return "\n    ".join(each)


def _relay_script(values: Mapping[str, float]) -> str | None:
    source = round(values["source"])
    load = "(battery:current_amps(0) or 0)" if source == 1 else f"motor({source - 1})"
    text = f"if {load} > {{threshold:.6g}} then add(b, {{x:.6g}}, {{y:.6g}}, {{z:.6g}}) end"
    # A script is not told the throttle.
    return text.format_map(values) if source else None


EFFECTS = (
    Effect(
        id="motor_current",
        title="the field of the battery current",
        stage=Stage.FIELD,
        parameters=axes(-50.0, 50.0, (2.0, -1.5, 1.0), 0.5, "mG/A"),
        forward=_motor_current,
        needs=frozenset({"current"}),
        aliases=("per_motor", "vibration_rectification", "hard_iron"),
        separated_by="throttle pulses at a fixed attitude",
        source="raw = field + c I; 0.2 to 5 mG/A",
        sitl=lambda v: {f"SIM_MAG_MOT_{a.upper()}": v[a] for a in "xyz"},
    ),
    Effect(
        id="per_motor",
        title="the field of each motor's current",
        stage=Stage.FIELD,
        parameters=tuple(
            Parameter(f"motor{m + 1}_{a}", "mG", -500.0, 500.0, 20.0 * math.cos(1.3 * m + i), 20.0)
            for m in range(_MOTORS)
            for i, a in enumerate("xyz")
        ),
        forward=_per_motor,
        needs=frozenset({"motors"}),
        aliases=("motor_current",),
        separated_by="run the motors one by one",
        source="raw = field + sum of c_i |u_i|, u the motor output; ArduPilot's per-motor compensation",
        free=_varying_motors,
        lua=_motors_script,
    ),
    Effect(
        id="ac_interference",
        detector="line",
        title="an alternating field, aliased by the sampling",
        stage=Stage.FIELD,
        parameters=(
            *axes(-300.0, 300.0, (12.0, 4.0, -6.0), 5.0, "mG", ("sin_x", "sin_y", "sin_z")),
            *axes(-300.0, 300.0, (0.0, 8.0, 3.0), 5.0, "mG", ("cos_x", "cos_y", "cos_z")),
            Parameter("frequency_hz", "Hz", SLOWEST_LINE_HZ, 2000.0, 2.3, 0.001),
        ),
        forward=_alternating,
        aliases=("timestamp_jitter",),
        separated_by="record at two sampling rates, and log the rotor speed",
        source="raw = field + A sin(2 pi f t), 1 to 50 mG",
        starts=_alternating_starts,
    ),
    Effect(
        id="relay_field",
        title="the field of something that is switched",
        stage=Stage.FIELD,
        parameters=(
            *axes(-500.0, 500.0, (25.0, -15.0, 10.0), 10.0, "mG"),
            Parameter("source", "0 throttle, 1 current, 2.. motor", 0.0, 9.0, 0.0, 1.0, integer=True),
            Parameter("threshold", "of the source", -1e3, 1e3, 0.5, 0.0),
        ),
        forward=_relay,
        needs=frozenset({"throttle|current|motors"}),
        aliases=("hard_iron_step", "motor_current"),
        separated_by="log the switch's output",
        source="raw = field + b while the load is above a threshold, 2 to 50 mG",
        starts=_relay_starts,
        lua=_relay_script,
    ),
)
