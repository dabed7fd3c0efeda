"""What is observed in made-up recordings, number by number, as it was when it was stored."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from made_up_recordings import four_stops, hovering, tumbling, wandering, with_magnet

from mavcompass.attitude import levels
from mavcompass.calibration.observation import StillnessDetector, find_dwells, turn_record, turns_between
from mavcompass.calibration.observation.dwells import dwell_between, tilt_during
from mavcompass.track import Track

AsStored = Callable[[Any], None]
MADE: dict[str, Callable[[], Track]] = {
    "four stops": four_stops,
    "wandering": wandering,
    "hovering": hovering,
    "tumbling": tumbling,
    "a boat beside steel": lambda: with_magnet(four_stops("boat", -1.0, 15), 8.0, 10.0),
}


@pytest.fixture(params=MADE)
def track(request: pytest.FixtureRequest) -> Track:
    return MADE[request.param]()


def test_turns(track: Track, as_stored: AsStored) -> None:
    record = turn_record(track)
    assert record is not None
    start = float(record.time_s[0])
    apart = [record.independent_sigma_rad(start + a, start + b) for a, b in ((1.0, 2.0), (0.5, 9.0))]
    numbers = {name: getattr(record, name) for name in ("bias_radps", "bias_sigma_radps", "noise_radps")}
    as_stored(
        {
            **numbers,
            "walk": record.walk_rad,
            "interval": record.interval_s,
            "angle": record.angle_rad[::60],
            "rate": record.rate_radps[::60],
            "tilt rate": record.tilt_rate_radps[::60],
            "sigma": apart,
        }
    )


def test_dwells(track: Track, as_stored: AsStored) -> None:
    dwells = find_dwells(track)
    as_stored({"dwells": dwells, "steps": turns_between(track, dwells)})


def test_stretches(track: Track, as_stored: AsStored) -> None:
    """Whatever it did in them: what is averaged, how unsure, how far it wandered."""
    found = [dwell_between(track, 1, start, start + 1.8) for start in (3.2, 9.0, 13.4)]
    as_stored([found, [tilt_during(track, d.start_s + np.arange(40) * 0.04, 0.03) for d in found]])


def test_down(track: Track, as_stored: AsStored) -> None:
    level = levels(track)
    as_stored({"down": level.down.values[::70], "sigma": level.sigma_rad.values[::70]})


@pytest.mark.parametrize("wheels", [False, True])
def test_rest_told_live(track: Track, wheels: bool, as_stored: AsStored) -> None:
    detector = StillnessDetector(hold_s=0.3, wheels=wheels)
    gyro, acc = track.gyro_radps, track.acc_mps2
    assert gyro is not None and acc is not None
    told: list[Any] = []
    rows = zip(gyro.time_s, gyro.values, acc.values, track.compasses[1].reported.values, strict=True)
    for k, (time_s, rate, force, field) in enumerate(rows):
        said = detector.update(float(time_s), rate, force, field)
        if not told or said.why_not != told[-1][1]:
            told.append([time_s, said.why_not, said.rate_radps, said.turned_rad])
        if k % 250 == 100:
            told.append([time_s, said.why_not, detector.averaging_s(0.006, 2.0)])
    as_stored(told)
