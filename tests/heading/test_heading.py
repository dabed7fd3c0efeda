"""Headings: known attitudes give known headings, in every form, with a sigma that holds."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import assume, given
from hypothesis import strategies as st

from mavcompass.correction import FieldCorrection
from mavcompass.earth_field import EarthField, earth_field
from mavcompass.frames import euler_to_matrix, rotate_back, wrap_pi
from mavcompass.heading import heading_of_track, level_heading, tilt_compensated_heading, two_axis_heading
from mavcompass.heading.compute import TwoAxisCompass, grid_convergence_rad
from mavcompass.heading.deviation import fit_deviation
from mavcompass.track import MagSeries, Series, Track

FIELD = np.array([200.0, 0.0, 430.0])
angles = st.floats(-3.1, 3.1)
tilts = st.floats(-1.2, 1.2)


def body(roll: float, pitch: float, yaw: float, vector: np.ndarray) -> np.ndarray:
    return rotate_back(euler_to_matrix(roll, pitch, yaw), vector)


@given(yaw=angles)
def test_a_level_vehicle_shows_its_heading(yaw: float) -> None:
    assert abs(wrap_pi(level_heading(body(0.0, 0.0, yaw, FIELD)) - yaw)) < 1e-12


@given(roll=tilts, pitch=tilts, yaw=angles)
def test_tilt_compensation_is_exact_by_gravity_and_by_angles(roll: float, pitch: float, yaw: float) -> None:
    field = body(roll, pitch, yaw, FIELD)
    acc = body(roll, pitch, yaw, np.array([0.0, 0.0, -9.8]))
    assert abs(wrap_pi(tilt_compensated_heading(field, acc) - yaw)) < 1e-9
    by_angles = tilt_compensated_heading(field, roll_rad=roll, pitch_rad=pitch)
    assert abs(wrap_pi(by_angles - yaw)) < 1e-9


def test_upside_down_vehicles_have_a_heading_too() -> None:
    field = body(math.radians(175.0), 0.1, 1.0, FIELD)
    acc = body(math.radians(175.0), 0.1, 1.0, np.array([0.0, 0.0, -9.8]))
    assert tilt_compensated_heading(field, acc) == pytest.approx(1.0)


def test_rows_give_what_single_readings_give() -> None:
    rng = np.random.default_rng(1)
    field, acc = rng.normal(0, 300, (20001, 3)), rng.normal(0, 5, (20001, 3))
    rows = tilt_compensated_heading(field, acc)
    for k in (0, 8191, 8192, 20000):
        assert rows[k] == pytest.approx(float(tilt_compensated_heading(field[k], acc[k])), abs=1e-12)
    columns = tilt_compensated_heading(np.asfortranarray(field), np.asfortranarray(acc))
    assert np.array_equal(rows, columns)


@given(dip=st.floats(-1.4, 1.4), roll=tilts | st.floats(1.7, 3.0), pitch=tilts, yaw=angles)
def test_two_axes_do_where_the_field_is_known(dip: float, roll: float, pitch: float, yaw: float) -> None:
    earth = 480.0 * np.array([math.cos(dip), 0.0, math.sin(dip)])
    field = body(roll, pitch, yaw, earth)
    assume(abs(field[2]) > 5.0)  # the roots differ
    heading = two_axis_heading(field[:2], roll, pitch, 480.0, dip)
    assert abs(wrap_pi(heading - yaw)) < 1e-6


def test_a_negative_root_means_the_field_lies_in_the_sensors_plane() -> None:
    assert math.isfinite(two_axis_heading((300.0, 100.0), 0.1, 0.1, 300.0, 0.2))


def test_the_fields_length_is_followed_while_level() -> None:
    compass = TwoAxisCompass(480.0, 0.9)
    horizontal = 480.0 * math.cos(0.9) * 1.05
    for _ in range(400):
        heading = compass.update(horizontal, 0.0, 0.0, 0.0)
    assert heading == pytest.approx(0.0, abs=1e-9)
    assert compass.total_mgauss == pytest.approx(math.hypot(horizontal, 480.0 * math.sin(0.9)), rel=1e-3)


@pytest.mark.parametrize(
    ("roll", "pitch"), [(0.0, 0.0), (0.01, 0.0), (0.0, -0.03), (0.034, 0.034), (0.3, -0.2), (0.0, 0.5)]
)
def test_a_two_axis_compass_points_as_three_axes_do_and_learns_while_level(roll: float, pitch: float) -> None:
    earth = np.array([480.0 * math.cos(0.9), 0.0, 480.0 * math.sin(0.9)])
    x, y, _ = euler_to_matrix(roll, pitch, 2.0).T @ earth
    compass = TwoAxisCompass(480.0, 0.9)
    assert compass.update(float(x), float(y), roll, pitch) == pytest.approx(
        2.0, abs=0.06 if roll < 0.05 else 1e-6
    )
    compass.update(2.0 * x, 2.0 * y, roll, pitch)
    is_level = max(abs(roll), abs(pitch)) < math.radians(2.0)
    assert (compass.total_mgauss > 480.5) is is_level


def test_grid_north_leaves_true_north_away_from_the_zones_middle() -> None:
    assert grid_convergence_rad(45.0, 9.0) == pytest.approx(0.0, abs=1e-12)
    assert math.degrees(grid_convergence_rad(45.0, 11.0)) == pytest.approx(1.414, abs=0.002)
    assert grid_convergence_rad(-45.0, 11.0) < 0.0


def track_at(yaw: np.ndarray) -> tuple[Track, EarthField]:
    earth = earth_field(-35.3633, 149.1652, 584.0, 2026.5)
    time_s = np.arange(yaw.size) * 0.1
    field = rotate_back(
        euler_to_matrix(0.0 * yaw, 0.0 * yaw, yaw), np.broadcast_to(earth.vector_mgauss, (yaw.size, 3))
    )
    return (
        Track(
            source="made up",
            vehicle="rover",
            compasses={1: MagSeries(1, Series.of(time_s, field))},
            acc_mps2=Series.of(time_s, np.tile([0.0, 0.0, -9.80665], (yaw.size, 1))),
            place=Series.of([0.0], [[-35.3633, 149.1652, 584.0]]),
            utc_offset_s=1782000000.0,
        ),
        earth,
    )


def test_a_recording_gives_magnetic_true_and_grid_headings() -> None:
    yaw = np.linspace(0.0, 6.2, 50)
    track, earth = track_at(yaw)
    result = heading_of_track(track)
    assert result.true_rad is not None and result.grid_rad is not None
    assert np.allclose(wrap_pi(result.true_rad - yaw), 0.0, atol=1e-3)
    assert np.allclose(wrap_pi(result.magnetic_rad - yaw + earth.declination_rad), 0.0, atol=1e-3)
    assert (result.sigma_rad > result.magnetic_sigma_rad).all()
    assert (result.sigma_rad >= earth.declination_sigma_rad).all()


def test_a_bad_correction_shows_in_the_sigma() -> None:
    track, _ = track_at(np.linspace(0.0, 6.2, 50))
    good, bad = heading_of_track(track), heading_of_track(track, FieldCorrection((60.0, 0.0, 0.0)))
    assert bad.magnetic_sigma_rad.mean() > 5.0 * good.magnetic_sigma_rad.mean()


def test_two_degrees_are_level_no_more() -> None:
    for tilt, learns in ((math.radians(2.0), False), (math.radians(1.999), True)):
        for roll, pitch in ((tilt, 0.0), (0.0, -tilt)):
            compass = TwoAxisCompass(480.0, 0.9)
            compass.update(400.0, 0.0, roll, pitch)
            assert (compass.total_mgauss != 480.0) is learns
    gained = TwoAxisCompass(480.0, 0.9)
    gained.update(400.0, 0.0, 0.0, 0.0)
    measured = math.hypot(400.0, 480.0 * math.sin(0.9))
    assert gained.total_mgauss == pytest.approx(480.0 + 0.02 * (measured - 480.0))


def test_five_headings_make_a_deviation_card() -> None:
    compass = np.radians([0.0, 70.0, 150.0, 200.0, 300.0])
    coefficients = dict(zip("ABCDE", (1.0, 2.0, -0.5, 0.7, 0.3), strict=True))
    terms = [np.ones(5), np.sin(compass), np.cos(compass), np.sin(2.0 * compass), np.cos(2.0 * compass)]
    off = sum(value * term for value, term in zip(coefficients.values(), terms, strict=True))
    card = fit_deviation(compass, compass + np.radians(off))
    assert card.coefficients_deg == pytest.approx(coefficients) and card.residual_deg < 1e-9
    assert card.compass_deg == pytest.approx(45.0 * np.arange(8)) and np.isnan(card.sigma_deg).all()
    assert card.deviation_deg[[0, 2]] == pytest.approx([1.0 - 0.5 + 0.3, 1.0 + 2.0 - 0.3])
    assert fit_deviation(compass, compass, 16).compass_deg == pytest.approx(22.5 * np.arange(16))
    with pytest.raises(ValueError, match="five different headings"):
        fit_deviation(compass[[0, 1, 2, 3, 3]], compass)


@pytest.mark.parametrize("tilt", [{}, {"roll_rad": 0.1}, {"pitch_rad": 0.1}])
def test_half_a_tilt_is_none(tilt: dict[str, float]) -> None:
    with pytest.raises(ValueError, match="either"):
        tilt_compensated_heading(FIELD, **tilt)
    assert tilt_compensated_heading(FIELD, [0.0, 0.0, -9.8], **tilt) == pytest.approx(0.0)
    with pytest.raises(ValueError, match="either"):
        tilt_compensated_heading(FIELD, [0.0, 0.0, -9.8], roll_rad=0.1, pitch_rad=0.1)
