"""The heading message by message, against the formulas for whole columns."""

from __future__ import annotations

import itertools
import math

import numpy as np
import pytest

from mavcompass.attitude import Level
from mavcompass.correction import FieldCorrection
from mavcompass.earth_field import EarthField
from mavcompass.frames import euler_to_matrix
from mavcompass.heading.doubt import TILT_SIGMA_RAD, UNKNOWN_CALIBRATION_SIGMA_RAD
from mavcompass.heading.live import Agreement, LiveCompass, Vector
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
