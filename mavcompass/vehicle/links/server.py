"""VehicleServer: a vehicle of this process on a real port, for any number of clients."""

from __future__ import annotations

from collections.abc import Callable

from mavcompass.vehicle.link import LinkStatistics
from mavcompass.vehicle.links.autopilot import Autopilot, Pace, Said, SaidMessage
from mavcompass.vehicle.stopping import StopRequest
from mavcompass.vehicle.transport import Peer, Transport
from mavcompass.vehicle.wire import FrameParser, FrameWriter, decode

# How often the vehicle is advanced, wall time: what a client sees as delay.
TURN_S = 0.004
# A machine that cannot keep up slows the vehicle's time down rather than stalling the clients.
_MOST_PER_TURN_S = 0.1

Record = Callable[[float, bytes], None]


class _Client:
    """Be one peer: the vehicle's port that it is plugged into, and both directions of bytes."""

    def __init__(self, port: int, counts: LinkStatistics) -> None:
        self.port = port
        self.parser = FrameParser(counts)
        self._writers: dict[tuple[int, int], FrameWriter] = {}

    def frame(self, said: Said) -> bytes:
        sender = (said.system, said.component)
        if sender not in self._writers:
            self._writers[sender] = FrameWriter()
        if isinstance(said, SaidMessage) and said.frame is not None:
            return self._writers[sender].forward(said.frame)
        assert said.message is not None
        return self._writers[sender].write(said.message, said.system, said.component)


class VehicleServer:
    """Serve a vehicle. Its time begins with the first client and then goes on, clients or not.

    The first client is plugged into the vehicle's port 0, the next into port 1, and so on; a port is free
    again when its client has gone.

    Args:
        speed: 2 is twice real time.
        is_rebooting: tells that the vehicle reboots; connections are dropped then, as firmware does.
        is_over: tells that there is nothing more to come, which ends serving.
        record: gets the virtual time and the bytes of every frame that leaves by port 0.

    Attributes:
        statistics: what was heard from all clients.
    """

    def __init__(
        self,
        autopilot: Autopilot,
        transport: Transport,
        *,
        speed: float = 1.0,
        is_rebooting: Callable[[], bool] = lambda: False,
        is_over: Callable[[], bool] = lambda: False,
        record: Record | None = None,
    ) -> None:
        self.statistics = LinkStatistics()
        self._autopilot = autopilot
        self._transport = transport
        self._speed = speed
        self._pace: Pace | None = None
        self._is_rebooting = is_rebooting
        self._was_rebooting = False
        self._is_over = is_over
        self._record = record
        self._clients: dict[Peer, _Client] = {}
        self._recorder = _Client(0, LinkStatistics())

    def serve(self, stop: StopRequest) -> None:
        """Serve until asked to stop or it is over; the caller closes the transport."""
        while stop.reason is None and not self._is_over():
            self.turn()
            self._transport.wait(TURN_S)

    def turn(self) -> None:
        """Hear what came, let the vehicle live up to now, send what it said."""
        for peer, data in self._transport.read():
            self._hear(self._client(peer), data)
        if self._pace is None:
            if not self._transport.peers():
                return
            self._pace = Pace(self._speed, self._autopilot.time_s)
        self._meet_clients()
        until_s = self._pace.virtual_now()
        most_s = self._autopilot.time_s + _MOST_PER_TURN_S * self._speed
        if until_s > most_s:
            until_s, self._pace = most_s, Pace(self._speed, most_s)
        for said in self._autopilot.advance(until_s):
            self._send(said)
        self._drop_connections_at_reboot()

    def _hear(self, client: _Client, data: bytes) -> None:
        for frame in client.parser.feed(data):
            self.statistics.count(frame.system, frame.component, frame.sequence)
            message = decode(frame.message_id, frame.payload)
            if message is None:
                self.statistics.unknown += 1
                continue
            self.statistics.received += 1
            self._autopilot.receive(message, frame.system, frame.component, client.port)

    def _send(self, said: Said) -> None:
        if self._record is not None and said.port in (None, 0):
            self._record(said.time_s, self._recorder.frame(said))
        for peer, client in self._clients.items():
            if said.port in (None, client.port) and not self._transport.write(client.frame(said), peer):
                self.statistics.dropped += 1

    def _meet_clients(self) -> None:
        present = self._transport.peers()
        self._clients = {peer: client for peer, client in self._clients.items() if peer in present}
        for peer in present:
            self._client(peer)

    def _client(self, peer: Peer) -> _Client:
        if peer not in self._clients:
            taken = {client.port for client in self._clients.values()}
            port = next(number for number in range(len(taken) + 1) if number not in taken)
            self._clients[peer] = _Client(port, self.statistics)
        return self._clients[peer]

    def _drop_connections_at_reboot(self) -> None:
        rebooting = self._is_rebooting()
        if rebooting and not self._was_rebooting:
            self._transport.hang_up()
        self._was_rebooting = rebooting
