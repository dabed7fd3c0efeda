"""Eddy currents in a conducting hull."""

from __future__ import annotations

import numpy as np

from mavcompass.frames import FloatArray, cross
from mavcompass.simulation.effects.effect import Effect, Memory, Rng, Signals, Stage, axes


def _eddy(signals: Signals, theta: FloatArray, memory: Memory, rng: Rng) -> Signals:
    field = signals.reading.mag_mgauss
    xx, yy, zz, xy, xz, yz = theta
    # What is induced in a symmetric body is symmetric; a single loop's is its normal times its normal.
    times = np.array([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]])
    # In a uniform world field the body field changes by its rotation alone: dm/dt = m x w.
    return signals.with_mag(field - cross(field, signals.stimulus.rate_radps) @ times)


EFFECTS = (
    Effect(
        id="eddy_current",
        title="eddy currents in a metal hull oppose changes of the field",
        stage=Stage.HULL,
        parameters=(
            *axes(0.0, 0.3, (0.02, 0.008, 0.03), 0.005, "s"),
            *axes(-0.3, 0.3, (0.0, 0.0, 0.0), 0.005, "s", ("xy", "xz", "yz")),
        ),
        forward=_eddy,
        needs=frozenset({"turning"}),
        aliases=("transport_lag", "low_pass", "hysteresis"),
        separated_by="turns about several axes: a lag is the same about all",
        source="raw = m - T dm/dt, T symmetric: times of the body axes and between them, 1 to 50 ms",
    ),
)
