"""Which of several sources of a heading is at fault: the others, the gyro and the Earth's field tell."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from mavcompass.heading.fault_isolation import FAULT, HeadingSource, isolate_faults
from mavcompass.printable import named

at = HeadingSource.at
FITS = {"dip": 0.3, "strength": -0.4}
BENT = {"dip": 6.0, "strength": 4.0}


def blamed(*sources: HeadingSource) -> tuple[int, ...]:
    return isolate_faults(sources).blamed


def test_sources_that_agree_blame_nobody() -> None:
    found = isolate_faults([at("a", 359.0, 1.0), at("b", 1.0, 1.0), at("c", 0.5, 1.0)])
    assert found.blamed == () and not found.undecided and found.sound.min() > 0.99
    assert blamed(at("a", 100.0, 1.0)) == blamed() == ()


def test_the_weights_of_two_are_the_closed_form() -> None:
    """Both sound against either: (1 - p)^2 N(d; sqrt 2 sigma) against 2 p (1 - p) / (2 pi)."""
    for apart_deg in (0.0, 3.0, 5.0, 7.0):
        sigma, apart = math.radians(math.sqrt(2.0)), math.radians(apart_deg)
        density = math.exp(-0.5 * (apart / sigma) ** 2) / sigma / math.sqrt(2.0 * math.pi)
        both, one = (1.0 - FAULT) * density, FAULT / (2.0 * math.pi)
        found = isolate_faults([at("a", 0.0, 1.0), at("b", apart_deg, 1.0)])
        assert found.sound == pytest.approx((both + one) / (both + 2.0 * one))
        # The error of one that is sound, at least half the difference; or off by all of it.
        own2, wrong = math.radians(1.0) ** 2, one / (both + 2.0 * one)
        beyond2 = (1.0 - 2.0 * wrong) * max((0.5 * apart) ** 2 - own2, 0.0)
        assert found.error_rad[0] ** 2 == pytest.approx(own2 + wrong * apart**2 + beyond2)


def test_two_that_agree_outvote_the_third_whichever_it_is() -> None:
    found = isolate_faults(
        [at("compass 1", 334.0, 1.0), at("compass 2", 0.5, 1.0), at("compass 3", 359.5, 1.0)]
    )
    assert found.blamed == (0,) and found.likeliest == (1, 2)
    assert math.degrees(found.apart_rad(0)) == pytest.approx(-26.0)
    assert math.degrees(found.error_rad[0]) == pytest.approx(26.0, abs=0.1)
    assert found.why(0) == "Compass 1 is 26 deg from compasses 2 and 3, which agree."
    assert blamed(at("a", 0.0, 1.0), at("b", 30.0, 1.0), at("c", 1.0, 1.0)) == (1,)
    assert blamed(at("a", 0.0, 1.0), at("b", 1.0, 1.0), at("c", 181.0, 1.0)) == (2,)


def test_a_majority_bent_alike_does_not_convict_the_one_that_the_earth_bears_out() -> None:
    alike = [at("b", 30.0, 1.0, **BENT), at("c", 31.0, 1.0, **BENT)]
    assert blamed(at("a", 0.0, 1.0, **FITS), *alike) == (1, 2)
    assert blamed(at("a", 0.0, 1.0, **BENT), *alike) == (0,)


def test_the_gyros_turn_decides_between_two() -> None:
    found = isolate_faults([at("compass 1", 12.0, 1.0, gyro=-6.0), at("compass 2", 0.0, 1.0, gyro=0.3)])
    assert found.blamed == (0,)
    assert found.why(0) == "Compass 1 is 12 deg from compass 2; the gyro speaks against it, too."


@pytest.mark.parametrize("known", [{}, FITS, BENT])
def test_two_with_the_same_record_leave_it_open(known: dict[str, float]) -> None:
    found = isolate_faults([at("a", 0.0, 1.0, **known), at("b", -12.0, 1.0, **known)])
    assert found.blamed == () and found.undecided and found.sound == pytest.approx(0.5, abs=1e-3)
    # As likely as not off by the whole difference.
    assert math.degrees(found.error_rad[0]) == pytest.approx(12.0 / math.sqrt(2.0), rel=0.02)


def test_three_that_all_differ_are_left_open() -> None:
    found = isolate_faults([at("a", 0.0, 1.0), at("b", 20.0, 1.0), at("c", 40.0, 1.0)])
    assert found.blamed == () and found.undecided


def test_a_bend_over_the_circle_counts_as_well() -> None:
    bend = HeadingSource("b", (0.0, 0.1, 0.0), 0.002, {})
    straight = [HeadingSource(name, (0.0, 0.0, 0.0), 0.002, {}) for name in "ac"]
    found = isolate_faults([bend, *straight])
    assert found.blamed == (0,) and found.error_rad[0] == pytest.approx(0.1 / math.sqrt(2.0), rel=0.01)


def test_what_is_not_known_says_nothing() -> None:
    plain = isolate_faults([at("a", 0.0, 1.0), at("b", 4.0, 1.0)])
    unknown = isolate_faults([at("a", 0.0, 1.0, gyro=math.nan), at("b", 4.0, 1.0, dip=math.nan)])
    assert unknown.sound == pytest.approx(plain.sound)


@given(
    st.lists(st.floats(-180.0, 180.0), min_size=1, max_size=5), st.floats(-720.0, 720.0), st.floats(0.1, 10.0)
)
def test_only_differences_count_and_probabilities_are_some(
    headings: list[float], turn: float, sigma: float
) -> None:
    found, turned = (
        isolate_faults([at(str(k), h + by, sigma) for k, h in enumerate(headings)]) for by in (0.0, turn)
    )
    assert ((found.sound >= -1e-12) & (found.sound <= 1.0 + 1e-12)).all()
    assert turned.sound == pytest.approx(found.sound, abs=1e-6)
    assert (found.error_rad >= math.radians(sigma) - 1e-9).all()


def test_the_probability_of_a_fault_is_true() -> None:
    """Of compasses drawn as (F1) supposes, those called sound with p are so in a share p."""
    rng = np.random.default_rng(11)
    told, true = [], []
    for _ in range(3000):
        faulty = rng.random(3) < FAULT
        headings = np.where(faulty, rng.uniform(-180.0, 180.0, 3), rng.normal(0.0, 3.0, 3))
        found = isolate_faults([at(str(k), h, 3.0) for k, h in enumerate(headings)])
        told += found.sound.tolist()
        true += (~faulty).tolist()
    told_, true_ = np.array(told), np.array(true)
    for low, high in ((0.0, 0.2), (0.2, 0.8), (0.8, 0.99), (0.99, 1.01)):
        bin_ = (told_ >= low) & (told_ < high)
        spread = math.sqrt(max(told_[bin_].mean() * (1.0 - told_[bin_].mean()) / bin_.sum(), 1e-6))
        assert abs(true_[bin_].mean() - told_[bin_].mean()) < 3.5 * spread + 0.01


def test_names_are_listed_as_people_do() -> None:
    assert named(["compass 2", "compass 3", "gps-yaw"]) == "compasses 2 and 3 and gps-yaw"
    assert named(["compass 1", "autopilot"]) == "compass 1 and autopilot"
    assert named(["gps-course"]) == "gps-course"
