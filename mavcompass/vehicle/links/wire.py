"""WireLink: MAVLink over a transport, as a Link."""

from __future__ import annotations

import math
import time
from collections import deque
from collections.abc import Callable
from contextlib import suppress

from mavcompass.enums import COMPONENT_AUTOPILOT
from mavcompass.messages import Incoming, Message
from mavcompass.vehicle.link import ONBOARD_COMPUTER, Identity, Link
from mavcompass.vehicle.transport import Peer, Transport
from mavcompass.vehicle.wire import Frame, FrameParser, FrameWriter, Signing, decode

# A vehicle that could speak version 2 does so soon after it heard it; one that has not by now cannot.
_ANSWERS_IN_VERSION_2_S = 3.0
# A system is sent to where it was heard within this time.
_HOME_S = 10.0


class _Channel:
    """Be the conversation with one peer: its bytes, our sequence numbers, the version it understands."""

    def __init__(self, link: WireLink, signing: Signing | None) -> None:
        self.parser = FrameParser(link.statistics, signing)
        self.writer = FrameWriter(2, signing)
        self._spoke_version_2_s: float | None = None
        self._knows_version_2 = signing is not None

    def heard(self, frame: Frame, now_s: float) -> None:
        """Fall back to version 1 for a vehicle that sticks to it, and return when it changes its mind."""
        if frame.version == 2:
            self._knows_version_2 = True
            self.writer.version = 2
        elif not self._knows_version_2 and self._spoke_version_2_s is not None:
            if now_s - self._spoke_version_2_s > _ANSWERS_IN_VERSION_2_S:
                self.writer.version = 1

    def write(self, message: Message, identity: Identity, now_s: float) -> bytes:
        if self._spoke_version_2_s is None:
            self._spoke_version_2_s = now_s
        return self.writer.write(message, identity.spoken_system, identity.component)


class WireLink(Link):
    """Speak MAVLink over UDP, TCP or a serial port.

    A message with a target system goes to the peers where that system was heard lately; any other to all.

    Attributes:
        on_frame: called with every good frame that is heard, before its message is handed out.
    """

    shared = True

    def __init__(
        self, transport: Transport, identity: Identity = ONBOARD_COMPUTER, signing: Signing | None = None
    ) -> None:
        super().__init__(transport.name, identity)
        self._transport = transport
        self._signing = signing
        self._channels: dict[Peer, _Channel] = {}
        self._homes: dict[int, dict[Peer, float]] = {}
        self._heard: deque[Incoming] = deque()
        self._read_all_s = math.inf
        self.on_frame: Callable[[Frame], None] | None = None

    def now(self) -> float:
        """Return the monotonic clock."""
        return time.monotonic()

    def behind_s(self) -> float:
        """Return the time since all was read that had come."""
        return max(self.now() - self._read_all_s, 0.0)

    def send(self, message: Message) -> None:
        """Send to the vehicle's peer, or to all."""
        now_s = self.now()
        for peer in self._peers_of(getattr(message, "target_system", 0)) or [None]:
            if peer is None or not self._send_to(peer, message, now_s):
                self.statistics.dropped += 1

    def _send_to(self, peer: Peer, message: Message, now_s: float) -> bool:
        return self._transport.write(self._channel(peer).write(message, self.identity, now_s), peer)

    def _peers_of(self, target_system: int) -> list[Peer]:
        peers = self._transport.peers()
        if not target_system or target_system not in self._homes:
            return peers
        # A vehicle forwards the heartbeats of stations that are also heard directly: both ways are theirs.
        oldest_s = self.now() - _HOME_S
        homes = [peer for peer, heard_s in self._homes[target_system].items() if heard_s >= oldest_s]
        return [peer for peer in peers if peer in homes] or peers

    def receive(self, timeout_s: float) -> Incoming | None:
        """Return the next message; see Link."""
        began_s = self.now()
        deadline_s, self._read_all_s = began_s + timeout_s, min(self._read_all_s, began_s)
        while not self._heard:
            pieces = self._transport.read()
            if not pieces:
                self._read_all_s = self.now()
            for peer, data in pieces:
                self._take(peer, data)
            remaining_s = deadline_s - self.now()
            if not self._heard:
                if remaining_s <= 0.0:
                    return None
                self._transport.wait(remaining_s)
        self.statistics.received += 1
        return self._heard.popleft()

    def close(self) -> None:
        """Close the port."""
        self._transport.close()
        if self._signing is not None:
            with suppress(OSError):  # then what was kept ahead holds
                self._signing.keep()

    def _channel(self, peer: Peer) -> _Channel:
        if peer not in self._channels:
            present = {*self._transport.peers(), peer}
            self._channels = {p: channel for p, channel in self._channels.items() if p in present}
            self._channels[peer] = _Channel(self, self._signing)
            for homes in self._homes.values():
                for gone in homes.keys() - present:
                    del homes[gone]
        return self._channels[peer]

    def _take(self, peer: Peer, data: bytes) -> None:
        now_s = self.now()
        channel = self._channel(peer)
        for frame in channel.parser.feed(data):
            message = decode(frame.message_id, frame.payload)
            self.statistics.count(frame.system, frame.component, frame.sequence, message)
            self._homes.setdefault(frame.system, {})[peer] = now_s
            if self.on_frame is not None:
                self.on_frame(frame)
            if message is None:
                self.statistics.unknown += 1
                continue
            # Other stations' frames on the same peer tell nothing of what the autopilot understands.
            if frame.component == COMPONENT_AUTOPILOT:
                channel.heard(frame, now_s)
            self._heard.append(Incoming(now_s, frame.system, frame.component, message))
