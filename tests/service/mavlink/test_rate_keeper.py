"""How the service keeps the messages coming."""

from __future__ import annotations

from mavcompass import messages as mav
from mavcompass.service.mavlink.rates import RateKeeper


def ask(keeper: RateKeeper, start_s: float, seconds: float, heard_hz: float = 0.0) -> list[mav.CommandLong]:
    """Live for a while, hearing RAW_IMU at a rate; return what was asked for."""
    asked: list[mav.CommandLong] = []
    steps = int(seconds * 100)
    for k in range(steps):
        if heard_hz and int(k * heard_hz / 100) != int((k - 1) * heard_hz / 100):
            keeper.count(mav.RawImu)
        asked += keeper.due(start_s + 0.01 * k, 1)  # type: ignore[arg-type]
    return asked


def test_what_does_not_come_is_asked_for_again_more_and_more_patiently() -> None:
    asked = ask(RateKeeper({mav.RawImu: 50.0}), 0.0, 60.0)
    assert 6 <= len(asked) <= 10 and 24 <= len(ask(RateKeeper({mav.RawImu: 50.0}), 0.0, 600.0)) <= 28
    assert [a.param2 for a in asked[:5]] == [20000.0, 20000.0, 40000.0, 40000.0, 80000.0]
    assert {a.param1 for a in asked} == {27.0}


def test_what_comes_is_left_alone() -> None:
    keeper = RateKeeper({mav.RawImu: 50.0})
    assert len(ask(keeper, 0.0, 1.0, 50.0)) == 1
    assert ask(keeper, 1.0, 30.0, 50.0) == []
    assert ask(keeper, 31.0, 30.0, 40.0) == []  # losses are no reason


def test_a_lower_rate_that_is_granted_is_settled_for() -> None:
    """A rover denies 50 Hz and keeps its old rate; it grants 25."""
    keeper = RateKeeper({mav.RawImu: 50.0})
    assert [a.param2 for a in ask(keeper, 0.0, 3.0, 2.0)] == [20000.0, 20000.0, 40000.0]
    ask(keeper, 3.0, 1.0, 25.0)
    assert ask(keeper, 4.0, 30.0, 25.0) == []


def test_a_vehicle_that_comes_back_is_asked_at_once() -> None:
    keeper = RateKeeper({mav.RawImu: 50.0, mav.Attitude: 10.0})
    ask(keeper, 0.0, 40.0)
    keeper.vehicle_is_back()
    assert len(keeper.due(40.0, 1)) == 2


def test_rates_are_given_back_at_the_end() -> None:
    keeper = RateKeeper({mav.RawImu: 50.0})
    keeper.due(0.0, 1)
    goodbye = keeper.goodbye(1)
    assert [(g.param1, g.param2) for g in goodbye if isinstance(g, mav.CommandLong)] == [(27.0, 0.0)]
    assert keeper.goodbye(1) == []
