"""What each method makes of made-up recordings, number by number, as it was when it was stored."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from made_up_recordings import (
    EARTH,
    four_stops,
    hovering,
    tumbling,
    wandering,
    with_late_gyro,
    with_magnet,
    with_reference,
)

from mavcompass.calibration import calibrate_track
from mavcompass.calibration.methods.ellipsoid import fit_ellipsoid, fit_sphere
from mavcompass.calibration.observation import find_dwells
from mavcompass.errors import PoorCalibration
from mavcompass.procedure.positions import Window, prove
from mavcompass.track import Track

MADE: dict[str, Callable[[], Track]] = {
    "four stops": four_stops,
    "beside steel": lambda: with_magnet(four_stops(), 11.0, 18.0),
    "wandering": wandering,
    "iron that moved": lambda: with_magnet(wandering(), 0.0, 38.0),
    "hovering": hovering,
    "tumbling": tumbling,
    "a boat somewhere": lambda: four_stops("boat", -1.0, 21),
    "something passed": lambda: with_magnet(wandering("boat", 22), 40.0, 44.0),
    "no current": lambda: replace(wandering(), current_a=None),
    "with a reference": lambda: with_reference(wandering()),
    "a gyro that is late": lambda: with_late_gyro(four_stops(seed=23)),
}
# All that a motion may hold, through its one fit.
MOVED = ("beside steel", "wandering", "hovering", "tumbling", "a boat somewhere", *list(MADE)[-4:])

OTHERS = ("min-max", "sensitivity-bias", "four-positions-textbook", "four-positions", "sphere", "world-field")
RUNS = [
    *((name, "auto") for name in ("four stops", "beside steel", "wandering", "hovering")),
    *(("four stops", method) for method in OTHERS),
    *((name, "world-field") for name in MOVED),
    *((name, "running") for name in ("wandering", "iron that moved")),
    ("wandering", "min-max"),
    ("tumbling", "ellipsoid"),
]


@pytest.mark.parametrize(("name", "method"), RUNS)
def test_a_result(name: str, method: str, as_stored: Callable[[Any], None]) -> None:
    try:
        earth = None if name.endswith("somewhere") else EARTH
        result = calibrate_track(MADE[name](), method, earth=earth).to_json()
    except PoorCalibration as refusal:
        as_stored([refusal.what, refusal.remedy])
        return
    matrix = result["covariance"].pop("matrix")
    result["covariance"]["sigma"] = [abs(row[k]) ** 0.5 for k, row in enumerate(matrix[:9])]
    as_stored(result)


def test_a_proof(as_stored: Callable[[Any], None]) -> None:
    track = four_stops()
    windows = [Window(dwell.start_s, dwell.end_s, 0.0) for dwell in find_dwells(track)]
    spans = [(window.start_s, window.end_s) for window in windows]
    three, four = (calibrate_track(track, earth=EARTH, windows=spans[:n]) for n in (3, 4))
    proof = prove(track, windows[2], windows[3], [three], [four])
    as_stored([proof, proof.summary()])


def test_lengths(as_stored: Callable[[Any], None]) -> None:
    raw = tumbling().raw_field(1, motors=False)[::2]
    fits = [fit_sphere(raw), fit_ellipsoid(raw), fit_ellipsoid(raw, EARTH.total_mgauss)]
    for fit in fits[1:]:
        assert fit.covariance.shape == (9, 9)
    as_stored([replace(fit, covariance=np.sqrt(np.diag(fit.covariance))) for fit in fits])


def test_a_deviation_card(as_stored: Callable[[Any], None]) -> None:
    result = calibrate_track(four_stops(), earth=EARTH)
    as_stored([result.deviation_card(8), result.deviation_card(16).deviation_deg])
