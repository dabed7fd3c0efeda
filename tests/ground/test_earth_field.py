"""The Earth's field against what is known elsewhere."""

from __future__ import annotations

import math

import pytest

from mavcompass.earth_field import EarthField, decimal_year, earth_field


def test_canberra_has_the_field_that_the_firmwares_simulator_uses() -> None:
    # The recordings of the shared data: N 232, E 52.7, D -529 mG, by the firmware's coarser table.
    field = earth_field(-35.363261, 149.165230, 584.0, 2025.5)
    assert field.ned_mgauss == pytest.approx((232.0, 52.7, -529.0), abs=4.0)
    assert math.degrees(field.declination_rad) == pytest.approx(12.8, abs=0.6)
    assert math.degrees(field.inclination_rad) == pytest.approx(-65.8, abs=0.6)


def test_a_place_of_the_models_own_test_table() -> None:
    # WMM2025 test values: 2025.0, 0 km, 80 N, 0 E: X 6521.6, Y 145.9, Z 54791.5 nT.
    field = earth_field(80.0, 0.0, 0.0, 2025.0)
    assert [100.0 * v for v in field.ned_mgauss] == pytest.approx([6521.6, 145.9, 54791.5], abs=0.2)


def test_declination_is_less_certain_where_the_horizontal_field_is_weak() -> None:
    strong = EarthField((350.0, 0.0, 300.0))
    weak = EarthField((20.0, 0.0, 580.0))
    assert math.degrees(strong.declination_sigma_rad) == pytest.approx(0.302, abs=0.01)
    assert math.degrees(weak.declination_sigma_rad) == pytest.approx(2.72, abs=0.02)


def test_outside_its_years_the_model_owns_up_to_more_sigma() -> None:
    inside, outside = (earth_field(50.0, 8.0, 0.0, year) for year in (2026.0, 2013.0))
    assert outside.sigma_mgauss[0] > 5.0 * inside.sigma_mgauss[0]
    assert outside.declination_sigma_rad > inside.declination_sigma_rad


def test_a_place_off_the_globe_is_refused() -> None:
    with pytest.raises(ValueError, match="no such place"):
        earth_field(95.0, 0.0, 0.0, 2026.0)


def test_a_unix_time_becomes_a_decimal_year() -> None:
    assert decimal_year(0.0) == 1970.0
    assert decimal_year(1_782_864_000.0) == pytest.approx(2026.4959, abs=1e-3)


@pytest.mark.parametrize(
    ("utc_s", "year"), [(1.8e13, 2100.0), (-1e12, 1970.0), (math.inf, 2100.0), (math.nan, 1970.0)]
)
def test_a_clock_that_says_the_impossible_is_answered(utc_s: float, year: float) -> None:
    assert decimal_year(utc_s) == year
