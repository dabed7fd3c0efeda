"""What every link does, whatever it runs over: one body for all kinds."""

from __future__ import annotations

import contextlib

import pytest
from dialogue import HEARTBEAT
from far_ends import KINDS, SYSTEM, Kind, Saying

from mavcompass.errors import LinkLost
from mavcompass.messages import (
    Attitude,
    Heartbeat,
    Message,
    NamedValueFloat,
    ParamSet,
    ParamValue,
    RawImu,
    Statustext,
)
from mavcompass.messages.bits import bits_of_single, single_from_bits
from mavcompass.vehicle.link import GROUND_STATION, ONBOARD_COMPUTER, Link


@pytest.fixture(params=KINDS)
def kind(request: pytest.FixtureRequest) -> Kind:
    return KINDS[request.param]


def vehicle_says(*messages: Message) -> list[Saying]:
    return [(message, SYSTEM, 1) for message in messages]


def hear(link: Link, count: int) -> list[Message]:
    heard: list[Message] = []
    while len(heard) < count and (incoming := link.receive(2.0)) is not None:
        heard.append(incoming.message)
    return heard


def test_a_message_is_heard_with_its_sender(kind: Kind) -> None:
    with kind.talk([(RawImu(xmag=232, ymag=-52), SYSTEM, 7)]) as (link, _):
        incoming = link.receive(2.0)
        assert incoming is not None
        assert (incoming.system, incoming.component) == (SYSTEM, 7)
        assert incoming.message == RawImu(xmag=232, ymag=-52)
        assert link.statistics.received >= 1
        # Where other programs may reach the vehicle, too, they are kept off what this one works on.
        assert link.shared is (kind not in (KINDS["simulated"], KINDS["replay"]))


def test_the_vehicle_hears_us_as_its_onboard_computer(kind: Kind) -> None:
    with kind.talk() as (link, far):
        link.identity = ONBOARD_COMPUTER.aboard(SYSTEM)
        write = ParamSet(SYSTEM, 1, "COMPASS_OFS_X", 12.5)
        with far.beating():
            link.send(write)
        assert far.heard(1) == [(SYSTEM, 191, write)]


def test_the_vehicle_hears_us_as_a_ground_station(kind: Kind) -> None:
    with kind.talk() as (link, far):
        link.identity = GROUND_STATION.aboard(SYSTEM)
        with far.beating():
            link.send(link.identity.heartbeat())
        assert far.heard(1) == [(255, 190, GROUND_STATION.heartbeat())]


def test_a_burst_keeps_its_order_and_loses_nothing(kind: Kind) -> None:
    burst = [NamedValueFloat(i, "n", float(i)) for i in range(100)]
    with kind.talk(vehicle_says(*burst)) as (link, _):
        assert hear(link, 100) == burst
        assert link.statistics.lost == link.statistics.malformed == 0


def test_texts_numbers_and_arrays_come_through(kind: Kind) -> None:
    said = [Statustext(3, "PreArm: Check mag field (xy diff:118>100)"), Attitude(5, yaw=-3.0), RawImu(2**40)]
    with kind.talk(vehicle_says(*said)) as (link, _):
        assert hear(link, 3) == said


# Whole numbers of PX4 in the place of a float: -1, a quiet and a signalling NaN, the largest, the smallest
# (minus zero), a denormal, infinity; and floats: minus zero, denormals, the largest.
PATTERNS = (
    -1, 0x7FC00000, 0x7F800001, 2**31 - 1, -(2**31), 1, -8_388_608, 0x7F7FFFFF, 0x00400000, -4_194_305,
)  # fmt: skip


def parameter(whole: int) -> float:
    return single_from_bits(whole & 0xFFFFFFFF)


def test_parameters_come_through_bit_for_bit_each_way(kind: Kind) -> None:
    said = [ParamValue("CAL_MAG0_ROT", parameter(whole), 6, 1, i) for i, whole in enumerate(PATTERNS)]
    with kind.talk(vehicle_says(*said)) as (link, far):
        heard = hear(link, len(said))
        assert [bits_of_single(m.param_value) for m in heard if isinstance(m, ParamValue)] == [
            whole & 0xFFFFFFFF for whole in PATTERNS
        ]
        for whole in PATTERNS:
            link.send(ParamSet(SYSTEM, 1, "CAL_MAG0_ROT", parameter(whole), 6))
        sent = [m for _, _, m in far.heard(len(PATTERNS))]
        assert [bits_of_single(m.param_value) for m in sent if isinstance(m, ParamSet)] == [
            whole & 0xFFFFFFFF for whole in PATTERNS
        ]


def test_nothing_heard_is_none_after_the_time(kind: Kind) -> None:
    with kind.talk() as (link, _):
        start_s = link.now()
        assert link.receive(0.05) is None
        assert 0.05 <= link.now() - start_s < 0.5
        assert link.receive(0.0) is None


def test_time_never_goes_back(kind: Kind) -> None:
    said = [Attitude(time_boot_ms=1000 - i) for i in range(20)]
    with kind.talk(vehicle_says(*said)) as (link, _):
        heard_s: list[float] = []  # from nothing on: a message may have arrived before it is asked for
        now_s = [link.now()]
        for _ in said:
            incoming = link.receive(2.0)
            assert incoming is not None
            heard_s.append(incoming.time_s)
            now_s.append(link.now())
            assert incoming.time_s <= link.now()
        assert heard_s == sorted(heard_s)
        assert now_s == sorted(now_s)


def test_a_closed_link_says_so_and_can_be_closed_again(kind: Kind) -> None:
    with kind.talk() as (link, _):
        link.close()
        link.close()
        dropped = link.statistics.dropped
        link.send(Heartbeat())
        assert link.statistics.dropped == dropped + 1
        with pytest.raises(LinkLost):
            link.receive(0.01)
        assert list(link) == []


def test_iteration_hands_out_all_and_ends_with_the_other_end(kind: Kind) -> None:
    said = [NamedValueFloat(i, "n", 0.0) for i in range(5)]
    with kind.talk(vehicle_says(*said)) as (link, far), contextlib.closing(iter(link)) as heard:
        assert [next(heard).message for _ in said] == said
        if kind.tells_the_end:
            far.leave()
            assert [i.message for i in heard if i.message != HEARTBEAT] == []
            with pytest.raises(LinkLost) as caught:
                link.receive(0.1)
            assert caught.value.exit_code == 3
