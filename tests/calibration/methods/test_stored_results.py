"""What each method makes of made-up recordings, number by number, as it was when it was stored."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import pytest
from made_up_recordings import EARTH, four_stops, hovering, tumbling, wandering, with_magnet

from mavcompass.calibration import calibrate_track
from mavcompass.errors import PoorCalibration
from mavcompass.track import Track

MADE: dict[str, Callable[[], Track]] = {
    "four stops": four_stops,
    "beside steel": lambda: with_magnet(four_stops(), 11.0, 18.0),
    "wandering": wandering,
    "iron that moved": lambda: with_magnet(wandering(), 0.0, 38.0),
    "hovering": hovering,
    "tumbling": tumbling,
}


OTHERS = ("min-max", "sensitivity-bias", "four-positions-textbook", "four-positions", "sphere", "world-field")
RUNS = [
    *((name, "auto") for name in MADE if name != "tumbling"),
    *(("four stops", method) for method in OTHERS),
    *((name, "running") for name in ("wandering", "iron that moved")),
    ("wandering", "min-max"),
    ("tumbling", "ellipsoid"),
    ("tumbling", "sphere"),
]


@pytest.mark.parametrize(("name", "method"), RUNS)
def test_a_result(name: str, method: str, as_stored: Callable[[Any], None]) -> None:
    try:
        result = calibrate_track(MADE[name](), method, earth=EARTH).to_json()
    except PoorCalibration as refusal:
        as_stored([refusal.what, refusal.remedy])
        return
    matrix = result["covariance"].pop("matrix")
    result["covariance"]["sigma"] = [abs(row[k]) ** 0.5 for k, row in enumerate(matrix[:9])]
    as_stored(result)
