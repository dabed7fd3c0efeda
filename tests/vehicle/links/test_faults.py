"""A link made worse on purpose: in virtual time, by seed."""

from __future__ import annotations

import pytest
from dialogue import MemoryVehicle

from mavcompass.errors import LinkLost
from mavcompass.messages import Heartbeat, NamedValueFloat, ParamSet
from mavcompass.vehicle.link import GROUND_STATION
from mavcompass.vehicle.links.faults import Faults, FaultyLink
from mavcompass.vehicle.links.simulated import SimulatedLink


def talk(
    faults: Faults, seed: int = 1, seconds: float = 10.0
) -> tuple[list[tuple[float, int]], MemoryVehicle]:
    """Let both sides say a number every 100 ms; return what came through, and the vehicle."""
    vehicle = MemoryVehicle(beats=False)
    for i in range(100):
        vehicle.say(NamedValueFloat(i, "n", 0.0), after_s=0.1 * i)
    heard = []
    with FaultyLink(SimulatedLink(vehicle), faults, seed) as link:
        sent = 0
        while link.now() < seconds:
            if link.now() >= 0.1 * sent:
                link.send(ParamSet(1, 1, f"P{sent}", sent))
                sent += 1
            incoming = link.receive(0.02)
            if incoming is not None and isinstance(incoming.message, NamedValueFloat):
                heard.append((incoming.time_s, incoming.message.time_boot_ms))
    return heard, vehicle


def numbers(vehicle: MemoryVehicle) -> list[float]:
    return [m.param_value for _, _, m in vehicle.heard if isinstance(m, ParamSet)]


def test_without_faults_everything_comes_through() -> None:
    heard, vehicle = talk(Faults())
    assert [n for _, n in heard] == list(range(100))
    assert numbers(vehicle) == [float(i) for i in range(100)]


def test_losses_follow_the_seed_and_their_share() -> None:
    heard, vehicle = talk(Faults(loss=0.3, loss_out=0.0))
    assert talk(Faults(loss=0.3, loss_out=0.0))[0] == heard != talk(Faults(loss=0.3, loss_out=0.0), seed=2)[0]
    assert 55 <= len(heard) <= 85
    assert len(numbers(vehicle)) == 100


def test_latency_delays_both_ways() -> None:
    heard, vehicle = talk(Faults(latency_s=0.3))
    assert [n for _, n in heard] == list(range(97))
    assert all(t == pytest.approx(0.1 * n + 0.3, abs=0.011) for t, n in heard)
    assert numbers(vehicle)[:97] == [float(i) for i in range(97)]


def test_duplicates_come_twice_and_reordering_mixes() -> None:
    heard, _ = talk(Faults(duplicate=1.0))
    assert sorted(n for _, n in heard) == sorted([*range(100), *range(100)])[: len(heard)]
    heard, _ = talk(Faults(reorder=0.5, jitter_s=0.5))
    order = [n for _, n in heard]
    assert order != sorted(order) and len(set(order)) == len(order)
    assert [t for t, _ in heard] == sorted(t for t, _ in heard)


def test_a_gap_is_silent_and_ends() -> None:
    heard, vehicle = talk(Faults(cut_at_s=3.0, restored_at_s=5.0))
    assert {n for _, n in heard} == {*range(30), *range(50, 100)}
    assert set(numbers(vehicle)) == {float(n) for n in (*range(30), *range(50, 100))}


def test_a_cut_for_good_is_a_lost_link() -> None:
    with pytest.raises(LinkLost, match="cut"):
        talk(Faults(cut_at_s=3.0, cut_is_final=True))


def test_it_speaks_under_the_identity_that_was_given_to_it() -> None:
    vehicle = MemoryVehicle()
    with FaultyLink(SimulatedLink(vehicle), Faults(), seed=0) as link:
        link.identity = GROUND_STATION
        link.send(Heartbeat())
    assert vehicle.heard == [(255, 190, Heartbeat())]
