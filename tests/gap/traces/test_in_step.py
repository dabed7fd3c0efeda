"""Lines in the readings of vehicles that drive: of the time, or of a wheel."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from mavcompass.gap.traces.rapid import follows_way

TIME = np.arange(0.0, 60.0, 0.1)


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
    assert follows_way(replayed, 2.0 / circumference_m, line)


def test_a_fast_wheel_is_seen_as_a_slow_line() -> None:
    """0.25 m around: eight turns in a second, read ten times a second."""
    replayed, line = driving(UNEVEN, np.cumsum(UNEVEN) * 0.1 / 0.25)
    assert follows_way(replayed, 2.0, line)


@pytest.mark.parametrize("hertz", [1.3, 2.9, 4.1])
def test_a_line_of_the_time_does_not(hertz: float) -> None:
    replayed, line = driving(UNEVEN, hertz * TIME)
    assert not follows_way(replayed, hertz, line)


def test_what_stands_has_no_way() -> None:
    replayed, line = driving(0.1 + 0.0 * TIME, 1.3 * TIME)
    assert not follows_way(replayed, 1.3, line)


def test_who_drives_evenly_cannot_tell_way_and_time_apart() -> None:
    replayed, line = driving(2.0 + 0.0 * TIME, 1.3 * TIME)
    assert follows_way(replayed, 1.3, line)
