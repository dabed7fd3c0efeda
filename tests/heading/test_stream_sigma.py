"""How sure a recording's heading is: against closed forms."""

from __future__ import annotations

import math

import numpy as np
import pytest

from mavcompass.correction import FieldCorrection
from mavcompass.earth_field import EarthField, earth_field_of
from mavcompass.errors import BadRecording
from mavcompass.frames import FloatArray
from mavcompass.heading import one_compass
from mavcompass.heading.doubt import UNKNOWN_CALIBRATION_SIGMA_RAD
from mavcompass.heading.evidence import heading_of_track
from mavcompass.track import InForce, MagSeries, Series, Track

TIME = np.arange(50.0) * 0.1
WORLD = EarthField((200.0, 0.0, 400.0))
LEVEL = np.tile([0.0, 0.0, 1.0], (50, 1))
TILT = math.radians(0.3)


def sigma_of(field: FloatArray, down: FloatArray, world: EarthField | None, two_axis: bool) -> FloatArray:
    magnetic = np.arctan2(-field[:, 1], field[:, 0])
    return one_compass._magnetic_sigma(field, down, np.zeros(len(field)), magnetic, world, True, two_axis)


def test_a_good_compass_that_was_turned_is_as_sure_as_its_tilt() -> None:
    psi = np.linspace(0.0, 6.2, 50)
    field = np.stack([200.0 * np.cos(psi), -200.0 * np.sin(psi), np.full(50, 400.0)], axis=1)
    for world in (WORLD, None):
        assert sigma_of(field, LEVEL, world, False) == pytest.approx(np.full(50, TILT * 2.0), rel=0.35)


def test_a_calibration_that_was_not_looked_at_is_as_sure_as_calibrations_are() -> None:
    field = np.tile([200.0, 0.0, 400.0], (50, 1))
    unknown = sigma_of(field, LEVEL, None, False)[0]
    assert unknown == pytest.approx(math.hypot(UNKNOWN_CALIBRATION_SIGMA_RAD, TILT * 2.0), rel=0.05)
    never = one_compass._magnetic_sigma(field, LEVEL, np.zeros(50), np.zeros(50), None, False, False)[0]
    assert math.degrees(never) > 20.0


def test_two_axes_are_less_sure_the_more_it_leans() -> None:
    lean = 0.3
    down = np.tile([math.sin(lean), 0.0, math.cos(lean)], (50, 1))
    field = np.tile([200.0 * math.cos(lean) + 400.0 * math.sin(lean), 0.0,
                     400.0 * math.cos(lean) - 200.0 * math.sin(lean)], (50, 1))  # fmt: skip
    world = EarthField((200.0, 0.0, 400.0), sigma_mgauss=(3.0, 4.0, 12.0))
    plain = sigma_of(field, down, world, False)[0]
    z_sigma = 13.0 * world.total_mgauss / field[0, 2]
    both = sigma_of(field, down, world, True)[0]
    assert both == pytest.approx(math.hypot(plain, z_sigma * math.sin(lean) / 200.0))
    assert sigma_of(field, LEVEL, world, True)[0] == pytest.approx(sigma_of(field, LEVEL, world, False)[0])
    flat = field.copy()
    flat[:, 2] = 0.0  # where the root is not told, a twentieth of the field
    assert sigma_of(flat, down, world, True)[0] ** 2 - sigma_of(flat, down, world, False)[
        0
    ] ** 2 == pytest.approx((13.0 * 20.0 * math.sin(lean) / 200.0) ** 2)


def placed(**more: object) -> Track:
    place = Series.of(TIME, np.tile([47.4, 8.5, 400.0], (50, 1)))
    field = np.tile([200.0, 0.0, 400.0], (50, 1))
    values = {"place": place, "compasses": {1: MagSeries(1, Series.of(TIME, field))}, **more}
    return Track(source="x", **values)  # type: ignore[arg-type]


def test_the_true_heading_is_less_sure_by_the_declination() -> None:
    result = heading_of_track(placed(utc_offset_s=1.78e9))
    world = earth_field_of(placed(utc_offset_s=1.78e9))
    assert world is not None and result.true_rad is not None and result.grid_rad is not None
    assert result.sigma_rad == pytest.approx(np.hypot(result.magnetic_sigma_rad, world.declination_sigma_rad))
    assert result.true_rad == pytest.approx(np.full(50, world.declination_rad))
    assert result.declination_rad == world.declination_rad != 0.0
    assert not np.allclose(result.grid_rad, result.true_rad)
    nowhere = heading_of_track(placed(place=None))
    assert nowhere.true_rad is None and nowhere.grid_rad is None and math.isnan(nowhere.declination_rad)
    assert np.array_equal(nowhere.sigma_rad, nowhere.magnetic_sigma_rad)


def test_a_place_counts_where_it_is_known() -> None:
    zero = Series.of(TIME, np.zeros((50, 3)))
    assert earth_field_of(placed(place=zero)) is None and earth_field_of(placed(place=None)) is None
    assert earth_field_of(placed(place=Series.of([], np.empty((0, 3))))) is None
    some = np.full((50, 3), np.nan)
    some[7] = [47.4, 8.5, 400.0]
    late = earth_field_of(placed(place=Series.of(TIME, some)))
    assert late is not None and late.declination_rad == pytest.approx(math.radians(3.5), abs=0.02)
    # The date matters by a tenth of a degree a year; without one it is the middle of the model's years.
    dated, middle = (earth_field_of(placed(), year) for year in (2025.14, 2027.5))
    assert dated is not None and middle is not None
    assert 0.001 < middle.declination_rad - dated.declination_rad < 0.01
    assert earth_field_of(placed(utc_offset_s=1.74e9), 2099.0) == dated
    assert heading_of_track(placed()).declination_rad == middle.declination_rad


def test_the_calibration_in_force_counts_where_the_readings_lack_it() -> None:
    """PX4 sends raw readings; its parameters tell what it does to them."""
    own = FieldCorrection((0.0, 50.0, 0.0), (1.1, 1.0, 1.0))
    field = np.tile([200.0, -40.0, 400.0], (50, 1))
    inside = MagSeries(1, Series.of(TIME, own.apply(field)), (InForce(-np.inf, own),))
    outside = MagSeries(1, Series.of(TIME, field), not_applied=own)
    told, lacking = (heading_of_track(placed(compasses={1: one})) for one in (inside, outside))
    assert told.magnetic_rad == pytest.approx(lacking.magnetic_rad)
    assert told.magnetic_rad[0] == pytest.approx(math.atan2(-10.0, 220.0) % (2.0 * math.pi))
    assert told.sigma_rad == pytest.approx(lacking.sigma_rad)


def test_an_autopilots_yaw_that_another_compass_steers_is_evidence() -> None:
    """Only one compass is told; by what the autopilot makes of the other it stands 90 degrees off."""
    steered = {"COMPASS_USE": 0.0, "COMPASS_USE2": 1.0, "COMPASS_DEV_ID2": 97539.0, "AHRS_EKF_TYPE": 3.0}

    def sigma_deg(yaw_rad: float, parameters: dict[str, float]) -> float:
        wander = 1e-4 * np.sin(TIME)  # a yaw that is sent again says nothing new
        attitude = Series.of(TIME, np.stack([0.0 * TIME, 0.0 * TIME, yaw_rad + wander], axis=1))
        track = placed(attitude_rad=attitude, autopilot="ardupilot", parameters=parameters)
        return math.degrees(heading_of_track(track).magnetic_sigma_rad[-1])

    own = math.radians(3.5)  # the declination there: the compass points to magnetic north
    alone = sigma_deg(own, {})
    assert sigma_deg(own + 0.5 * math.pi, {}) == alone  # what this compass steers tells nothing of it
    assert sigma_deg(own, steered) == pytest.approx(alone, abs=0.5)
    assert 60.0 < sigma_deg(own + 0.5 * math.pi, steered) <= 90.0


def test_what_is_asked_of_a_recording_has_to_be_there() -> None:
    with pytest.raises(BadRecording, match=r"x has no readings of compass 2 \(it has: 1\)"):
        heading_of_track(placed(), instance=2)
    with pytest.raises(BadRecording, match=r"The recording has no readings of compass 1 \(it has: none\)"):
        heading_of_track(Track())
    with pytest.raises(BadRecording, match="does not tell its place"):
        heading_of_track(placed(place=None), two_axis=True)


def test_all_that_may_be_off_adds_up() -> None:
    """Nothing but tilt and lateness of a compass that was seen all round and does not scatter."""
    psi = np.linspace(0.0, 2.0 * math.pi, 50, endpoint=False)
    field = np.stack([200.0 * np.cos(psi), -200.0 * np.sin(psi), np.full(50, 400.0)], axis=1)
    known = (field, LEVEL, np.full(50, 0.02), psi, WORLD, True, False)
    early, late = one_compass._magnetic_sigma(*known), one_compass._magnetic_sigma(*known, np.full(50, 0.05))
    assert late == pytest.approx(np.hypot(early, 0.05))
    assert early == pytest.approx(np.full(50, 2.0 * math.hypot(0.02, TILT)), rel=0.1)
    assert one_compass._magnetic_sigma(*known, np.full(50, 9.0)).tolist() == [math.pi] * 50
