"""Hard iron that comes and goes: a payload is attached, a servo or a gripper holds another position."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from mavcompass.frames import FloatArray
from mavcompass.simulation.effects.effect import (
    NEVER_S,
    Effect,
    Memory,
    Misfit,
    Parameter,
    Rng,
    Signals,
    Stage,
    axes,
)

_ALWAYS = 0.98
# What lasts less is no change of the vehicle but a disturbance of a few readings.
_SHORTEST_S = 1.0


def _forward(signals: Signals, theta: FloatArray, memory: Memory, rng: Rng) -> Signals:
    time = signals.stimulus.time_s
    present = ((time >= theta[3]) & (time < theta[4])).astype(np.float64)
    return signals.with_mag(signals.reading.mag_mgauss + present[:, None] * theta[:3])


def _starts(misfit: Misfit) -> list[FloatArray]:
    """Find the best step and the best pulse by scanning cumulated residuals.

    The gain of a constant over rows a..b against the mean of the others is |S_b - S_a - f S|^2 /
    (n f (1 - f)), with S the cumulated whitened residual, whose mean is taken out, and f the fraction of
    rows inside.
    """
    rows = np.flatnonzero(misfit.rows)
    if rows.size < 20:
        return []
    time = misfit.time_s
    y = misfit.residual.mag_mgauss[rows] / misfit.sigma_mgauss
    y = y - y.mean(axis=0)
    stride = max(1, rows.size // 400)
    shortest = max(4, math.ceil(_SHORTEST_S / float(np.median(np.diff(time[rows])))))
    marks = np.arange(0, rows.size + 1, stride)
    cumulated = np.vstack([np.zeros(3), np.cumsum(y, axis=0)])[marks]
    inside = (marks[None, :] - marks[:, None]).astype(np.float64)
    gain = np.zeros_like(inside)
    with np.errstate(divide="ignore", invalid="ignore"):
        for axis in range(3):
            c = cumulated[:, axis]
            gain += (c[None, :] - c[:, None]) ** 2
        gain = np.where((inside >= shortest) & (inside < rows.size), gain / _weight(inside, rows.size), 0.0)
    coarse = [np.unravel_index(int(np.argmax(gain[1:, :-1])), gain[1:, :-1].shape)]
    picks = [(int(marks[coarse[0][0] + 1]), int(marks[coarse[0][1]]), False)]
    picks.append((int(marks[1 + int(np.argmax(gain[1:, -1]))]), rows.size, True))
    starts = []
    for first, end, to_the_end in picks:
        if end - first < shortest:
            continue
        first, end = _refine(y, first, end, stride, to_the_end, shortest)
        if end - first > _ALWAYS * rows.size:
            # Hard iron that is there all the time is no step.
            continue
        level = misfit.sigma_mgauss * y[first:end].mean(axis=0) / (1.0 - (end - first) / rows.size)
        on = _between(time, rows, first)
        off = NEVER_S if to_the_end or end >= rows.size else _between(time, rows, end)
        starts.append(np.array([*np.clip(level, -1500.0, 1500.0), on, off]))
    return starts


def _refine(
    y: FloatArray, first: int, end: int, stride: int, to_the_end: bool, shortest: int
) -> tuple[int, int]:
    """Move both ends row by row to the greatest gain, no nearer to each other than `shortest` rows."""
    cumulated = np.vstack([np.zeros(3), np.cumsum(y, axis=0)])
    reach = np.arange(-2 * stride, 2 * stride + 1)
    for _ in range(2):
        firsts = np.clip(first + reach, 0, end - shortest)
        total = cumulated[end] - cumulated[firsts]
        first = int(firsts[np.argmax((total**2).sum(axis=1) / _weight(end - firsts, len(y)))])
        if not to_the_end:
            ends = np.clip(end + reach, first + shortest, len(y))
            total = cumulated[ends] - cumulated[first]
            end = int(ends[np.argmax((total**2).sum(axis=1) / _weight(ends - first, len(y)))])
    return first, end


def _weight(inside: FloatArray | NDArray[np.int64], count: int) -> FloatArray:
    """Return n f (1 - f) of numbers of rows inside; all of them are no step."""
    return np.maximum(np.asarray(inside * (1.0 - inside / count), dtype=np.float64), 0.5)


def _between(time: FloatArray, rows: np.ndarray, index: int) -> float:
    """Return the middle between the row before and this one, among the rows that may be looked at."""
    if index == 0:
        return float(time[rows[0]])
    return 0.5 * float(time[rows[index - 1]] + time[rows[index]])


EFFECTS = (
    Effect(
        id="hard_iron_step",
        title="hard iron that comes, and perhaps goes, at one moment",
        stage=Stage.FIELD,
        parameters=(
            *axes(-1500.0, 1500.0, (80.0, 50.0, -40.0), 30.0, "mG"),
            Parameter("on_s", "s", -NEVER_S, NEVER_S, 30.0, 1.0),
            Parameter("off_s", "s", -NEVER_S, NEVER_S, NEVER_S, 1.0, optional=True),
        ),
        forward=_forward,
        aliases=("hard_iron", "relay_field", "temperature_bias"),
        separated_by="repeat the action, and log the moment",
        source="raw = field + b for on <= t < off; a magnet of 3 cm distance makes 130 mG",
        starts=_starts,
        lua="if during({on_s:.3f}, {off_s:.3f}) then add(b, {x:.6g}, {y:.6g}, {z:.6g}) end".format_map,
    ),
)
