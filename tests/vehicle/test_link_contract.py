"""What every link does, whatever it runs over: one body for all kinds."""

from __future__ import annotations

import contextlib
from collections.abc import Iterator

import pytest
from far_ends import KINDS, FarEnd, Kind

from mavcompass.errors import LinkLost
from mavcompass.messages import Attitude, Heartbeat, NamedValueFloat, ParamSet, ParamValue, RawImu
from mavcompass.vehicle.link import GROUND_STATION, ONBOARD_COMPUTER, Link

Ends = tuple[Link, FarEnd]


@pytest.fixture(params=KINDS)
def kind(request: pytest.FixtureRequest) -> Kind:
    return KINDS[request.param]


@pytest.fixture
def ends(kind: Kind) -> Iterator[Ends]:
    """A link and its other end, which have greeted each other."""
    with kind.make() as (link, far):
        far.say(Heartbeat())  # some links wait to be spoken to,
        link.receive(0.05)
        link.send(Heartbeat())  # others speak first
        assert (1, 191, Heartbeat()) in far.heard(1)
        far.heard(0).clear()
        yield link, far


def hear(link: Link, count: int) -> list[object]:
    heard = []
    while len(heard) < count and (incoming := link.receive(2.0)) is not None:
        heard.append(incoming.message)
    return heard


def test_a_message_is_heard_with_its_sender(ends: Ends) -> None:
    link, far = ends
    far.say(RawImu(xmag=232, ymag=-52), system=4, component=7)
    before_s = link.now()
    incoming = link.receive(2.0)
    assert incoming is not None
    assert (incoming.system, incoming.component) == (4, 7)
    assert incoming.message == RawImu(xmag=232, ymag=-52)
    assert before_s <= incoming.time_s <= link.now()
    assert link.statistics.received >= 1


def test_the_vehicle_hears_us_as_its_onboard_computer(ends: Ends) -> None:
    link, far = ends
    link.identity = ONBOARD_COMPUTER.aboard(9)
    write = ParamSet(9, 1, "COMPASS_OFS_X", 12.5)
    link.send(write)
    assert far.heard(1) == [(9, 191, write)]


def test_the_vehicle_hears_us_as_a_ground_station(ends: Ends) -> None:
    link, far = ends
    link.identity = GROUND_STATION.aboard(9)
    link.send(link.identity.heartbeat())
    assert far.heard(1) == [(255, 190, GROUND_STATION.heartbeat())]


def test_a_burst_keeps_its_order_and_loses_nothing(ends: Ends) -> None:
    link, far = ends
    burst = [NamedValueFloat(i, "n", float(i)) for i in range(100)]
    for message in burst:
        far.say(message)
    assert hear(link, 100) == burst
    assert link.statistics.lost == 0


def test_many_messages_each_way(ends: Ends) -> None:
    link, far = ends
    for i in range(50):
        link.send(ParamSet(1, 1, f"P{i}", i))
        far.say(ParamValue(f"P{i}", i))
    assert hear(link, 50) == [ParamValue(f"P{i}", i) for i in range(50)]
    assert [m for _, _, m in far.heard(50)] == [ParamSet(1, 1, f"P{i}", i) for i in range(50)]


def test_nothing_heard_is_none_after_the_time(ends: Ends) -> None:
    link, _ = ends
    start_s = link.now()
    assert link.receive(0.05) is None
    assert 0.05 <= link.now() - start_s < 0.5
    assert link.receive(0.0) is None


def test_time_never_goes_back(ends: Ends) -> None:
    link, far = ends
    times = [link.now()]
    for i in range(20):
        far.say(Attitude(time_boot_ms=1000 - i))
        incoming = link.receive(2.0)
        assert incoming is not None
        times += [incoming.time_s, link.now()]
    assert times == sorted(times)


def test_a_closed_link_says_so_and_can_be_closed_again(ends: Ends) -> None:
    link, _ = ends
    link.close()
    link.close()
    link.send(Heartbeat())
    assert link.statistics.dropped == 1
    with pytest.raises(LinkLost):
        link.receive(0.01)
    assert list(link) == []


def test_iteration_hands_out_all_and_ends_with_the_other_end(kind: Kind, ends: Ends) -> None:
    link, far = ends
    said = [NamedValueFloat(i, "n", 0.0) for i in range(5)]
    for message in said:
        far.say(message)
    with contextlib.closing(iter(link)) as heard:
        assert [next(heard).message for _ in said] == said
        if kind.tells_the_end:
            far.leave()
            assert list(heard) == []
            with pytest.raises(LinkLost) as caught:
                link.receive(0.1)
            assert caught.value.exit_code == 3
