"""The heading message by message, against the formulas for whole columns."""

from __future__ import annotations

import itertools
import math

import numpy as np
import pytest

from mavcompass.attitude import Level
from mavcompass.correction import FieldCorrection
from mavcompass.earth_field import EarthField, earth_field_of
from mavcompass.errors import BadRecording
from mavcompass.frames import FloatArray, euler_to_matrix
from mavcompass.heading import one_compass
from mavcompass.heading.doubt import TILT_SIGMA_RAD, UNKNOWN_CALIBRATION_SIGMA_RAD
from mavcompass.heading.evidence import heading_of_track
from mavcompass.heading.live import Agreement, LiveCompass, Vector
from mavcompass.track import InForce, MagSeries, Series, Track
from mavcompass.units import STANDARD_GRAVITY_MPS2

G = STANDARD_GRAVITY_MPS2
EARTH = EarthField((230.0, 40.0, 420.0))


def in_body(roll: float, pitch: float, yaw: float, ned: Vector) -> Vector:
    x, y, z = euler_to_matrix(roll, pitch, yaw).T @ np.array(ned)
    return float(x), float(y), float(z)


class Leaning(Level):
    """One whose sigma is told."""

    sigma_rad = 0.0  # type: ignore[assignment]


def leaning(roll: float, pitch: float) -> Leaning:
    level = Leaning()
    level.update(0.0, in_body(roll, pitch, 0.0, (0.0, 0.0, -G)), (0.0, 0.0, 0.0))
    return level


ATTITUDES = [(0.0, 0.0, 0.3), (0.5, -0.4, 2.0), (-1.2, 0.7, -1.0), (2.8, 0.2, 3.1), (0.3, 1.3, -2.5)]


@pytest.mark.parametrize(("roll", "pitch", "yaw"), ATTITUDES)
def test_the_heading_is_that_of_the_attitude(roll: float, pitch: float, yaw: float) -> None:
    level, compass = leaning(roll, pitch), LiveCompass(2)
    assert (level.roll_rad, level.pitch_rad) == pytest.approx((roll, pitch))
    compass.set_world(EARTH)
    heading = compass.update(7.0, 5.0, in_body(roll, pitch, yaw, EARTH.ned_mgauss), level)
    assert heading is not None and heading is compass.latest
    assert heading.true_rad == pytest.approx(yaw % (2.0 * math.pi))
    assert heading.magnetic_rad == pytest.approx((yaw - EARTH.declination_rad) % (2.0 * math.pi))
    assert 0.0 <= heading.magnetic_rad < 2.0 * math.pi
    magnetic = yaw - EARTH.declination_rad
    h = EARTH.horizontal_mgauss
    assert heading.level_mgauss == pytest.approx((h * math.cos(magnetic), -h * math.sin(magnetic), 420.0))
    assert heading.horizontal_mgauss == pytest.approx(h)
    assert heading.total_mgauss == pytest.approx(math.hypot(h, 420.0))
    assert heading.dip_rad == pytest.approx(math.atan2(420.0, h))
    assert (heading.time_s, heading.boot_s, heading.instance) == (7.0, 5.0, 2)


@pytest.mark.parametrize(("roll", "pitch", "yaw"), ATTITUDES)
def test_raw_readings_in_sensor_axes_are_corrected_first(roll: float, pitch: float, yaw: float) -> None:
    correction = FieldCorrection((12.0, -30.0, 7.0), (1.1, 0.9, 1.05), (0.02, -0.03, 0.04))
    rotation = euler_to_matrix(0.0, 0.0, 0.5 * math.pi)
    field = np.array(in_body(roll, pitch, yaw, EARTH.ned_mgauss))
    raw = rotation.T @ (np.linalg.solve(correction.matrix, field) - correction.offsets_mgauss)
    compass = LiveCompass(1)
    compass.set_uncorrected(correction, rotation)
    heading = compass.update(0.0, 0.0, (float(raw[0]), float(raw[1]), float(raw[2])), leaning(roll, pitch))
    assert heading is not None and heading.true_rad is None
    assert heading.magnetic_rad == pytest.approx((yaw - EARTH.declination_rad) % (2.0 * math.pi))


def test_where_nothing_is_horizontal_there_is_no_heading() -> None:
    compass = LiveCompass(1)
    assert compass.update(0.0, 0.0, (0.9, 0.0, 400.0), leaning(0.0, 0.0)) is None
    assert compass.update(0.0, 0.0, (1.0, 0.0, 400.0), leaning(0.0, 0.0)) is not None
    assert compass.update(0.0, 0.0, (200.0, 0.0, 0.0), leaning(0.0, 0.5 * math.pi)) is None  # nose up


def test_the_sigma_adds_calibration_noise_tilt_lag_and_what_the_world_cannot_explain() -> None:
    level, compass = leaning(0.0, 0.0), LiveCompass(1)
    level.sigma_rad = 0.01
    reading = (200.0, 0.0, 400.0)

    def sigma() -> float:
        heading = compass.update(next(time_s), 0.0, reading, level)
        assert heading is not None
        return heading.sigma_rad

    time_s = itertools.count()
    quantum2, tilt2 = 1.0 / 12.0 / 200.0**2, (2.0 * math.hypot(0.01, TILT_SIGMA_RAD)) ** 2
    known2 = quantum2 + tilt2 + UNKNOWN_CALIBRATION_SIGMA_RAD**2
    assert sigma() == pytest.approx(math.sqrt(known2), rel=0.01)
    compass.calibration_sigma_rad = 0.02
    known2 = quantum2 + tilt2 + 0.02**2
    assert sigma() == pytest.approx(math.sqrt(known2), rel=0.01)
    level.rate_radps = -0.5  # 0.1 s late
    assert sigma() == pytest.approx(math.sqrt(known2 + 0.05**2), rel=0.01)
    level.rate_radps = 0.0
    # 30 mG too strong, 30 mG too little down: as much is to be expected of the part that turns the heading,
    # about the ring of 170 mG on which it ends, seen 200 mG from its middle.
    compass.set_world(EarthField((170.0, 0.0, 430.0)))
    assert sigma() == pytest.approx(math.hypot(30.0, 30.0) / math.sqrt(200.0 * 170.0), rel=0.02)
    # As strong as it should be, the calibration is the likelier to be good.
    compass.set_world(EarthField((200.0, 0.0, 400.0)))
    assert sigma() == pytest.approx(math.sqrt(quantum2 + tilt2 + 0.02**2 / 3.0), rel=0.01)


def test_iron_ahead_is_as_unsure_to_the_left_as_to_the_right() -> None:
    level, compass, sigma = leaning(0.0, 0.0), LiveCompass(1), []
    for k, toward in enumerate(np.radians([*range(0, 360, 5), -22.5, 22.5]).tolist()):
        reading = (40.0 + 200.0 * math.cos(toward), 200.0 * math.sin(toward), 400.0)
        sigma += [found.sigma_rad] if (found := compass.update(float(k), float(k), reading, level)) else []
    assert sigma[-2] == pytest.approx(sigma[-1], rel=0.03) and sigma[-1] > 0.05


def test_the_noise_is_that_of_the_strengths_about_their_sectors() -> None:
    level, chance, compass = leaning(0.0, 0.0), np.random.default_rng(5), LiveCompass(1)
    compass.calibration_sigma_rad = level.rate_radps = 0.0
    found = []
    for k in range(800):
        x, y, _ = 4.0 * chance.normal(size=3)
        for _ in range(2):  # twice the same says nothing
            heading = compass.update(0.5 * k, 0.0, (200.0 + x, 50.0 + y, 400.0), level)
        assert heading is not None
        found.append(heading.sigma_rad)
    strength = math.hypot(200.0, 50.0)
    noise = math.hypot(4.0, math.sqrt(1 / 12), 400.0 * TILT_SIGMA_RAD)
    assert math.sqrt(np.mean(np.square(found[200:]))) * strength == pytest.approx(noise, rel=0.05)


def test_no_sigma_is_larger_than_the_circle() -> None:
    level, compass = leaning(0.0, 0.0), LiveCompass(1)
    level.sigma_rad = 1.0
    heading = compass.update(0.0, 0.0, (2.0, 0.0, 400.0), level)
    assert heading is not None and heading.sigma_rad == math.pi


def test_what_stands_apart_from_the_others_claims_no_less() -> None:
    level, agreement = leaning(0.0, 0.0), Agreement()
    compasses = {i: LiveCompass(i) for i in (1, 2, 3)}

    def beyond_deg(first_yaw_deg: float, from_s: float, rate_radps: float = 0.0) -> list[float]:
        for time_s in np.arange(from_s, from_s + 5.0, 0.1).tolist():
            for i, compass in compasses.items():
                yaw = math.radians(first_yaw_deg if i == 1 else 20.0)
                compass.calibration_sigma_rad = math.radians(1.0)
                heading = compass.update(time_s, time_s, in_body(0.0, 0.0, yaw, (230.0, 0.0, 420.0)), level)
                assert heading is not None
                agreement.hear(heading, compasses, rate_radps)
        return [math.degrees(compass.beyond_rad) for compass in compasses.values()]

    assert max(beyond_deg(20.0, 0.0)) < 0.1
    agreement.restart()
    assert max(beyond_deg(110.0, 5.0, rate_radps=0.5)) < 0.1  # while it turns, each is late by its own time
    first, *others = beyond_deg(110.0, 10.0)
    assert first == pytest.approx(90.0, abs=2.0) and max(others) < 2.0
    latest = compasses[1].latest
    assert latest is not None and math.degrees(latest.sigma_rad) == pytest.approx(first, abs=0.5)
    compasses[1].restart()
    agreement.restart()
    assert max(beyond_deg(20.0, 15.0)) < 0.1


# --- How sure a recording's heading is: against closed forms


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
