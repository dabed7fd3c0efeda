"""What a flight controller tells of itself: each port its messages, at its rates and on request."""

from __future__ import annotations

from mavcompass import messages as m
from mavcompass.enums import MavCmd, MavResult
from mavcompass.simulation.autopilot.board import Board
from mavcompass.simulation.autopilot.commands import whole
from mavcompass.simulation.autopilot.reports import Reports
from mavcompass.simulation.autopilot.streams import MESSAGE_IDS, MESSAGES, Streams

_MESSAGE_INTERVAL_ID = 244


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
