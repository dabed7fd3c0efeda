"""What a flight controller tells of itself: each port its messages, at its rates and on request.

Messages leave on the grid of the main loop.
"""

from __future__ import annotations

import math
from collections.abc import Collection, Mapping
from dataclasses import dataclass

from mavcompass import messages as m
from mavcompass.enums import MavCmd, MavResult
from mavcompass.simulation.autopilot.board import Board
from mavcompass.simulation.autopilot.reports import Reports

# REQUEST_DATA_STREAM's numbers of the groups, by the name in the SRn_ parameters.
STREAM_GROUPS = {
    1: "RAW_SENS",
    2: "EXT_STAT",
    3: "RC_CHAN",
    4: "RAW_CTRL",
    6: "POSITION",
    10: "EXTRA1",
    11: "EXTRA2",
    12: "EXTRA3",
}
ALL_GROUPS = 0

# Message id -> (class, the group whose rate it has by default).
MESSAGES: dict[int, tuple[type[m.Message], str]] = {
    0: (m.Heartbeat, ""),
    1: (m.SysStatus, "EXT_STAT"),
    2: (m.SystemTime, "EXTRA3"),
    24: (m.GpsRawInt, "EXT_STAT"),
    26: (m.ScaledImu, ""),
    27: (m.RawImu, "RAW_SENS"),
    29: (m.ScaledPressure, "RAW_SENS"),
    30: (m.Attitude, "EXTRA1"),
    32: (m.LocalPositionNed, "POSITION"),
    33: (m.GlobalPositionInt, "POSITION"),
    36: (m.ServoOutputRaw, "RC_CHAN"),
    65: (m.RcChannels, "RC_CHAN"),
    74: (m.VfrHud, "EXTRA2"),
    105: (m.HighresImu, ""),
    116: (m.ScaledImu2, "RAW_SENS"),
    129: (m.ScaledImu3, "RAW_SENS"),
    148: (m.AutopilotVersion, ""),
    162: (m.FenceStatus, "EXT_STAT"),
    164: (m.Simstate, "EXTRA1"),
    193: (m.EkfStatusReport, "EXTRA3"),
    230: (m.EstimatorStatus, ""),
    245: (m.ExtendedSysState, ""),
}
MESSAGE_IDS = {kind: number for number, (kind, _) in MESSAGES.items()}

_LONGEST_INTERVAL_US = 60_000_000
_NEVER_US = 1 << 62
_MESSAGE_INTERVAL_ID = 244
# The number in place of a plain 1 or 0 that arms and disarms whatever speaks against it.
FORCE = 21196.0


def whole(value: float) -> int:
    """Read a whole number off a float field; 0 for what is no number."""
    return int(value) if math.isfinite(value) else 0


@dataclass(slots=True)
class _Timer:
    interval_us: int
    due_us: int


class Streams:
    """Hold the message intervals of one port."""

    def __init__(
        self,
        loop_us: int,
        shortest_us: int,
        available: Collection[int],
        defaults: Mapping[int, int],
        now_us: int,
    ) -> None:
        """Start with default intervals.

        Parameters
        ----------
        loop_us: messages leave at multiples of this, the main loop's period.
        shortest_us: the shortest interval that the firmware grants.
        available: ids of the messages that it knows; defaults: id -> interval, microseconds.
        """
        self._loop_us = loop_us
        self._shortest_us = shortest_us
        self._available = available
        self._defaults = dict(defaults)
        self._timers: dict[int, _Timer] = {}
        self._next_us = 0
        for number, interval in self._defaults.items():
            self._start(number, interval, now_us)

    def interval_us(self, number: int) -> int:
        """Return a message's interval: -1 when it is off, 0 when there is no such message."""
        if number not in self._available:
            return 0
        timer = self._timers.get(number)
        return timer.interval_us if timer else -1

    def set_interval(self, number: int, interval_us: int, now_us: int) -> bool:
        """Set an interval as SET_MESSAGE_INTERVAL does; False leaves the old one in force."""
        if number not in self._available:
            return False
        if interval_us < 0:
            self._timers.pop(number, None)
            return True
        if interval_us == 0:
            if number in self._defaults:
                self._start(number, self._defaults[number], now_us)
            else:
                self._timers.pop(number, None)
            return True
        # The firmware counts whole milliseconds.
        interval_us = min(max(interval_us // 1000, 1) * 1000, _LONGEST_INTERVAL_US)
        if interval_us < self._shortest_us:
            return False
        self._start(number, interval_us, now_us)
        return True

    def set_group(self, group: int, rate_hz: int, now_us: int) -> None:
        """Set the rate of a whole group, as REQUEST_DATA_STREAM does; too fast is cut down."""
        wanted = set(STREAM_GROUPS.values()) if group == ALL_GROUPS else {STREAM_GROUPS.get(group)}
        for number, (_, name) in MESSAGES.items():
            if name and name in wanted:
                if rate_hz <= 0:
                    self._timers.pop(number, None)
                else:
                    self._start(number, max(1_000_000 // rate_hz, self._shortest_us), now_us)

    def due(self, until_us: int) -> list[tuple[int, int]]:
        """List (time, message id) of what leaves up to a time, in order of time."""
        out: list[tuple[int, int]] = []
        if until_us < self._next_us:
            return out
        loop = self._loop_us
        for number, timer in self._timers.items():
            while True:
                leaves = -(-timer.due_us // loop) * loop
                if leaves > until_us:
                    break
                out.append((leaves, number))
                timer.due_us += timer.interval_us
        self._next_us = min((t.due_us for t in self._timers.values()), default=_NEVER_US)
        if len(out) > 1:
            out.sort()
        return out

    def _start(self, number: int, interval_us: int, now_us: int) -> None:
        old = self._timers.get(number)
        if old is not None and old.interval_us == interval_us:
            return
        self._timers[number] = _Timer(interval_us, now_us + interval_us)
        self._next_us = min(self._next_us, now_us + interval_us)


class Telemetry:
    """Send what is due, and answer what is asked about it."""

    def __init__(self, board: Board, reports: Reports) -> None:
        self._board = board
        self._reports = reports
        self.available = frozenset(MESSAGE_IDS[kind] for kind in reports.kinds)
        self._ports: dict[int, Streams] = {}
        self.streams(0)

    @property
    def ports(self) -> tuple[int, ...]:
        """Return the ports that somebody has spoken by, and the first."""
        return tuple(self._ports)

    def streams(self, port: int) -> Streams:
        """Return the message rates of a port."""
        if port not in self._ports:
            self._ports[port] = self._new_streams()
        return self._ports[port]

    def reset(self) -> None:
        """Go back to the rates of a power-up."""
        for port in self._ports:
            self._ports[port] = self._new_streams()

    def attend(self) -> None:
        """Send what is due. Messages between two ticks carry readings interpolated between them."""
        now_us, tick_us = self._board.now_us, self._board.tick_us
        for port, streams in self._ports.items():
            for time_us, number in streams.due(now_us):
                share = 1.0 - (now_us - time_us) / tick_us
                message = self._reports.build(MESSAGES[number][0], time_us, share)
                if message is not None:
                    self._board.send(message, port, time_us)

    def answer(self, command: m.CommandLong, port: int) -> MavResult | None:
        """Carry out a command about messages; None for any other command."""
        first, second = whole(command.param1), whole(command.param2)
        match command.command:
            case MavCmd.SET_MESSAGE_INTERVAL:
                done = self.streams(port).set_interval(first, second, self._board.now_us)
                return MavResult.ACCEPTED if done else MavResult.DENIED
            case MavCmd.GET_MESSAGE_INTERVAL:
                return self._tell_interval(first, port)
            case MavCmd.REQUEST_MESSAGE if first == _MESSAGE_INTERVAL_ID:
                return self._tell_interval(second, port)
            case MavCmd.REQUEST_MESSAGE:
                return self._send_once(first, port)
            case MavCmd.REQUEST_AUTOPILOT_CAPABILITIES:
                return self._send_once(MESSAGE_IDS[m.AutopilotVersion], port)
            case _:
                return None

    def set_group(self, request: m.RequestDataStream, port: int) -> None:
        """Act on REQUEST_DATA_STREAM."""
        rate = request.req_message_rate if request.start_stop else 0
        self.streams(port).set_group(request.req_stream_id, rate, self._board.now_us)

    def _tell_interval(self, number: int, port: int) -> MavResult:
        if not 0 <= number <= 0xFFFF:  # MESSAGE_INTERVAL has no room for it
            return MavResult.FAILED
        self._board.send(m.MessageInterval(number, self.streams(port).interval_us(number)), port)
        return MavResult.ACCEPTED

    def _send_once(self, number: int, port: int) -> MavResult:
        if number not in self.available:
            return MavResult.FAILED
        message = self._reports.build(MESSAGES[number][0], self._board.now_us, 1.0)
        if message is not None:
            self._board.send(message, port)
        return MavResult.ACCEPTED

    def _new_streams(self) -> Streams:
        profile = self._board.profile
        return Streams(
            profile.loop_us,
            int(profile.loop_us / profile.rate_share),
            self.available,
            self._reports.default_intervals(),
            self._board.now_us,
        )
