"""Place MAVLink messages in time: the vehicle's clock out of the messages that carry it."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from mavcompass.frames import FloatArray
from mavcompass.logs.common.boot_clock import BootClock, build_clock
from mavcompass.logs.common.samples import in_order
from mavcompass.logs.formats.tlog.messages import Messages
from mavcompass.two_clocks import TwoClocks

_MILLISECONDS = "time_boot_ms"
_MICROSECONDS = "time_usec"
# Old firmware's microseconds are a 32 bit counter, which starts anew after 71.6 minutes.
_WRAP_S = 2.0**32 * 1.0e-6
# No vehicle has been up for three years: such a time counts from 1970.
_UNIX_S = 1.0e8
_SAME_CLOCK_S = 5.0
# Messages of one clock arrive as late as each other, within what a link delays.
_ONE_CLOCK_S = 1.0
# A clock of so many messages is as good as one of all of them, and spares memory.
_ENOUGH = 1_000_000


@dataclass(frozen=True, slots=True, eq=False)
class Samples:
    """Hold one kind of messages in order of time: `rows` is a record array with its field names."""

    name: str
    time_s: FloatArray
    rows: Any

    def __len__(self) -> int:
        """Count the samples."""
        return int(self.time_s.size)


def clock_of(messages: Mapping[str, Messages]) -> BootClock:
    """Build the vehicle's clock from the messages that carry time since boot in milliseconds.

    Where there is none, from those in microseconds, and where there is none of these, from the log's
    own time stamps. `messages` holds at least one message.
    """
    heard = sorted((one for one in messages.values() if len(one)), key=len, reverse=True)
    for field in (_MILLISECONDS, _MICROSECONDS):
        parts = _enough([one for one in heard if field in one.rows.dtype.names])
        if parts:
            boot_s = np.concatenate([_own_time_s(one, field) for one in parts])
            break
    else:
        parts = _enough(heard)
        boot_s = np.concatenate([one.log_time_s for one in parts])
        boot_s -= boot_s.min()
    order = np.concatenate([one.order for one in parts])
    return build_clock(order, np.concatenate([one.log_time_s for one in parts]), boot_s)


def keep_one_vehicle(messages: dict[str, Messages]) -> tuple[BootClock, bool]:
    """Take the messages of other vehicles with this address out; return the clock, and whether there were
    any.

    Several vehicles that were logged under one system id stand in a file one after the other, though at the
    same time; the one that said most stays.
    """
    clock = clock_of(messages)
    most = clock.said_most()
    if most is None:
        return clock, False
    for name, one in list(messages.items()):
        own = one.select(clock.segment(one.order) == most)
        if len(own):
            messages[name] = own
        else:
            del messages[name]
    return clock_of(messages), True


def in_turns(messages: Mapping[str, Messages]) -> bool:
    """Tell whether two vehicles with this address were recorded in turns, so that nobody can part them."""
    clocks = TwoClocks()
    for name, one in messages.items():
        if _MILLISECONDS in (one.rows.dtype.names or ()):
            clocks.hear_all(name, _own_time_s(one, _MILLISECONDS))
    return clocks.seen


def _enough(densest_first: list[Messages]) -> list[Messages]:
    """Take as many kinds as make up a clock, always the densest."""
    out: list[Messages] = []
    for one in densest_first:
        if out and sum(map(len, out)) + len(one) > _ENOUGH:
            break
        out.append(one)
    return out


def _own_time_s(messages: Messages, field: str) -> FloatArray:
    return np.asarray(messages.rows[field] * (1.0e-3 if field == _MILLISECONDS else 1.0e-6))


class Placer:
    """Hand out one kind of messages after the other, each with its time_s and in order.

    What is handed out is taken from the messages given, so that memory is freed on the way.

    Attributes:
        repeats: how many messages were left out because they were recorded twice.
        misplaced: how many carried an impossible time and were placed by their arrival.
    """

    def __init__(self, messages: dict[str, Messages], clock: BootClock) -> None:
        self._messages = messages
        self._clock = clock
        self.repeats = 0
        self.misplaced = 0

    def count(self, name: str) -> int:
        """Count the messages of one kind that are still there."""
        return len(self._messages[name]) if name in self._messages else 0

    def take(self, name: str) -> Samples | None:
        """Hand out all messages of one kind; None where there are none."""
        found = self._messages.pop(name, None)
        if found is None or not len(found):
            return None
        fields = found.rows.dtype.names
        own_time = True
        if _MILLISECONDS in fields:
            time_s = self._by_milliseconds(found)
        elif _MICROSECONDS in fields:
            time_s = self._by_microseconds(found)
        else:
            time_s = self._clock.from_log(found.order, found.log_time_s)
            own_time = False
        time_s, rows, repeats = in_order(time_s, found.rows, own_time=own_time)
        self.repeats += repeats
        return Samples(name, time_s, rows)

    def drop(self, name: str) -> None:
        """Forget all messages of one kind."""
        self._messages.pop(name, None)

    def _by_milliseconds(self, found: Messages) -> FloatArray:
        time_s = self._clock.from_boot(found.order, _own_time_s(found, _MILLISECONDS))
        if self._clock.fits(time_s):
            return time_s
        placed_s = self._clock.from_log(found.order, found.log_time_s)
        return self._own_where(np.abs(placed_s - time_s) < _SAME_CLOCK_S, time_s, placed_s)

    def _by_microseconds(self, found: Messages) -> FloatArray:
        """Place by the message's own microseconds.

        They count from boot, from boot on a counter that wraps, or from 1970.
        """
        own_s = _own_time_s(found, _MICROSECONDS)
        time_s = self._clock.from_boot(found.order, own_s)
        placed_s = self._clock.from_log(found.order, found.log_time_s)
        if self._clock.fits(time_s):
            # Another clock of the same vehicle may have been started some seconds later.
            behind_s = float(np.median(placed_s - time_s))
            return time_s if abs(behind_s) < _ONE_CLOCK_S else time_s + behind_s
        if float(np.median(own_s)) > _UNIX_S:
            time_s = own_s + float(np.median(placed_s - own_s))
        else:
            time_s += np.round((placed_s - time_s) / _WRAP_S) * _WRAP_S
        return self._own_where(np.abs(placed_s - time_s) < _SAME_CLOCK_S, time_s, placed_s)

    def _own_where(self, fits: NDArray[np.bool_], own_s: FloatArray, placed_s: FloatArray) -> FloatArray:
        self.misplaced += int(fits.size - np.count_nonzero(fits))
        return np.where(fits, own_s, placed_s)
