"""Lines in the readings of vehicles that drive: of the time, or of a wheel."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from mavcompass.gap.traces.rapid import follows_way, keeps_step

TIME = np.arange(0.0, 60.0, 0.1)


@pytest.mark.parametrize(
    ("speed_mps", "hertz", "by_position", "in_step"),
    [
        (2.0 + 0.0 * TIME, 1.3, False, True),
        (2.0 + 0.0 * TIME, 1.3, True, True),
        (2.0 + 0.2 * np.sin(0.1 * TIME), 1.3, False, False),  # by 2 m: more than a turn
        (2.0 + 0.02 * np.sin(0.1 * TIME), 1.3, False, True),
        (2.0 + 0.02 * np.sin(0.1 * TIME), 13.0, False, True),  # by a turn, which no receiver tells
        (2.0 + 0.08 * np.sin(0.1 * TIME), 13.0, False, False),
        (0.1 + 0.0 * TIME, 1.3, False, False),  # it stands
        (np.where(TIME < 30.0, 2.0, 0.0), 1.3, False, False),
        (np.where(TIME < 30.0, 2.0, np.nan), 1.3, False, False),
    ],
)
def test_a_line_may_be_of_something_that_turns_as_the_vehicle_drives_evenly(
    speed_mps: Any, hertz: float, by_position: bool, in_step: bool
) -> None:
    velocity = np.stack([0.6 * speed_mps, -0.8 * speed_mps, 0.0 * speed_mps], axis=1)
    position = np.cumsum(velocity, axis=0) * 0.1
    stimulus = SimpleNamespace(
        time_s=TIME,
        velocity_ned_mps=np.full_like(velocity, np.nan) if by_position else velocity,
        position_ned_m=position,
    )
    driven: Any = SimpleNamespace(signals=SimpleNamespace(stimulus=stimulus))
    assert keeps_step(driven, hertz) == in_step


def driving(speed_mps: Any, turns: Any, scale: float = 1.0) -> tuple[Any, Any]:
    """Return the readings of a vehicle in whose field something turns, as a replay has them once the line is
    taken out, and the line."""
    nothing = 0.0 * TIME
    velocity = np.stack([speed_mps, nothing, nothing], axis=1)
    stimulus = SimpleNamespace(time_s=TIME, velocity_ned_mps=velocity, position_ned_m=0.0 * velocity)
    line = np.stack([np.cos(2.0 * np.pi * turns), np.sin(2.0 * np.pi * turns), nothing], axis=1)
    field = 4.0 * line + scale * np.random.default_rng(4).standard_normal(line.shape)
    taken = 0.5 * line
    readings = SimpleNamespace(time_s=TIME, error_mgauss=field - taken, period_s=0.1)
    return SimpleNamespace(signals=SimpleNamespace(stimulus=stimulus), readings=readings), taken


UNEVEN = 2.0 + 0.15 * np.sin(0.1 * TIME) + 0.05 * np.sin(0.37 * TIME)


@pytest.mark.parametrize("circumference_m", [0.9, 1.7])
def test_a_magnet_on_a_wheel_goes_with_the_way_however_it_drives(circumference_m: float) -> None:
    way = np.cumsum(UNEVEN) * 0.1
    replayed, line = driving(UNEVEN, way / circumference_m)
    assert not keeps_step(replayed, 2.0 / circumference_m)
    assert follows_way(replayed, line, 2.0 / circumference_m)


def test_a_fast_wheel_is_seen_as_a_slow_line() -> None:
    """0.25 m around: eight turns in a second, read ten times a second."""
    replayed, line = driving(UNEVEN, np.cumsum(UNEVEN) * 0.1 / 0.25)
    assert follows_way(replayed, line, 2.0)


@pytest.mark.parametrize("hertz", [1.3, 2.9, 4.1])
def test_a_line_of_the_time_does_not(hertz: float) -> None:
    assert not follows_way(*driving(UNEVEN, hertz * TIME), hertz)


def test_what_stands_has_no_way() -> None:
    assert not follows_way(*driving(0.1 + 0.0 * TIME, 1.3 * TIME), 1.3)
