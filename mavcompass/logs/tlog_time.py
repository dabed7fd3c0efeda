"""Place MAVLink messages in time: the vehicle's clock out of the messages that carry it."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from mavcompass.frames import FloatArray
from mavcompass.logs.boot_clock import BootClock, build_clock
from mavcompass.logs.in_order import in_order
from mavcompass.logs.tlog_compass import Samples
from mavcompass.logs.tlog_messages import Messages

_MILLISECONDS = "time_boot_ms"
_MICROSECONDS = "time_usec"
# Old firmware's microseconds are a 32 bit counter, which starts anew after 71.6 minutes.
_WRAP_S = 2.0**32 * 1.0e-6
# No vehicle has been up for three years: such a time counts from 1970.
_UNIX_S = 1.0e8
_SAME_CLOCK_S = 5.0


def clock_of(messages: Mapping[str, Messages]) -> BootClock:
    """Build the vehicle's clock from all messages that carry time since boot in milliseconds.

    Where there is none, from those in microseconds, and where there is none of these, from the log's
    own time stamps. `messages` holds at least one message.
    """
    for field in (_MILLISECONDS, _MICROSECONDS):
        parts = [one for one in messages.values() if len(one) and field in one.rows.dtype.names]
        if parts:
            boot_s = [_own_time_s(one, field) for one in parts]
            break
    else:
        parts = [one for one in messages.values() if len(one)]
        first_us = min(int(one.log_time_us[0]) for one in parts)
        boot_s = [(one.log_time_us.astype(np.float64) - first_us) * 1.0e-6 for one in parts]
    return build_clock(
        np.concatenate([one.order for one in parts]),
        np.concatenate([one.log_time_s for one in parts]),
        np.concatenate(boot_s),
    )


def _own_time_s(messages: Messages, field: str) -> FloatArray:
    return np.asarray(messages.rows[field] * (1.0e-3 if field == _MILLISECONDS else 1.0e-6))


def place_messages(messages: dict[str, Messages], clock: BootClock) -> tuple[dict[str, Samples], int]:
    """Give every message its time_s and sort; return them by name and the number of repeats left out.

    `messages` is emptied on the way, to spare memory.
    """
    samples: dict[str, Samples] = {}
    repeats = 0
    for name in list(messages):
        found = messages.pop(name)
        if clock.glitches.size:
            found = found.select(~np.isin(found.order, clock.glitches))
        if not len(found):
            continue
        fields = found.rows.dtype.names
        if _MILLISECONDS in fields:
            time_s = clock.from_boot(found.order, _own_time_s(found, _MILLISECONDS))
        else:
            time_s = clock.from_log(found.order, found.log_time_s)
            if _MICROSECONDS in fields:
                time_s = _by_microseconds(found, time_s, clock)
        own_time = _MILLISECONDS in fields or _MICROSECONDS in fields
        time_s, rows, left_out = in_order(time_s, found.rows, own_time=own_time)
        repeats += left_out
        samples[name] = Samples(name, time_s, rows)
    return samples, repeats


def _by_microseconds(found: Messages, placed_s: FloatArray, clock: BootClock) -> FloatArray:
    """Refine times that were placed by arrival with the message's own microseconds.

    They count from boot, from boot on a counter that wraps, or from 1970.
    """
    own_s = _own_time_s(found, _MICROSECONDS)
    time_s = clock.from_boot(found.order, own_s)
    ahead = placed_s - time_s
    turns = np.round(ahead / _WRAP_S)
    if bool((np.abs(ahead - turns * _WRAP_S) < _SAME_CLOCK_S).all()):
        return time_s + turns * _WRAP_S if bool(turns.any()) else time_s
    if float(np.median(own_s)) > _UNIX_S:
        time_s = own_s + float(np.median(placed_s - own_s))
        if bool((np.abs(placed_s - time_s) < _SAME_CLOCK_S).all()):
            return time_s
    return placed_s
