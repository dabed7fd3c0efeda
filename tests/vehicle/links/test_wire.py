"""MAVLink over real ports: several vehicles, old versions, signatures, losses, connections that break."""

from __future__ import annotations

import logging
import os
import socket
import sys
import threading
import time
import tty
from collections.abc import Iterator
from contextlib import closing
from pathlib import Path

import pytest
from dialogue import HEARTBEAT
from far_ends import QUICK, WireEnd

from mavcompass.errors import NoVehicle, UsageError
from mavcompass.messages import Heartbeat, NamedValueFloat, ParamRequestRead, RawImu, Statustext
from mavcompass.vehicle.link import LinkStatistics, SourceStatistics
from mavcompass.vehicle.links.wire import WireLink
from mavcompass.vehicle.opening import open_link
from mavcompass.vehicle.transport import Serial, Tcp, TcpIn, UdpIn, UdpOut, open_transport
from mavcompass.vehicle.transport.transport import READ_BYTES, SEND_BUFFER_BYTES, Reconnect
from mavcompass.vehicle.transport.udp import UdpTransport
from mavcompass.vehicle.wire import FrameParser, FrameWriter, Signing


@pytest.fixture
def port() -> Iterator[UdpTransport]:
    """A UDP port that waits for vehicles."""
    transport = open_transport(UdpIn("127.0.0.1", 0))
    assert isinstance(transport, UdpTransport)
    with closing(transport):
        yield transport


def vehicle_at(port: UdpTransport) -> WireEnd:
    return WireEnd(open_transport(UdpOut("127.0.0.1", port.port)))


# --- several vehicles on one port ----------------------------------------------------------------


def test_a_message_for_one_vehicle_goes_only_to_it(port: UdpTransport) -> None:
    link = WireLink(port)
    with closing(vehicle_at(port).transport) as a, closing(vehicle_at(port).transport) as b:
        one, two = WireEnd(a), WireEnd(b)
        one.say(HEARTBEAT, system=1)
        two.say(HEARTBEAT, system=2)
        assert {link.receive(1.0).system, link.receive(1.0).system} == {1, 2}  # type: ignore[union-attr]
        link.send(ParamRequestRead(2, 1, "A"))
        link.send(link.identity.heartbeat())
        assert [m for _, _, m in two.heard(2)] == [ParamRequestRead(2, 1, "A"), link.identity.heartbeat()]
        assert [m for _, _, m in one.heard(1)] == [link.identity.heartbeat()]


def test_a_vehicle_that_moves_to_another_port_is_followed(port: UdpTransport) -> None:
    link = WireLink(port)
    for _ in range(2):
        with closing(vehicle_at(port).transport) as transport:
            vehicle = WireEnd(transport)
            vehicle.say(HEARTBEAT, system=1)
            assert link.receive(1.0) is not None
            link.send(ParamRequestRead(1, 1, "A"))
            assert [m for _, _, m in vehicle.heard(1)] == [ParamRequestRead(1, 1, "A")]


def test_nobody_to_send_to_is_counted(port: UdpTransport) -> None:
    link = WireLink(port)
    link.send(Heartbeat())
    assert link.statistics.dropped == 1


def test_what_comes_while_we_are_busy_is_kept(port: UdpTransport) -> None:
    with closing(vehicle_at(port).transport) as transport:
        (peer,) = transport.peers()
        for _ in range(400):  # half a second of PX4's telemetry
            assert transport.write(bytes(40), peer)
    assert sum(len(port.read()) for _ in range(2)) == 400


# --- versions and signatures ---------------------------------------------------------------------


def test_a_vehicle_that_only_speaks_version_1_is_answered_in_it(
    port: UdpTransport, monkeypatch: pytest.MonkeyPatch
) -> None:
    link = WireLink(port)
    clock = [100.0]
    monkeypatch.setattr(link, "now", lambda: clock[0])
    with closing(vehicle_at(port).transport) as transport:
        (peer,) = transport.peers()

        def spoken_version(written_in: int) -> int:
            transport.write(FrameWriter(written_in).write(HEARTBEAT, 1, 1), peer)
            while link.receive(0.0) is None:
                port.wait(1.0)
            link.send(RawImu())
            while not (pieces := transport.read()):
                transport.wait(1.0)
            (frame,) = FrameParser(LinkStatistics()).feed(pieces[0][1])
            return frame.version

        assert spoken_version(1) == 2, "it may speak version 2 once it hears it"
        clock[0] += 1.0
        assert spoken_version(1) == 2
        clock[0] += 4.0
        assert spoken_version(1) == 1, "it had its chance"
        assert spoken_version(2) == 2, "it changed its mind"
        clock[0] += 10.0
        assert spoken_version(1) == 2, "it can speak version 2"


# --- what is lost --------------------------------------------------------------------------------


def test_losses_are_counted_by_sequence_numbers(port: UdpTransport) -> None:
    link = WireLink(port)
    with closing(vehicle_at(port).transport) as transport:
        (peer,) = transport.peers()
        writer = FrameWriter()
        frames = [writer.write(NamedValueFloat(i, "n", 0.0), 1, 1) for i in range(40)]
        order = [*range(10), 14, 13, 15, 15, *range(16, 40)]
        for i in order:
            transport.write(frames[i], peer)
        assert sum(1 for _ in order if link.receive(1.0) is not None) == len(order)
    statistics = link.statistics.sources[1, 1]
    assert (statistics.received, statistics.lost, statistics.late) == (len(order), 4, 2)
    assert link.statistics.lost == 4


@pytest.mark.parametrize(("back_to", "late"), [(0, 0), (83, 0), (84, 1), (99, 1)])
def test_a_restarted_sender_is_not_a_loss(back_to: int, late: int) -> None:
    statistics = SourceStatistics()
    for sequence in [*range(100), back_to]:
        statistics.count(sequence)
    assert (statistics.lost, statistics.late, statistics.received) == (0, late, 101)


# --- connections that are refused or break -------------------------------------------------------


def free_port() -> int:
    transport = open_transport(TcpIn("127.0.0.1", 0))
    transport.close()
    return int(transport.name.rpartition(":")[2])


def test_a_refused_connection_is_no_vehicle() -> None:
    with pytest.raises(NoVehicle, match="refused") as caught:
        open_link(Tcp("127.0.0.1", free_port()), reconnect=Reconnect(first_s=0.0))
    assert caught.value.exit_code == 3 and "running" in caught.value.remedy


def test_a_server_that_starts_a_moment_later_is_waited_for() -> None:
    number = free_port()
    servers = []
    timer = threading.Timer(0.2, lambda: servers.append(open_transport(TcpIn("127.0.0.1", number))))
    timer.start()
    with open_link(Tcp("127.0.0.1", number), reconnect=Reconnect(first_s=3.0, every_s=0.02)):
        timer.join()
    servers[0].close()


def test_a_broken_tcp_connection_is_opened_again(caplog: pytest.LogCaptureFixture) -> None:
    caplog.set_level(logging.INFO)
    server = open_transport(TcpIn("127.0.0.1", 0))
    number = int(server.name.rpartition(":")[2])
    with (
        closing(server),
        open_link(Tcp("127.0.0.1", number), reconnect=Reconnect(again_s=5.0, every_s=0.02)) as link,
    ):
        far = WireEnd(server)
        for _ in range(3):
            while not server.peers():
                far.heard(0)
                link.receive(0.02)
            asked_s = link.now()
            threading.Timer(0.1, far.say, [HEARTBEAT]).start()
            assert link.receive(20.0) is not None and link.now() - asked_s < 10.0  # as soon as it comes
            server.hang_up()
        with closing(open_transport(Tcp("127.0.0.1", number))) as ours:
            ours.hang_up()
            assert not ours.peers()
            ours.wait(1.0)
            assert ours.peers()
            began_s = time.monotonic()
            ours.wait(0.2)
            assert time.monotonic() - began_s > 0.15, "it sleeps while nothing comes"
    assert f"tcp:127.0.0.1:{number} broke (closed by the other end), trying again" in caplog.messages


def test_a_usb_port_that_vanishes_and_comes_back_is_opened_again(tmp_path: Path) -> None:
    device = tmp_path / "ttyACM0"
    masters = []

    def plug_in() -> None:
        master, slave = os.openpty()
        tty.setraw(slave)
        device.unlink(missing_ok=True)
        device.symlink_to(os.ttyname(slave))
        masters.append((master, slave))

    plug_in()
    frame = FrameWriter().write(HEARTBEAT, 1, 1)
    with open_link(Serial(str(device)), reconnect=Reconnect(again_s=5.0, every_s=0.02)) as link:
        os.write(masters[0][0], frame)
        assert link.receive(1.0) is not None
        os.close(masters[0][1])
        os.close(masters[0][0])
        device.unlink()
        assert link.receive(0.1) is None
        link.send(Heartbeat())
        assert link.statistics.dropped == 1
        plug_in()
        link.receive(0.1)
        os.write(masters[1][0], frame)
        assert link.receive(2.0) is not None
    for file in masters[1]:
        os.close(file)


def test_a_serial_port_that_is_not_there_is_no_vehicle() -> None:
    with pytest.raises(NoVehicle, match="No such file") as caught:
        open_link(Serial("/dev/ttyNOPE"), reconnect=Reconnect(first_s=0.0))
    assert "dialout" in caught.value.remedy


def test_a_serial_port_that_somebody_holds_is_not_shared() -> None:
    master, slave = os.openpty()
    device = Serial(os.ttyname(slave))
    with open_link(device), pytest.raises(NoVehicle):
        open_link(device, reconnect=Reconnect(first_s=0.0))
    for file in (master, slave):
        os.close(file)


def test_a_port_in_use_is_told() -> None:
    with closing(open_transport(UdpIn("127.0.0.1", 0))) as taken:
        number = int(taken.name.rpartition(":")[2])
        with pytest.raises(UsageError, match="cannot be listened on") as caught:
            open_link(UdpIn("127.0.0.1", number))
    assert caught.value.remedy


def test_an_unknown_host_is_told() -> None:
    with pytest.raises(UsageError, match="not known"):
        open_link(UdpOut("no-such-host.invalid", 14550))


def test_serial_without_pyserial_says_what_to_install(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "serial", None)
    with pytest.raises(UsageError, match="pip install"):
        open_link(Serial("/dev/ttyACM0"))


def test_a_peer_that_does_not_read_costs_only_its_own_messages() -> None:
    server = open_transport(TcpIn("127.0.0.1", 0))
    number = int(server.name.rpartition(":")[2])
    with closing(server), closing(open_transport(Tcp("127.0.0.1", number), QUICK)):
        while not server.peers():
            server.wait(0.1)
            server.read()
        link = WireLink(server)
        frames = 0
        while not link.statistics.dropped and frames < 500_000:
            link.send(NamedValueFloat(1, "n", 1.0))
            frames += 1
        assert link.statistics.dropped == 1
        assert frames * 20 > SEND_BUFFER_BYTES


def test_what_a_connection_that_was_cut_does_not_take_is_counted() -> None:
    with closing(open_transport(TcpIn("127.0.0.1", 0))) as server:
        peer = socket.create_connection(("127.0.0.1", int(server.name.rpartition(":")[2])))
        while not server.peers():
            server.wait(0.1)
            server.read()
        link = WireLink(server)
        link.send(Heartbeat())
        peer.close()  # with something unread: it is reset
        link.send(Heartbeat())
        assert link.statistics.dropped == 1 and server.peers() == []


def test_a_flood_of_messages_neither_fills_the_memory_nor_keeps_us_from_sending(port: UdpTransport) -> None:
    """50 000 a second and more: what is read in one turn is bounded, the rest is the socket's to drop."""
    link = WireLink(port)
    frame = FrameWriter().write(Statustext(6, "x" * 50), 1, 1)
    datagram = frame * 480  # 30 kB
    with closing(vehicle_at(port).transport) as far_end:
        (peer,) = far_end.peers()
        for _ in range(20):
            far_end.write(datagram, peer)
        assert link.receive(0.0) is not None
        assert 480 < len(link._heard) < 2 * READ_BYTES / len(frame)
        assert link.behind_s() > 0.0
        while link.receive(0.0) is not None:
            pass
        assert link.behind_s() < 0.1


def test_a_flood_of_senders_is_forgotten_but_for_the_latest(
    port: UdpTransport, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("mavcompass.vehicle.transport.udp._MOST_PEERS", 4)
    link = WireLink(port)
    for _ in range(9):
        with closing(vehicle_at(port).transport) as transport:
            (peer,) = transport.peers()
            transport.write(FrameWriter().write(HEARTBEAT, 1, 1), peer)
            assert link.receive(1.0) is not None
    assert len(port.peers()) == 4
    assert len(link._channels) <= 5 and len(link._homes[1]) <= 5


@pytest.mark.parametrize("given", [None, "one of nine"])
@pytest.mark.parametrize("written", ["seven of nine\n", Signing.from_passphrase("seven of nine").key.hex()])
def test_a_key_in_a_file_signs_every_frame_where_none_is_given(
    written: str, given: str | None, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    key_file = tmp_path / "key"
    key_file.write_text(written)
    monkeypatch.setenv("MAVCOMPASS_SIGN_KEY", str(key_file))
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as far_end:
        far_end.bind(("127.0.0.1", 0))
        far_end.settimeout(5.0)
        signing = None if given is None else Signing.from_passphrase(given)
        with open_link(f"udpout:127.0.0.1:{far_end.getsockname()[1]}", signing=signing) as link:
            link.send(Heartbeat())
            frame = far_end.recv(300)
    assert frame[0] == 0xFD and Signing.from_passphrase(given or "seven of nine").accepts(frame, 1, 191)


@pytest.mark.parametrize("content", [None, b"", b"two\nlines\n", b"\xff\xfe"])
def test_a_file_that_holds_no_key_says_what_one_is(content: bytes | None, tmp_path: Path) -> None:
    if content is not None:
        (tmp_path / "key").write_bytes(content)
    with pytest.raises(UsageError, match="key") as caught:
        Signing.of_file(tmp_path / "key")
    assert "64 hexadecimal digits" in caught.value.remedy
