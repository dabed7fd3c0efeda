"""What is told live of made-up recordings, number by number, as it was when it was stored.

What is observed in them is held by what is made of it: methods/test_stored_results.py.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import pytest
from made_up_recordings import four_stops, hovering, tumbling, wandering, with_magnet

from mavcompass.calibration.observation import StillnessDetector
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
