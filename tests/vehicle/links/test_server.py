"""The simulated vehicle on real ports, met by clients that come, go and misbehave."""

from __future__ import annotations

import random
import time
from contextlib import closing

import pytest
from dialogue import HEARTBEAT, MemoryVehicle, Said
from serving import hear, serving

from mavcompass.enums import MavCmd, MavResult
from mavcompass.messages import (
    Attitude,
    CommandAck,
    CommandLong,
    Heartbeat,
    Message,
    ParamRequestRead,
    ParamSet,
    ParamValue,
    RawImu,
    message_id,
)
from mavcompass.simulation.vehicle import SimulatedAutopilot
from mavcompass.vehicle.link import GROUND_STATION, Link
from mavcompass.vehicle.links.server import VehicleServer
from mavcompass.vehicle.opening import open_link
from mavcompass.vehicle.transport import Peer, Reconnect, Tcp, UdpIn, UdpOut, open_transport
from mavcompass.vehicle.wire import FrameWriter


def read_parameter(link: Link, name: str) -> float:
    link.send(ParamRequestRead(1, 1, name))
    while True:
        value = hear(link, ParamValue)
        assert isinstance(value, ParamValue)
        if value.param_id == name:
            return value.param_value


def test_time_begins_with_the_first_client_and_the_seed_decides_what_follows() -> None:
    firsts = []
    for pause_s in (0.0, 0.3):
        with serving(SimulatedAutopilot("rover", seed=5), speed=5.0) as (_, port):
            time.sleep(pause_s)
            with open_link(Tcp("127.0.0.1", port)) as link:
                firsts.append(hear(link, Attitude))
    assert firsts[0] == firsts[1]


def test_several_clients_share_the_vehicle_with_their_own_rates() -> None:
    number = float(message_id(RawImu))
    with serving(SimulatedAutopilot("rover", seed=1)) as (_, port):
        with (
            open_link(Tcp("127.0.0.1", port)) as fast,
            open_link(Tcp("127.0.0.1", port), GROUND_STATION) as slow,
        ):
            hear(fast, Heartbeat)
            hear(slow, Heartbeat)
            for link, rate_hz in ((fast, 40.0), (slow, 5.0)):
                link.send(CommandLong(1, 1, MavCmd.SET_MESSAGE_INTERVAL, 0, number, 1e6 / rate_hz))
                ack = hear(link, CommandAck)
                assert isinstance(ack, CommandAck) and ack.result == MavResult.ACCEPTED
            counts = {}
            for link in (fast, slow):
                while link.receive(0.0) is not None:
                    pass
            end_s = fast.now() + 1.0
            for name, link in (("fast", fast), ("slow", slow)):
                counts[name] = 0
                while (incoming := link.receive(max(end_s - link.now(), 0.0))) is not None:
                    counts[name] += isinstance(incoming.message, RawImu)
            assert 32 <= counts["fast"] <= 48
            assert 3 <= counts["slow"] <= 8
            assert fast.statistics.lost == slow.statistics.lost == 0


def test_a_reboot_drops_the_connection_and_the_client_finds_its_way_back() -> None:
    vehicle = SimulatedAutopilot("rover", seed=1, armed=False)
    with serving(vehicle, speed=4.0) as (_, port):
        with open_link(Tcp("127.0.0.1", port), reconnect=Reconnect(again_s=5.0, every_s=0.05)) as link:
            link.send(ParamSet(1, 1, "COMPASS_OFS_Z", 21.0))
            hear(link, ParamValue)
            link.send(CommandLong(1, 1, MavCmd.PREFLIGHT_REBOOT_SHUTDOWN, 0, 1.0))
            end_s = link.now() + 5.0
            while vehicle.boots == 0 and link.now() < end_s:
                link.receive(0.05)
            assert vehicle.boots == 1
            link.send(link.identity.heartbeat())
            hear(link, Heartbeat)
            assert read_parameter(link, "COMPASS_OFS_Z") == 21.0, "written parameters survive"


@pytest.mark.parametrize("waits", [True, False])
def test_udp_works_in_both_directions(waits: bool) -> None:
    vehicle = SimulatedAutopilot("rover", seed=1)
    if waits:
        with serving(vehicle, UdpIn("127.0.0.1", 0), speed=5.0) as (_, port):
            with open_link(UdpOut("127.0.0.1", port)) as link:
                link.send(link.identity.heartbeat())
                assert hear(link, Heartbeat)
    else:
        free = open_transport(UdpIn("127.0.0.1", 0))
        port = int(free.name.rpartition(":")[2])
        free.close()
        with open_link(UdpIn("127.0.0.1", port)) as link, serving(vehicle, UdpOut("127.0.0.1", port), 5.0):
            assert hear(link, Heartbeat)


class Peers:
    """Be a port at which clients come and go as a test wants it."""

    name = "peers"

    def __init__(self) -> None:
        self.here, self.came, self.full = list[Peer](), list[tuple[Peer, bytes]](), list[Peer]()
        self.got = dict[Peer, list[bytes]]()

    def read(self) -> list[tuple[Peer, bytes]]:
        came, self.came = self.came, []
        return came

    def write(self, data: bytes, peer: Peer) -> bool:
        self.got.setdefault(peer, []).append(data)
        return peer not in self.full

    def peers(self) -> list[Peer]:
        return self.here

    def wait(self, timeout_s: float) -> None: ...
    def hang_up(self) -> None: ...
    def close(self) -> None: ...


class Speaker(MemoryVehicle):
    """Beat the heart on all ports and on the second alone, each time that it is asked; keep who asked."""

    def __init__(self) -> None:
        super().__init__()
        self.ports = list[int]()

    def receive(self, message: Message, system: int, component: int, port: int = 0) -> None:
        self.ports.append(port)

    def advance(self, until_s: float) -> list[Said]:
        self.time_s = until_s
        return [Said(until_s, 1, 1, HEARTBEAT), Said(until_s, 1, 1, Attitude(), 1)]


def test_a_client_keeps_its_port_until_it_goes_and_then_the_next_one_has_it() -> None:
    transport, vehicle, asks = Peers(), Speaker(), FrameWriter().write(ParamRequestRead(1, 1, "A"), 9, 9)
    server = VehicleServer(vehicle, transport)
    server.turn()
    assert not transport.got and not vehicle.time_s, "its time begins with the first client"
    turns = (["a"], ["a", "b"], ["b", "a"], ["b"], ["b", "c"], ["b", "c", "d"])
    for here in turns:
        transport.here = list(here)
        transport.came = [(peer, asks) for peer in here]
        server.turn()
    assert vehicle.ports == [0, 0, 1, 1, 0, 1, 1, 0, 1, 0, 2]
    kinds = {peer: [raw[7] for raw in got] for peer, got in transport.got.items()}
    beat, attitude = 0, 30
    assert kinds == {"a": [beat] * 3, "b": [beat, attitude] * 5, "c": [beat] * 2, "d": [beat]}
    assert [raw[4] for raw in transport.got["b"]] == list(range(10)), "each client's frames are numbered on"


def test_a_frame_that_comes_in_two_turns_is_one_and_what_a_client_does_not_take_is_counted() -> None:
    transport, vehicle, asks = Peers(), Speaker(), FrameWriter().write(ParamRequestRead(1, 1, "A"), 9, 9)
    server, transport.here, transport.full = VehicleServer(vehicle, transport), ["a", "b"], ["b"]
    for piece in (asks[:8], asks[8:]):
        transport.came = [("a", piece)]
        server.turn()
    assert (server.statistics.received, server.statistics.malformed) == (1, 0)
    assert server.statistics.dropped == 4  # of the second client, two a turn


def test_junk_is_counted_and_hurts_nobody() -> None:
    rng = random.Random(3)
    with serving(SimulatedAutopilot("rover", seed=1), speed=5.0) as (server, port):
        attacker = open_transport(Tcp("127.0.0.1", port))
        with closing(attacker), open_link(Tcp("127.0.0.1", port)) as link:
            (peer,) = attacker.peers()
            for _ in range(50):
                attacker.write(rng.randbytes(400), peer)
            request = FrameWriter().write(ParamRequestRead(1, 1, "COMPASS_USE"), 9, 9)
            attacker.write(bytes(300) + request, peer)
            while (9, 9) not in server.statistics.sources:
                assert hear(link, Heartbeat)
    assert server.statistics.malformed > 0
    assert server.statistics.sources[9, 9].received == 1


def test_what_leaves_is_recorded_as_frames() -> None:
    recorded: list[tuple[float, bytes]] = []
    vehicle = SimulatedAutopilot("rover", seed=1)
    with serving(vehicle, speed=5.0, record=lambda t, frame: recorded.append((t, frame))) as (_, port):
        with open_link(Tcp("127.0.0.1", port)) as link:
            hear(link, Attitude)
    assert recorded and all(frame[0] == 0xFD for _, frame in recorded)
    assert [t for t, _ in recorded] == sorted(t for t, _ in recorded)
