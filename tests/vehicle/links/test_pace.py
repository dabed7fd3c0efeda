"""Virtual time waits for the wall clock, at the speed that was asked for."""

from __future__ import annotations

import pytest

from mavcompass.vehicle.links import autopilot as room
from mavcompass.vehicle.links.autopilot import Pace


class Wall:
    """A wall clock that goes on only while somebody sleeps."""

    def __init__(self) -> None:
        self.now_s = 1000.0
        self.slept_s: list[float] = []

    def monotonic(self) -> float:
        return self.now_s

    def sleep(self, seconds: float) -> None:
        self.slept_s.append(seconds)
        self.now_s += seconds


@pytest.fixture
def wall(monkeypatch: pytest.MonkeyPatch) -> Wall:
    wall = Wall()
    monkeypatch.setattr(room, "time", wall)
    return wall


@pytest.mark.parametrize("speed", [0.5, 1.0, 4.0])
def test_twenty_virtual_seconds_take_twenty_by_the_speed(wall: Wall, speed: float) -> None:
    pace = Pace(speed, virtual_s=50.0)
    pace.sleep_until(70.0)
    assert wall.slept_s == [pytest.approx(20.0 / speed)]
    assert pace.virtual_now() == pytest.approx(70.0)


def test_who_is_late_does_not_wait(wall: Wall) -> None:
    pace = Pace(2.0, virtual_s=0.0)
    wall.now_s += 30.0
    assert pace.virtual_now() == pytest.approx(60.0)
    pace.sleep_until(60.0)
    pace.sleep_until(59.0)
    assert wall.slept_s == []
