"""One clock for a recording: the vehicle's time since boot, through restarts and lost or late messages.

Some messages carry the vehicle's own time, some only the time at which they were logged. The former are
the clock. A message without is placed from that neighbour in the file that was logged nearest to it, as
it came through the same link with the same delay, and never outside its neighbours: what was sent
between two messages happened between their times. After a restart the vehicle's time begins anew;
`time_s` goes on, by as much as the logging clock says.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from mavcompass.frames import FloatArray

# A radio link may deliver a message late by this much and no more; a restart goes back further.
_LATEST_S = 1.0
# A clock that steps by more than this did not merely wait for the link.
_JUMP_S = 5.0
_NEIGHBOURS = 15
_GLITCH_MESSAGES = 5
_LONGEST_BREAK_S = 30.0 * 86400.0
_OUTSIDE_S = 3600.0
# So many are handled at a time, to spare memory.
_BLOCK = 1 << 18

OrderArray = NDArray[np.uint32]


@dataclass(frozen=True, slots=True, eq=False)
class BootClock:
    """Turn the vehicle's times and the log's into one `time_s` that never starts anew.

    Attributes:
        first_order: (segments,) the place in the file where each power-up begins; the first is 0.
        shift_s: (segments,) time_s minus time since boot.
        start_s: (segments,) the first time_s of each.
        log_jumps: how often the logging clock stepped against the vehicle's.
    """

    first_order: OrderArray
    shift_s: FloatArray
    start_s: FloatArray
    log_jumps: int
    _order: OrderArray
    _time_s: FloatArray
    _log_s: FloatArray

    def segment(self, order: OrderArray) -> NDArray[np.intp]:
        """Tell the power-up that messages belong to, by their places in the file."""
        return np.asarray(np.searchsorted(self.first_order, order, side="right") - 1)

    def fits(self, time_s: FloatArray) -> bool:
        """Tell whether times in the file's order agree with this clock as they are.

        That is so in a recording without restarts, if they go forward and stay inside it.
        """
        if self.shift_s.size > 1 or not time_s.size:
            return False
        goes_forward = bool((np.diff(time_s) > -_LATEST_S).all())
        low, high = self._time_s[0] - _JUMP_S, self._time_s[-1] + _JUMP_S
        return goes_forward and bool(low < time_s[0]) and bool(time_s.max() < high)

    def said_most(self) -> int | None:
        """Return the power-up with most messages where another was logged at the same time; None where one
        followed the other.

        No vehicle is started again before it ends: these are of several vehicles that share an address.
        """
        if self.first_order.size < 2:
            return None
        edges = [*np.searchsorted(self._order, self.first_order).tolist(), self._order.size]
        ends = []
        for first, last in pairwise(edges):
            time_s = self._time_s[first:last]
            ahead = float(np.median(self._log_s[first:last] - time_s))
            ends.append((float(time_s.min()) + ahead, float(time_s.max()) + ahead))
        ends.sort()
        at_a_time = any(later[0] < earlier[1] - _JUMP_S for earlier, later in pairwise(ends))
        return int(np.argmax(np.diff(edges))) if at_a_time else None

    def from_boot(self, order: OrderArray, boot_s: FloatArray) -> FloatArray:
        """Place messages, in the file's order, by the time since boot that they carry."""
        time_s = boot_s + self.shift_s[0]
        edges = [*np.searchsorted(order, self.first_order).tolist(), order.size]
        for shift, first, last in zip(self.shift_s[1:], edges[1:-1], edges[2:], strict=True):
            time_s[first:last] = boot_s[first:last] + shift
        return time_s

    def from_log(self, order: OrderArray, log_s: FloatArray) -> FloatArray:
        """Place messages by the time when they were logged."""
        out = np.empty(order.size)
        for first in range(0, order.size, _BLOCK):
            block = slice(first, first + _BLOCK)
            out[block] = self._between_neighbours(order[block], log_s[block])
        return out

    def _between_neighbours(self, order: OrderArray, log_s: FloatArray) -> FloatArray:
        last = self._order.size - 1
        after = np.searchsorted(self._order, order)
        before = np.maximum(after - 1, 0)
        after = np.minimum(after, last)
        nearer_before = np.abs(log_s - self._log_s[before]) <= np.abs(self._log_s[after] - log_s)
        neighbour = np.where(nearer_before, before, after)
        guess = self._time_s[neighbour] + (log_s - self._log_s[neighbour])
        low, high = self._time_s[before], self._time_s[after]
        # Ahead of the first and behind the last there is a neighbour on one side only.
        low = np.where(order < self._order[0], low - _OUTSIDE_S, low)
        high = np.where(order > self._order[last], high + _OUTSIDE_S, high)
        return np.asarray(np.clip(guess, np.minimum(low, high), np.maximum(low, high)))

    def from_order(self, order: OrderArray) -> FloatArray:
        """Place messages without any time: when the one before them in the file was sent."""
        before = np.maximum(np.searchsorted(self._order, order, side="right") - 1, 0)
        return self._time_s[before]

    def restarts(self) -> list[str]:
        """Tell of power-ups after the first."""
        starts = self.shift_s.size
        if starts < 2:
            return []
        at = ", ".join(f"{start:.1f}" for start in self.start_s[1:6])
        return [f"The autopilot was started {starts} times; time_s goes on across the restarts (at {at} s)."]

    def utc_offset_s(self) -> float | None:
        """Return the Unix time of time_s = 0 by the logging clock; None where that was not set."""
        offset = float(np.median(self._log_s - self._time_s))
        return offset if offset > 1.0e9 else None


def build_clock(order: OrderArray, log_s: FloatArray, boot_s: FloatArray) -> BootClock:
    """Build the clock from the messages that carry both times, (N,) each, N > 0.

    `order` is their place in the file; they need not be sorted.
    """
    if bool((np.diff(order.astype(np.int64)) < 0).any()):
        sort = np.argsort(order, kind="stable")
        order, log_s, boot_s = order[sort], log_s[sort], boot_s[sort]
    wrong, _ = _glitches(log_s, boot_s)
    if bool(wrong.any()) and not bool(wrong.all()):
        order, log_s, boot_s = order[~wrong], log_s[~wrong], boot_s[~wrong]
    edges = _restarts(boot_s)
    time_s, shifts = _go_on(edges, log_s, boot_s)
    first_order = order[edges].copy()
    first_order[0] = 0
    return BootClock(
        first_order=first_order,
        shift_s=shifts,
        start_s=np.array([float(time_s[first]) for first in edges]),
        log_jumps=int(_leaps(log_s - time_s).size),
        _order=order,
        _time_s=time_s,
        _log_s=log_s,
    )


def impossible_times(boot_s: FloatArray) -> NDArray[np.intp]:
    """Find, among times in the file's order, those that leap away from their neighbours and back."""
    return np.flatnonzero(_glitches(None, boot_s)[1])


def _glitches(log_s: FloatArray | None, boot_s: FloatArray) -> tuple[NDArray[np.bool_], NDArray[np.bool_]]:
    """Find short outbreaks of either clock: which messages to leave out, and which have a wrong boot time."""
    wrong = np.zeros(boot_s.size, dtype=bool)
    boot_wrong = wrong.copy()
    offset = boot_s if log_s is None else log_s - boot_s
    steps = _leaps(offset)
    position = 0
    while position < steps.size - 1:
        last_good, last_wrong = int(steps[position]), int(steps[position + 1])
        returned = abs(offset[last_wrong + 1] - offset[last_good]) <= _JUMP_S
        if returned and last_wrong - last_good <= _GLITCH_MESSAGES:
            span = slice(last_good + 1, last_wrong + 1)
            wrong[span] = True
            low, high = boot_s[last_good] - _LATEST_S, boot_s[last_wrong + 1] + _LATEST_S
            boot_wrong[span] = (boot_s[span] < low) | (boot_s[span] > high)
            position += 2
        else:
            position += 1
    return wrong, boot_wrong


def _leaps(times_s: FloatArray) -> NDArray[np.intp]:
    """Return the places before which times go on, and after which they are more than a jump away."""
    parts = [
        np.flatnonzero(np.abs(np.diff(times_s[first : first + _BLOCK + 1])) > _JUMP_S) + first
        for first in range(0, max(times_s.size - 1, 1), _BLOCK)
    ]
    return np.concatenate(parts)


def _restarts(boot_s: FloatArray) -> list[int]:
    """Find where time since boot begins anew: it falls and stays below what it was."""
    edges = [0]
    for index in (np.flatnonzero(np.diff(boot_s) < -_LATEST_S) + 1).tolist():
        before = np.median(boot_s[max(edges[-1], index - _NEIGHBOURS) : index])
        after = np.median(boot_s[index : index + _NEIGHBOURS])
        if after < before - _LATEST_S:
            edges.append(index)
    return edges


def _go_on(edges: list[int], log_s: FloatArray, boot_s: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Let the time of each power-up follow on the one before."""
    time_s = boot_s.copy()
    shifts = np.zeros(len(edges))
    for number, (first, last) in enumerate(zip(edges, [*edges[1:], boot_s.size], strict=True)):
        if first:
            waited = float(log_s[first] - log_s[first - 1])
            waited = waited if 0.0 < waited < _LONGEST_BREAK_S else 1.0
            shifts[number] = float(time_s[:first].max()) + waited - float(boot_s[first:last].min())
            time_s[first:last] += shifts[number]
    return time_s, shifts
