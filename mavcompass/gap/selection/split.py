"""Which rows choose and fit: most blocks of a recording, others held out, none while something changes.

A change takes time: a hand that attaches a magnet needs a second, a step of the model none.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from mavcompass.chance import chi_square_of
from mavcompass.frames import FloatArray
from mavcompass.gap.attitude.sensors import MEDIAN_OF_SQUARES
from mavcompass.gap.fit.hypothesis import Fit, Mask
from mavcompass.gap.fit.model import Problem
from mavcompass.gap.replay.nominal import Replay
from mavcompass.gap.replay.nuisance import TELEMETRY_AGE
from mavcompass.gap.tables import usual
from mavcompass.simulation.effects.effect import LAG, MOMENTS, NEVER_S, SMOOTHING

_SEED = 20260101


@dataclass(frozen=True, slots=True, eq=False)
class Split:
    """Hold which rows choose and fit (`train`) and which are held out (`test`), both (N,).

    Rows within the guard of a held-out block belong to neither.
    """

    train: Mask
    test: Mask


def split_blocks(time_s: FloatArray, valid: Mask) -> Split:
    """Hold out one block of every four, at a place that a fixed generator draws.

    A regular pattern would fall into step with a procedure that turns and dwells in a fixed rhythm. Two
    neighbours would be too long to know the attitude between. Short recordings get shorter blocks.
    """
    length = max(min(usual.split.block_s, float(time_s[-1] - time_s[0]) / usual.split.fewest), 1e-3)
    block = np.floor((time_s - time_s[0]) / length).astype(np.int64)
    count = int(block[-1]) + 1
    held = np.zeros(count, dtype=np.bool_)
    rng = np.random.default_rng(_SEED)
    for first in range(0, count, usual.split.held_out_of):
        place = first + int(rng.integers(usual.split.held_out_of))
        if place and held[place - 1 : place].any():
            place += 1
        if place < count:
            held[place] = True
    test = held[block]
    train = ~test
    for edge in np.flatnonzero(np.diff(test.astype(np.int8))):
        boundary = 0.5 * (time_s[edge] + time_s[edge + 1])
        train &= ~((np.abs(time_s - boundary) < min(usual.split.guard_s, length / 5.0)) & ~test)
    return Split(train & valid, test & valid)


def with_windows(split: Split, time_s: FloatArray, valid: Mask, moments_s: list[float]) -> Split:
    """Give a narrow window about each moment to the training rows, where it lies in a held-out block.

    The training rows alone tell that something changes inside the block; the window halves the stretch in
    which it may be. A guard on both sides of the window leaves the held-out rows.
    """
    train, test = split.train.copy(), split.test.copy()
    for moment in moments_s:
        distance = np.abs(time_s - moment)
        train |= (distance < usual.split.window_s) & valid
        test &= distance > usual.split.window_s + 0.3 * usual.split.guard_s
    return replace(split, train=train, test=test)


def probe(split: Split, time_s: FloatArray, moment_s: float) -> float | None:
    """Return the middle of the gap between training rows at a moment, or beside it; None where there is none.

    A change found right beside a gap may as well lie inside it: the rows at the edge are few.
    """
    rows = time_s[split.train]
    step = float(np.median(np.diff(time_s)))
    gaps = np.flatnonzero(np.diff(rows) > 0.5 * usual.split.guard_s + 3.0 * step)
    for gap in gaps:
        if rows[gap] - usual.split.window_s < moment_s < rows[gap + 1] + usual.split.window_s:
            return float(0.5 * (rows[gap] + rows[gap + 1]))
    return None


def moments(fit: Fit) -> list[float]:
    """List when something changes under a fit, in seconds."""
    return [
        float(value)
        for term, theta in zip(fit.terms, fit.thetas, strict=True)
        for parameter, value in zip(term.effect.parameters, theta, strict=True)
        if parameter.name in MOMENTS and abs(value) < NEVER_S
    ]


def switches(fit: Fit) -> bool:
    """Tell whether a fit has something that is switched."""
    return any(term.effect.switched for term in fit.terms)


def transients(problem: Problem, fit: Fit, when_s: Sequence[float]) -> Mask:
    """Tell which rows (N,) belong to a change that is going on, outwards from each moment.

    Under correlated noise the readings beside a change would settle its size nearly alone: while it goes
    on, they must not.
    """
    time = problem.replay.time_s
    z = problem.innovations(problem.predict(fit))["mag"]
    power = np.where(problem.usable, (z**2).mean(axis=1), np.nan)
    aside = np.zeros(time.size, dtype=np.bool_)
    if not problem.usable.any():
        return aside
    median = float(np.nanmedian(power)) / (chi_square_of(0.5, 3) / 3.0)
    width = max(usual.change.bin_s, 4.0 * float(np.median(np.diff(time))))
    for moment in when_s:
        for side in (-1.0, 1.0):
            reach = 0.0
            while reach < usual.change.longest_s:
                away = side * (time - moment)
                rows = (away >= reach) & (away < reach + width) & problem.usable
                if not rows.any() or float(np.mean(power[rows])) < usual.change.worse * median:
                    break
                reach += width
            if reach > 0.0:
                aside |= (side * (time - moment) > -width) & (side * (time - moment) < reach + width)
    return aside


def switched(problem: Problem, fit: Fit) -> Mask:
    """Tell which rows (N,) are so near to a switching as it is known that they may be of both on and off.

    A reading is the mean of some time, and the load is known at some times: when it was switched between
    two of them, or there and back again, nobody recorded. Where hardly a row is clear of that, none is told.
    """
    replay, time = problem.replay, problem.replay.time_s
    rows: Mask = np.zeros(time.size, dtype=np.bool_)
    late = (fit.value(LAG) or 0.0) + float(problem.values(fit).get(TELEMETRY_AGE, np.zeros(1))[0])
    fields: list[tuple[FloatArray, FloatArray]] = []
    width = max(float(np.median(np.diff(time))), replay.loads_every_s, usual.switched.load_s)
    # What is smoothed goes on for as long as that takes.
    width += usual.switched.settled * (fit.value(SMOOTHING) or 0.0)
    for term, theta in zip(fit.terms, fit.thetas, strict=True):
        if term.effect.switched:
            unread = replay.signals.with_mag(np.zeros((time.size, 3)))
            field = term.effect.forward(unread, theta, {}, None).reading.mag_mgauss
            last = np.flatnonzero(np.diff(np.abs(field).max(axis=1)))
            when = 0.5 * (time[last] + time[last + 1]) + late
            at = np.searchsorted(when, time)
            for beside in (np.append(when, np.inf)[at], np.insert(when, 0, -np.inf)[at]):
                rows |= np.abs(time - beside) < width
            fields.append((field, theta[:3]))
    for field, own in fields:
        rows |= _other_way(problem, fit, field, own, rows)
    return rows if rows[problem.usable].mean() < usual.switched.most else np.zeros_like(rows)


def _other_way(problem: Problem, fit: Fit, field_mgauss: FloatArray, own: FloatArray, shared: Mask) -> Mask:
    """Tell which rows (N,) were switched the other way, or partly, between two records of the load.

    They are off along the field that is switched, toward where it is not, and hardly across it. More than a
    few that are not `shared` (N,) anyhow are no chance: then it is not switched by that load.
    """
    size = float(np.linalg.norm(own))
    error = problem.replay.measured.mag_mgauss - problem.predict(fit).mag_mgauss
    noise = float(np.sqrt(np.mean(np.nanmedian(error[problem.usable] ** 2, axis=0)) / MEDIAN_OF_SQUARES))
    if size < usual.switched.seen_apart * noise:
        return np.zeros(len(error), dtype=np.bool_)
    along = error @ own / size**2
    across = np.linalg.norm(error - along[:, None] * own, axis=1)
    on = np.abs(field_mgauss).max(axis=1) > 0.0
    toward = np.where(on, -along, along)
    with np.errstate(invalid="ignore"):
        rows: Mask = (
            (toward > usual.switched.part)
            & (toward < usual.switched.whole)
            & (across < usual.switched.aside * toward * size)
        )
    clear = problem.usable & ~shared
    return rows if rows[clear].mean() < usual.switched.by_chance else np.zeros_like(rows)


def between_rows(problem: Problem, moment_s: float) -> tuple[float, float]:
    """Return the fitted rows before and after a moment: anywhere between them it fits as well."""
    time = problem.replay.time_s[problem.index]
    place = int(np.searchsorted(time, moment_s, side="right"))
    low = float(time[place - 1]) if place > 0 else moment_s
    return low, float(time[place]) if place < time.size else moment_s


def said_of(replay: Replay, aside: Mask, switching: Mask) -> tuple[str, ...]:
    """Say in words which stretches were set aside because something was changing or switched."""
    edges = np.flatnonzero(np.diff(np.concatenate([[0], aside.astype(np.int8), [0]])))
    often = (
        f"While something is switched, a reading is of both: {switching.sum()} of {switching.size} were not"
        " fitted.",
    )
    fast = tuple(
        f"From {replay.time_s[first]:.1f} to {replay.time_s[end - 1]:.1f} s something changes faster than the"
        " model can follow: these readings were not fitted."
        for first, end in zip(edges[::2], edges[1::2], strict=True)
    )
    return (often if switching.any() else ()) + fast


def with_moments(problem: Problem, fit: Fit, seen_s: Sequence[float]) -> Fit:
    """Put moments back to where they were seen, where no fitted row lies between: there any will do."""
    time, thetas = problem.replay.time_s[problem.index], []
    for term, theta in zip(fit.terms, fit.thetas, strict=True):
        moved = theta.copy()
        for j, parameter in enumerate(term.effect.parameters):
            if parameter.name not in MOMENTS or not seen_s:
                continue
            nearest = min(seen_s, key=lambda m, v=float(theta[j]): abs(m - v))  # type: ignore[misc]
            low, high = sorted((nearest, float(theta[j])))
            if not ((time > low) & (time < high)).any():
                moved[j] = nearest
        thetas.append(moved)
    return replace(fit, thetas=tuple(thetas))
