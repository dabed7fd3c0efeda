"""Every reading of a compass before any averaging: beside its nominal one, repeated, in coarse steps."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from mavcompass.frames import FloatArray
from mavcompass.gap.attitude.kinematics import integral
from mavcompass.gap.tables import usual
from mavcompass.track import Series

_BIN_MGAUSS, _MOST_BINS = 0.25, 1 << 18


@dataclass(frozen=True, slots=True, eq=False)
class Trace:
    """Hold what the numbers show.

    `stale_share` is the share of repeats, `stale` which rows repeat, `held_s` how long each fresh reading
    stayed from `fresh_s` on, `jump_mgauss` by how much the next one differs on the axis where it does most
    (inf of the last one), `turned_rad` how far the gyro turned meanwhile (inf where there is none, 0
    of what stayed for an instant only), `step_mgauss` the step of the numbers (0: none seen).
    """

    stale_share: float
    stale: NDArray[np.bool_]
    held_s: FloatArray
    fresh_s: FloatArray
    jump_mgauss: FloatArray
    turned_rad: FloatArray
    step_mgauss: float

    @property
    def froze(self) -> bool:
        """Tell whether a reading stayed while a gyro turned, far longer than telemetry holds one."""
        turned = np.where(np.isfinite(self.turned_rad), self.turned_rad, 0.0)
        return bool(((turned > usual.repeats.frozen_rad) & (self.held_s > usual.repeats.froze_s)).any())

    @property
    def frozen(self) -> bool:
        """Tell whether nearly all is one reading, under which a gyro turned."""
        turned = float(self.turned_rad[np.isfinite(self.turned_rad)].max(initial=0.0))
        return self.stale_share > usual.repeats.always and turned > usual.repeats.frozen_rad


def inspect(
    field_mgauss: FloatArray, valid: NDArray[np.bool_], time_s: FloatArray, gyro_radps: Series | None = None
) -> Trace:
    """Look for repeats and a lattice in readings (N, 3) at some times (N,), before any averaging."""
    same = np.concatenate([[False], (np.diff(field_mgauss, axis=0) == 0.0).all(axis=1)]) & valid
    share = float(same.sum()) / max(int(valid.sum()), 1)
    # How long each fresh reading was repeated: readings that are missing repeat nothing.
    fresh = np.flatnonzero(~same)
    last = np.append(fresh[1:], time_s.size) - 1
    jump = np.append(np.abs(np.diff(field_mgauss[fresh], axis=0)).max(axis=1), np.inf)
    held, since = time_s[last] - time_s[fresh], time_s[fresh]
    turned = np.zeros(held.size)
    for i in np.flatnonzero(held > usual.repeats.worth_a_look_s):
        turned[i] = _turned_rad(gyro_radps, float(since[i]), float(since[i] + held[i]))
    jump = np.nan_to_num(jump, posinf=np.inf)
    return Trace(share, same, held, since, jump, turned, _lattice(field_mgauss[valid]))


def _turned_rad(gyro_radps: Series | None, start_s: float, end_s: float) -> float:
    """Return the farthest that a gyro turned from where it was, beyond what its bias may make of rest."""
    if gyro_radps is None or len(gyro_radps) < 2:
        return math.inf
    first, last = np.searchsorted(gyro_radps.time_s, (start_s, end_s))
    time_s, rate = gyro_radps.time_s[first:last], gyro_radps.values[first:last]
    if time_s.size < 2:
        return 0.0
    turned = np.linalg.norm(integral(time_s, rate), axis=1) - usual.repeats.resting_radps * (
        time_s - time_s[0]
    )
    return max(float(turned.max()), 0.0)


def _lattice(field: FloatArray) -> float:
    """Return the step whose multiples all differences are, the same on all axes; 0 where there is none.

    An axis that hardly changes (the vertical one in level turns) has too few levels to tell a step, but
    enough to refute one.
    """
    gaps, steps = [], []
    for axis in range(3):
        levels = np.unique(np.round(field[:, axis], 9))
        if levels.size > 0.5 * len(field):
            return 0.0
        gaps.append(np.diff(levels))
        if levels.size >= usual.steps.fewest_levels:
            steps.append(float(np.quantile(gaps[-1], 0.05)))
    if not steps or min(steps) <= 0.0 or max(steps) > 1.05 * min(steps):
        return 0.0
    step = float(np.median(steps))
    multiples = np.concatenate(gaps) / step
    off = np.abs(multiples - np.round(multiples))
    allowed = 0.02 * np.maximum(
        1.0, np.sqrt(np.concatenate([np.full(g.size, g.max(initial=0.0)) for g in gaps]) / step)
    )
    return step if bool((off <= allowed).all()) else 0.0


def coarse_step(raw_mgauss: FloatArray, valid: NDArray[np.bool_]) -> float:
    """Return the step on whose multiples raw readings (N, 3) lie, each within a part of it; 0 without one.

    A calibration and the messages' rounding blur what was a lattice: for the right step q the mean of
    exp(2 pi i raw / q), the characteristic function of the readings, stays near 1 on every axis. Some axis
    must go over many steps, or all together over more: readings that stand still lie on multiples of
    anything, and those of four positions on eight levels or so.
    """
    field = raw_mgauss[valid]
    if len(field) < 10 * usual.steps.fewest_levels:
        return 0.0
    span = float(np.abs(field).max())
    least = 1 << math.ceil(math.log2(2.0 * span / _BIN_MGAUSS + 2.0))
    if least > _MOST_BINS:
        return 0.0
    length = min(max(8 * least, 1 << 14), _MOST_BINS)
    bins = np.round(field.T / _BIN_MGAUSS).astype(np.int64) % length
    counts = np.stack([np.bincount(at, minlength=length) for at in bins])
    inside = np.fft.rfft(counts, axis=1).real.min(axis=0) / len(field)
    frequency = np.fft.rfftfreq(length, _BIN_MGAUSS)
    usable = (frequency >= 1.0 / usual.steps.coarsest_mgauss) & (frequency <= 1.0 / usual.steps.finest_mgauss)
    best = float(inside[usable].max(initial=0.0))
    if best < usual.steps.in_step:
        return 0.0
    # Multiples of the right frequency are as good: the coarsest step is meant, at the top of its peak.
    good = np.flatnonzero(usable & (inside >= max(usual.steps.in_step, usual.steps.as_good * best)))
    first = int(good[0])
    last = first
    while last + 1 < inside.size and inside[last + 1] >= usual.steps.in_step:
        last += 1
    step = 1.0 / float(frequency[first + int(np.argmax(inside[first : last + 1]))])
    levels = [_levels(column, step) for column in field.T]
    return (
        step
        if max(levels) >= usual.steps.fewest_levels or sum(levels) >= usual.steps.fewest_together
        else 0.0
    )


def _levels(column: FloatArray, step_mgauss: float) -> int:
    """Count the steps on which more than a few readings lie."""
    _, counts = np.unique(np.round(column / step_mgauss), return_counts=True)
    return int((counts >= max(usual.steps.worth_a_level * column.size, 2.0)).sum())


@dataclass(frozen=True, slots=True, eq=False)
class Readings:
    """Hold what single readings tell.

    Attributes:
        time_s: (M,), repeats of a slow compass left out.
        error_mgauss: raw less nominal, (M, 3). nominal_mgauss: (M, 3).
        valid: readings with a reference, (M,).
        quiet: of these, with both neighbours, the ones while the field hardly turns: what is late, averaged
            or repeated by nature scatters while the vehicle turns.
    """

    time_s: FloatArray
    error_mgauss: FloatArray
    nominal_mgauss: FloatArray
    valid: NDArray[np.bool_]
    quiet: NDArray[np.bool_]

    @classmethod
    def of(
        cls, time_s: FloatArray, raw: FloatArray, nominal: FloatArray, valid: NDArray[np.bool_]
    ) -> Readings:
        """Compare readings (M, 3) with their nominal simulation."""
        turning = np.linalg.norm(np.gradient(nominal, time_s, axis=0), axis=1)
        slow = turning <= np.quantile(turning[valid], usual.scatter.quiet_share) if valid.any() else valid
        quiet = valid & slow
        quiet[1:-1] &= (valid & slow)[:-2] & (valid & slow)[2:]
        quiet[[0, -1]] = False
        return cls(time_s, raw - nominal, nominal, valid, quiet)

    @property
    def period_s(self) -> float:
        """Return the usual time between readings, seconds."""
        return float(np.median(np.diff(self.time_s)))

    def without(self, change_mgauss: FloatArray) -> Readings:
        """Take an effect's part (M, 3) out of the readings."""
        return replace(self, error_mgauss=self.error_mgauss - change_mgauss)
