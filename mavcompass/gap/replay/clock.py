"""When readings were taken that messages carry later: the autopilot reads its compass by an even clock.

A message has the last reading, which is then as old as chance has it, up to the time between two messages. In
a turn each hundredth of a second counts. Where the messages come more often than the readings, those that
bring a new one lie within one step after the ticks of the clock, and so tell the clock.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from mavcompass.frames import FloatArray

# A clock is looked for in pieces, since no clock is even for ever.
_PIECE_S, _FEWEST = 60.0, 60
_BIN_S = 1e-3
# Steps in a row, and how far their mean may be off the clock's.
_ROW, _NEAR = 8, 0.12
_ROUNDS, _STEPS = 4, 8
# Messages that come no oftener than this tell no clock but their own.
_OFTENER = 0.9
# So many readings must lie within the step of the messages after a tick, and a bit.
_KEPT, _BEYOND = 0.97, 0.05
# Messages that keep step with the readings: how well a clock has to tell which of them bring a new one, of
# how many that do and that do not, how near their share is to a whole number of messages for each, and the
# clocks and ticks that are tried.
_TELLS, _FEWEST_OF_EACH, _WHOLE = 0.95, 6, 0.05
_OFF, _PHASES = np.linspace(-1e-4, 1e-4, 11), np.linspace(0.0, 1.0, 61)


def reading_times(time_s: FloatArray, message_s: float, after_loss: NDArray[np.bool_]) -> FloatArray:
    """Return when new readings (N,) that messages brought at some times were taken, but for a common age.

    `message_s` is the time between messages. What follows no even clock stays as it is, and so does what came
    `after_loss` (N,): it may be older than the others, and where messages are lost no attitude is known.
    """
    pieces = max(math.ceil(float(time_s[-1] - time_s[0]) / _PIECE_S), 1)
    edges = np.searchsorted(time_s, np.linspace(time_s[0], time_s[-1], pieces + 1)[1:-1])
    read = np.concatenate([_on_the_clock(piece, message_s) for piece in np.split(time_s, edges)])
    # The first message has a reading that is older, too.
    twice = np.append(np.diff(read) < 0.5 * np.diff(time_s), False)
    read = np.where(twice | after_loss, time_s, read)
    return read if bool((np.diff(read) > 0.0).all()) else time_s


def times_in_step(time_s: FloatArray, new: NDArray[np.bool_]) -> FloatArray | None:
    """Return when new readings were taken of which messages (N,) that keep step with them bring each, or each
    second or third one, but for a common age; None where they do not.

    A message that is sent with the tick comes by chance just before it or just after, and its reading is one
    period older or fresh. `new` (N,) tells which messages brought a new one, and so when the tick is.
    """
    share = float(new.mean())
    each = 1 if share > 2.0 / 3.0 else round(1.0 / max(share, 1e-3))
    pieces = max(math.ceil(float(time_s[-1] - time_s[0]) / _PIECE_S), 1)
    edges = np.searchsorted(time_s, np.linspace(time_s[0], time_s[-1], pieces + 1)[1:-1])
    split = zip(np.split(time_s, edges), np.split(new, edges), strict=True)
    ages = [_ages_in_step(times, brought, each) for times, brought in split]
    known = [piece for piece in ages if piece is not None]
    if len(known) < len(ages):
        return None
    age = np.concatenate(known)
    told = time_s[new] - (age - age.mean())
    return told if bool((np.diff(told) > 0.0).all()) else None


def _ages_in_step(time_s: FloatArray, new: NDArray[np.bool_], each: int) -> FloatArray | None:
    later = new[1:]
    if (
        time_s.size < _FEWEST
        or min(int(later.sum()), int((~later).sum())) < _FEWEST_OF_EACH
        or (each > 1 and abs(float(new.mean()) * each - 1.0) > _WHOLE)
    ):
        return None
    step_s = float(np.median(np.diff(time_s)))
    number = np.round((time_s - time_s[0]) / step_s)
    for _ in range(2):
        step_s, first_s = np.polyfit(number, time_s, 1)
        number = np.round((time_s - first_s) / step_s)
    weight = np.where(later, 0.5 / later.sum(), -0.5 / (~later).sum())
    best, found = _TELLS, None
    for period_s in (each * step_s * (1.0 + _OFF)).tolist():
        turns = (time_s - time_s[0]) / period_s
        ticks = np.quantile(turns % 1.0, _PHASES)
        told = 0.5 + _weight_of_crossed(turns, ticks, weight)
        at = int(np.argmax(told))
        if told[at] > best:
            best, found = float(told[at]), (turns - ticks[at], period_s)
    if found is None:
        return None
    since, period_s = found[0][new], found[1]
    count = np.floor(since)
    age = (since - count) * period_s
    # Two of one tick: of one of them the clock is wrong.
    age[np.diff(count, prepend=-np.inf) <= 0.0] = age.mean()
    # Of several messages for each reading the tick may lie anywhere between two, in each piece elsewhere.
    return np.asarray(age - age.mean() if each > 1 else age)


def _weight_of_crossed(turns: FloatArray, ticks: FloatArray, weight: FloatArray) -> FloatArray:
    """Return the weights (N - 1,) of the steps between turns (N,) that cross each tick, 0 to 1, (T,).

    The floor of x - t is that of x, less one where its fraction is below t: sums over steps are sums of
    weights below t.
    """
    whole, part = np.divmod(turns, 1.0)
    more, before, after = np.diff(whole), part[:-1], part[1:]
    # A step of a turn crosses every tick.
    some = np.where((more > 1.0) | ((more == 1.0) & (after >= before)), 0.0, weight)
    return float(weight @ np.minimum(more, 1.0)) + _below(ticks, before, some) - _below(ticks, after, some)


def _below(limits: FloatArray, values: FloatArray, weight: FloatArray) -> FloatArray:
    """Return the sum of the weights of values below each limit."""
    order = np.argsort(values)
    return np.append(0.0, np.cumsum(weight[order]))[np.searchsorted(values[order], limits)]


def _on_the_clock(time_s: FloatArray, message_s: float) -> FloatArray:
    if time_s.size < _FEWEST:
        return time_s
    # Of some steps in a row the quicker ones: where none was lost.
    mean = float(np.quantile(time_s[_ROW:] - time_s[:-_ROW], 0.1)) / _ROW
    since = time_s - time_s[0]
    length = int(2 ** math.ceil(math.log2(2.0 * since[-1] / _BIN_S)))
    ticks = np.bincount(np.round(since / _BIN_S).astype(np.int64), minlength=length)
    hertz = np.fft.rfftfreq(length, _BIN_S)
    near = np.abs(hertz * mean - 1.0) < _NEAR
    if not near.any():
        return time_s
    best = float(hertz[near][int(np.argmax(np.abs(np.fft.rfft(ticks))[near]))])
    mirrored = 1.0 / message_s - best
    if abs(mirrored * mean - 1.0) < _NEAR:
        # Of messages twice as often as readings the mirror image is as sharp: which one goes on as they do?
        steps = np.diff(time_s)
        on = float(np.mean(steps[steps < 1.8 * np.median(steps)]))
        best = min(best, mirrored, key=lambda f: abs(f * on - 1.0))
    beside = 1.0 / since[-1]
    for _ in range(_ROUNDS):
        tried = best + beside * np.linspace(-1.0, 1.0, 2 * _STEPS + 1)
        best = float(tried[int(np.argmax(np.abs(np.exp(2j * np.pi * np.outer(tried, since)).sum(axis=1))))])
        beside /= _STEPS
    # New readings come within a step of the messages after a tick: the rest of the time between two is empty.
    phase = np.sort((since * best) % 1.0)
    kept = math.ceil(_KEPT * phase.size) - 1
    width = np.append(phase, phase + 1.0)[kept : kept + phase.size] - phase
    first = int(np.argmin(width))
    if message_s * best > _OFTENER or width[first] > message_s * best + _BEYOND:
        return time_s
    # In the middle of what is empty one tick ends and the next one begins.
    age = (since * best - phase[first] + 0.5 * (1.0 - width[first])) % 1.0
    return np.asarray(time_s - (age - age.mean()) / best)
