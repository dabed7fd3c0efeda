"""How far a calibration's heading may be off, by the strength of the field alone: equation (D1)."""

from __future__ import annotations

import math

import numpy as np
import pytest

from mavcompass.earth_field import EarthField
from mavcompass.frames import FloatArray, wrap_pi
from mavcompass.heading.doubt import UNKNOWN_CALIBRATION_SIGMA_RAD, CalibrationDoubt, prior_sigma_mgauss

WORLD = EarthField((200.0, 0.0, 400.0))


def field(heading_rad: FloatArray, iron: FloatArray) -> FloatArray:
    psi = np.atleast_1d(heading_rad)
    plain = np.stack([200.0 * np.cos(psi), -200.0 * np.sin(psi), np.full(psi.size, 400.0)], axis=1)
    return plain + iron


def error_rad(seen: FloatArray, heading_rad: FloatArray) -> FloatArray:
    return np.asarray(wrap_pi(np.arctan2(-seen[:, 1], seen[:, 0]) - heading_rad))


def test_what_is_known_beforehand() -> None:
    assert prior_sigma_mgauss(False, 200.0) == 100.0
    assert prior_sigma_mgauss(True, 200.0) == pytest.approx(200.0 * UNKNOWN_CALIBRATION_SIGMA_RAD)


def test_where_nothing_was_seen_it_stays() -> None:
    doubt = CalibrationDoubt(22.0)
    assert doubt.sigma_rad(np.array([200.0]), np.array([0.0])) == pytest.approx(22.0 / 220.0)


def test_a_whole_turn_tells_the_iron_whether_the_place_is_known_or_not() -> None:
    psi, iron = np.linspace(0.0, 2.0 * math.pi, 200), np.array([40.0, -25.0, 0.0])
    seen = field(psi, iron)
    for world in (WORLD, None):
        doubt = CalibrationDoubt(100.0, world)
        doubt.add_all(seen)
        places, share = doubt.iron()
        assert abs(share @ places - complex(*iron[:2])) < 3.0
        sigma = doubt.sigma_rad(seen[:, 0], seen[:, 1])
        rms = math.sqrt(float((error_rad(seen, psi) ** 2).mean()))
        assert math.sqrt(float((sigma**2).mean())) == pytest.approx(rms, rel=0.1)
    clean = CalibrationDoubt(100.0)
    clean.add_all(field(psi, np.zeros(3)))
    assert clean.sigma_rad(np.array([200.0]), np.array([0.0]))[0] < math.radians(1.0)


@pytest.mark.parametrize("place", [WORLD, None])
@pytest.mark.parametrize("iron", [(400.0, 0.0, 0.0), (0.0, -700.0, 50.0), (150.0, 150.0, 0.0)])
def test_iron_that_is_stronger_than_the_field_leaves_no_heading(
    iron: tuple[float, float, float], place: EarthField | None
) -> None:
    """A whole turn then goes by the iron, not around the middle: it points one way, or nearly."""
    psi = np.linspace(0.0, 2.0 * math.pi, 300)
    seen, doubt = field(psi, np.array(iron)), CalibrationDoubt(20.0, place)
    doubt.add_all(seen)
    sigma = doubt.sigma_rad(seen[:, 0], seen[:, 1])
    rms = [math.sqrt(float((one**2).mean())) for one in (error_rad(seen, psi), sigma)]
    assert rms[1] == pytest.approx(rms[0], rel=0.35) and rms[1] > math.radians(40.0)


def test_one_heading_leaves_what_turns_it() -> None:
    """Strong by 30 mG along, the iron across is as large for all that is known."""
    doubt = CalibrationDoubt(10.0, WORLD)
    doubt.add_all(field(np.zeros(50), np.array([30.0, 0.0, 0.0])))
    (sigma,) = doubt.sigma_rad(np.array([230.0]), np.array([0.0]))
    assert sigma == pytest.approx(30.0 / 200.0, rel=0.2)


def test_reading_by_reading_is_all_at_once() -> None:
    seen = field(np.linspace(0.0, 5.0, 300), np.array([20.0, 10.0, 5.0]))
    one, other = CalibrationDoubt(20.0, WORLD), CalibrationDoubt(20.0, WORLD)
    one.add_all(seen)
    for row in seen.tolist():
        other.add(*row)
    other.add(0.5, 0.0, 400.0)  # straight down: no direction to speak of
    for a, b in zip(one.iron(), other.iron(), strict=True):
        assert a == pytest.approx(b)


def test_a_wrong_tilt_shows_in_the_strengths() -> None:
    """Down that is off by 3 degrees mixes the vertical field into the level one, along and across alike."""
    rng, psi = np.random.default_rng(5), np.linspace(0.0, 12.0 * math.pi, 3000)
    seen = field(psi, np.zeros(3))
    seen[:, :2] += seen[:, 2:] * rng.normal(0.0, math.radians(3.0), (psi.size, 2))
    doubt = CalibrationDoubt(1.0, WORLD)
    assert doubt.scatter_mgauss == 0.0
    doubt.add_all(seen)
    wrong = abs(float(seen[0, 2])) * math.radians(3.0)
    assert doubt.scatter_mgauss == pytest.approx(wrong, rel=0.1)
    rms = math.sqrt(float((error_rad(seen, psi) ** 2).mean()))
    sigma = np.hypot(doubt.sigma_rad(seen[:, 0], seen[:, 1]), doubt.scatter_mgauss / 200.0)
    assert math.sqrt(float((sigma**2).mean())) == pytest.approx(rms, rel=0.15)


@pytest.mark.parametrize("place", [WORLD, None])
@pytest.mark.parametrize("turn_rad", [0.0, 1.5, 6.2])
def test_sigma_covers(place: EarthField | None, turn_rad: float) -> None:
    """Calibrations off by the iron that is supposed, looked at from one heading, a quarter and all."""
    rng, ratios = np.random.default_rng(3), []
    for _ in range(200):
        psi = rng.uniform(0.0, 6.3) + np.linspace(0.0, turn_rad, 40)
        seen = field(psi, rng.normal(0.0, 20.0, 3))
        doubt = CalibrationDoubt(20.0, place)
        doubt.add_all(seen)
        sigma = doubt.sigma_rad(seen[:, 0], seen[:, 1])
        ratios.append(float(error_rad(seen, psi)[-1] / sigma[-1]))
    # It is the rms error to expect: where the iron shows, the error is as large as its sigma says.
    within = np.abs(ratios)
    assert 0.6 < np.mean(within < 1.3) and np.mean(within < 2.0) > 0.88
    assert np.median(within) > 0.3
