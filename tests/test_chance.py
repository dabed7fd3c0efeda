"""Tails and quantiles in closed form against scipy's series."""

from __future__ import annotations

import math

import pytest
import scipy

from mavcompass.chance import chance_above, chance_of_more, chi_square_of, students_t

FREEDOMS = [1, 2, 3, 8, 21, 60]


@pytest.mark.parametrize("freedom", FREEDOMS)
def test_the_chance_of_a_larger_chi_square_is_the_incomplete_gamma_function(freedom: int) -> None:
    for chi_square in (0.0, 0.3, 4.0, 30.0, 600.0):
        wanted = scipy.special.gammaincc(0.5 * freedom, 0.5 * chi_square)
        assert chance_of_more(chi_square, freedom) == pytest.approx(wanted, rel=1e-10)
    assert chance_of_more(2000.0, freedom) == chance_of_more(math.inf, freedom) == 0.0
    assert chance_of_more(3.0, 0) == 1.0


@pytest.mark.parametrize("freedom", FREEDOMS)
def test_a_chi_square_of_a_chance_is_exceeded_with_that_chance(freedom: int) -> None:
    for chance in (0.5, 2e-5, 1e-12):
        assert chi_square_of(chance, freedom) == pytest.approx(scipy.special.chdtri(freedom, chance))
        assert chance_of_more(chi_square_of(chance, freedom), freedom) == pytest.approx(chance)


@pytest.mark.parametrize("freedom", [1, 2, 3, 4, 9, 200])
def test_students_t_has_wider_tails_than_the_normal(freedom: int) -> None:
    for share in (0.5, 0.6, 0.975, 0.9999):
        assert students_t(share, freedom) == pytest.approx(scipy.special.stdtrit(freedom, share), abs=1e-9)
    assert chance_above(students_t(0.975, freedom)) < 0.025


def test_the_chance_of_a_larger_normal_value_is_right_far_out() -> None:
    for value in (-9.0, -1.0, 0.0, 2.0, 30.0):
        assert chance_above(value) == pytest.approx(scipy.special.ndtr(-value), rel=1e-10)
