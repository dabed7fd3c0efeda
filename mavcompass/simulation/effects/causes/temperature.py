"""Temperature: the sensor's offset and its gain follow it."""

from __future__ import annotations

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
)
from mavcompass.simulation.effects.sampling import or_zero

_REFERENCE = Parameter("reference_degc", "degC", -40.0, 85.0, 25.0, 2.0)
_ROOM_DEGC, _NEAR_DEGC = 25.0, 5.0


def _bias(signals: Signals, theta: FloatArray, memory: Memory, rng: Rng) -> Signals:
    above = or_zero(signals.stimulus.temperature_degc - theta[3])
    return signals.with_mag(signals.reading.mag_mgauss + above[:, None] * theta[:3])


def _sensitivity(signals: Signals, theta: FloatArray, memory: Memory, rng: Rng) -> Signals:
    above = or_zero(signals.stimulus.temperature_degc - theta[3])
    return signals.with_mag(signals.reading.mag_mgauss * (1.0 + above[:, None] * theta[:3]))


def _starts(misfit: Misfit, carrier: FloatArray, limit: float) -> list[FloatArray]:
    """Fit slope and intercept per axis; the reference is where the fitted lines come nearest to zero."""
    rows = misfit.rows
    temperature = or_zero(misfit.signals.stimulus.temperature_degc[rows])
    middle = float(temperature.mean())
    y, c = misfit.residual.mag_mgauss[rows], carrier[rows]
    design = np.stack([c * (temperature - middle)[:, None], c], axis=2)
    slope, level = np.empty(3), np.empty(3)
    for axis in range(3):
        (slope[axis], level[axis]), *_ = np.linalg.lstsq(design[:, axis], y[:, axis], rcond=None)
    weight = float(slope @ slope)
    crossing = middle - float(slope @ level) / weight if weight > 0.0 else middle
    references = [float(np.clip(crossing, -40.0, 85.0)), float(temperature[0])]
    return [np.array([*np.clip(slope, -limit, limit), reference]) for reference in references]


def _sensitivity_starts(misfit: Misfit) -> list[FloatArray]:
    return [np.append(start, 0.0) for start in _starts(misfit, misfit.signals.reading.mag_mgauss, 0.01)]


def _limits(signals: Signals) -> tuple[FloatArray, FloatArray]:
    """Keep the reference near the recorded temperatures or at room temperature.

    Far from both, what follows the temperature is hardly more than a constant, which has its own name.
    """
    low, high = np.full(4, -np.inf), np.full(4, np.inf)
    temperature = signals.stimulus.temperature_degc
    finite = temperature[np.isfinite(temperature)]
    if finite.size:
        span = max(float(np.ptp(finite)), _NEAR_DEGC)
        low[3] = min(float(finite.min()) - span, _ROOM_DEGC)
        high[3] = max(float(finite.max()) + span, _ROOM_DEGC)
    return low, high


def _sensitivity_limits(signals: Signals) -> tuple[FloatArray, FloatArray]:
    low, high = _limits(signals)
    return np.append(low, 0.0), np.append(high, 1.0)


EFFECTS = (
    Effect(
        id="temperature_bias",
        title="an offset that follows the temperature",
        stage=Stage.FIELD,
        parameters=(*axes(-10.0, 10.0, (0.8, -0.5, 1.2), 0.3, "mG/degC"), _REFERENCE),
        forward=_bias,
        needs=frozenset({"temperature"}),
        aliases=("hard_iron_step", "bias_random_walk", "hard_iron"),
        separated_by="warm up and cool down again",
        source="raw = field + k (T - T0), 0.1 to 2 mG/degC",
        starts=lambda misfit: _starts(misfit, np.ones_like(misfit.residual.mag_mgauss), 10.0),
        limits=_limits,
        lua=(
            "local above = baro:get_temperature() - {reference_degc:.3f}\n"
            "    add(b, above * {x:.6g}, above * {y:.6g}, above * {z:.6g})"
        ).format_map,
    ),
    Effect(
        id="temperature_sensitivity",
        title="a gain that follows the temperature",
        stage=Stage.MATRIX,
        parameters=(
            *axes(-0.02, 0.02, (-0.0027, -0.0027, -0.0027), 0.001, "1/degC"),
            _REFERENCE,
            on_iron(False),
        ),
        forward=_sensitivity,
        needs=frozenset({"temperature"}),
        aliases=("field_intensity", "axis_scale"),
        separated_by="warm up and cool down while tumbling",
        source="raw = (1 + a (T - T0)) field; HMC1053: -2700 ppm/degC",
        starts=_sensitivity_starts,
        limits=_sensitivity_limits,
    ),
)
