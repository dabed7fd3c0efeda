"""What a recording is refused for before anything is fitted, and compasses held against each other."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
from calibration_worlds import Iron, turning_track

from mavcompass.calibration import calibrate
from mavcompass.calibration.calibrate import _check_compass
from mavcompass.calibration.recorded import Recorded
from mavcompass.correction import FieldCorrection
from mavcompass.earth_field import EarthField
from mavcompass.errors import PoorCalibration
from mavcompass.frames import FloatArray
from mavcompass.track import InForce, MagSeries, Series, Track

TIME = np.arange(200.0) * 0.1


def recording(field: FloatArray, deg_s: float = 0.0, correction: FieldCorrection | None = None) -> Track:
    gyro = np.zeros((200, 3))
    gyro[:, 1] = math.radians(deg_s)
    in_force = (InForce(-np.inf, correction or FieldCorrection()),)
    return Track(
        source="x.tlog",
        compasses={1: MagSeries(1, Series.of(TIME, field), in_force)},
        gyro_radps=Series.of(TIME, gyro),
    )


def swinging(mgauss: float, mean: tuple[float, float, float] = (200.0, 0.0, 400.0)) -> FloatArray:
    """Swing by so much from end to end, 1 % of the readings beyond it on either side."""
    field = np.tile(np.asarray(mean), (200, 1))
    field[:, 1] += mgauss * (np.arange(200) % 2 - 0.5)
    field[0, 1], field[1, 1] = 1e4, -1e4
    return field


def empty() -> MagSeries:
    return MagSeries(1, Series.of([], np.empty((0, 3))))


def test_a_reading_that_is_repeated_while_the_vehicle_turns_by_45_degrees_is_frozen() -> None:
    for degrees, frozen in ((44.0, False), (46.0, True)):
        field = swinging(90.0)
        field[50:120] = field[50]
        track = recording(field)
        assert track.gyro_radps is not None
        track.gyro_radps.values[60:70, 2] = math.radians(degrees)
        if frozen:
            with pytest.raises(PoorCalibration, match=r"is frozen\. [67] s after its first reading"):
                _check_compass(track, 1)
        else:
            _check_compass(track, 1)


def test_a_place_is_asked_for_only_where_the_world_is_wanted() -> None:
    track = turning_track(Iron((30.0, -20.0, 5.0)))
    with_world = calibrate.calibrate_track(track, "four-positions", earth=EarthField((232.0, 52.7, -528.9)))
    without = calibrate.calibrate_track(
        track, "four-positions", earth=EarthField((232.0, 52.7, -528.9)), use_world_model=False
    )
    assert with_world.vertical_mgauss == pytest.approx(-528.9, abs=20.0)
    assert without.correction.offsets_mgauss[2] == 0.0 != with_world.correction.offsets_mgauss[2]


def test_in_force_is_what_was_at_the_end_and_what_was_not_applied() -> None:
    late, never = FieldCorrection((5.0, 0.0, 0.0)), FieldCorrection((9.0, 0.0, 0.0))
    steps = (InForce(-np.inf, FieldCorrection()), InForce(15.0, late))
    compass = MagSeries(1, Series.of(TIME, swinging(9.0)), steps)
    assert Recorded(Track(compasses={1: compass}), 1).in_force is late
    assert Recorded(Track(compasses={1: replace(compass, not_applied=never)}), 1).in_force is never
