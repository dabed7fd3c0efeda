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
