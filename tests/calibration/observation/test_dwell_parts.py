"""The parts of a dwell's mean: its memory from reading to reading, its trend with the heading, its halves."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest

from mavcompass.calibration.observation import dwells
from mavcompass.correction import FieldCorrection
from mavcompass.frames import FloatArray
from mavcompass.track import InForce, MagSeries, Series

FIELD = np.array([200.0, -50.0, 400.0])


def wave(lag_one: float, n: int = 400) -> FloatArray:
    """Readings that resemble the next by so much, on one axis of three."""
    x = np.cos(math.acos(lag_one) * np.arange(n))
    return np.stack([x, 0.0 * x, 0.0 * x], axis=1)


@pytest.mark.parametrize(
    ("residual", "raised"),
    [
        (wave(0.05), 1.0),  # below two sigmas of three axes' vote, 0.058
        (wave(0.065), 1.065 / 0.935),
        (wave(0.5), 3.0),
        (wave(-0.5), 1.0),
        (wave(0.98), 19.0),  # no more than of 0.9
        (wave(0.5)[:7], 1.0),  # too few to tell
        (np.zeros((50, 3)), 1.0),
    ],
)
def test_what_one_reading_tells_of_the_next_raises_the_variance(residual: FloatArray, raised: float) -> None:
    assert dwells._memory(residual) == pytest.approx(raised, rel=0.02)


def test_what_the_motion_carries_is_no_noise_and_a_small_rotation_moves_no_more_than_the_field() -> None:
    rng = np.random.default_rng(4)
    motion = 0.05 * rng.standard_normal((40, 3)) + [7.0, 0.1, -0.2]
    slopes = np.array([[30.0, -20.0, 0.0], [0.0, 400.0, 0.0], [-400.0, 0.0, 90.0]])
    noise = 0.5 * rng.standard_normal((40, 3))
    field = FIELD + (motion - [7.0, 0.1, -0.2]) @ slopes + noise
    field[3] += 90.0  # of a reading that is not kept
    keep = np.arange(40) != 3
    line, took = dwells._carried(motion, field, keep)
    left = (field - line)[keep]
    assert took == pytest.approx(4.0, abs=0.02)  # the mean and three slopes
    assert math.sqrt((left**2).sum() / 3.0 / (keep.sum() - took)) == pytest.approx(0.5, rel=0.15)
    assert (field - line)[3] == pytest.approx([90.0] * 3, abs=2.0)
    # A field that wanders while the vehicle leans by a ten thousandth is not the lean's.
    wandering = FIELD + np.linspace(-5.0, 5.0, 40)[:, np.newaxis] + noise
    leaning = np.outer(np.linspace(-1e-4, 1e-4, 40), [0.0, 1.0, 0.0])
    line, took = dwells._carried(leaning, wandering, np.ones(40, bool))
    assert np.ptp(line, axis=0).max() < 1.2 and took < 1.2


@pytest.mark.parametrize(("step_mgauss", "wanders"), [(4.1, False), (4.2, True)])
def test_halves_that_lie_apart_beyond_chance_are_told(step_mgauss: float, wanders: bool) -> None:
    """Chance is 4 x 2 mG x sqrt(4 / 100) = 1.6 mG, and the step of the numbers, 2.5."""
    half = np.where(np.arange(100) < 50, -0.5, 0.5)[:, np.newaxis] * np.array([0.6, 0.0, 0.8])
    assert dwells._wander(half * step_mgauss, 2.0, 2.5) == pytest.approx(step_mgauss * wanders)
    assert dwells._wander(half[49:52] * step_mgauss, 2.0, 2.5) == 0.0


def test_two_readings_make_a_dwell_and_eight_a_memory() -> None:
    assert dwells._memory(wave(0.5)[:8]) > 1.0
    spiky = np.tile(FIELD, (5, 1)) + np.array([0.0, 0.1, -0.1, 0.2, 90.0])[:, np.newaxis]
    assert dwells._inliers(spiky[:4], np.zeros((4, 3)), 0.0).all()
    assert dwells._inliers(spiky, np.zeros((5, 3)), 0.0).tolist() == [True] * 4 + [False]
    residual = np.array([-0.5, -0.5, 0.5, 0.5])[:, np.newaxis] * np.array([0.0, 30.0, 0.0])
    assert dwells._wander(residual, 1.0, 0.0) == pytest.approx(30.0)


def test_a_correction_holds_from_its_moment_on() -> None:
    first, second = FieldCorrection((1.0, 0.0, 0.0)), FieldCorrection((2.0, 0.0, 0.0))
    nothing = Series.of([], np.empty((0, 3)))
    compass = MagSeries(1, nothing, (InForce(-math.inf, first), InForce(5.0, second)))
    assert [dwells.correction_at(compass, at) for at in (4.9, 5.0, 9.0)] == [first, second, second]


@pytest.mark.parametrize(
    ("index", "angles", "sigmas", "durations"),
    [
        (0, [2.0, 4.0], [0.2, 0.3], [20.0, 30.0]),
        (1, [3.0, 4.0], [math.hypot(0.1, 0.2), 0.3], [30.0, 30.0]),
        (2, [1.0, 6.0], [0.1, math.hypot(0.2, 0.3)], [10.0, 50.0]),
        (3, [1.0, 2.0], [0.1, 0.2], [10.0, 20.0]),
    ],
)
def test_without_a_dwell_the_turns_around_it_are_joined(
    index: int, angles: list[float], sigmas: list[float], durations: list[float]
) -> None:
    made = [dwells.Dwell(float(k), k + 0.5, FIELD, np.eye(3)) for k in range(4)]
    steps = tuple(dwells.Step(a, s, d) for a, s, d in ((1.0, 0.1, 10.0), (2.0, 0.2, 20.0), (4.0, 0.3, 30.0)))
    left = dwells.FourPositionData(tuple(made), steps).without(index)
    assert [d.start_s for d in left.dwells] == [float(k) for k in range(4) if k != index]
    assert [s.angle_rad for s in left.steps] == angles
    assert [s.sigma_rad for s in left.steps] == pytest.approx(sigmas)
    assert [s.duration_s for s in left.steps] == durations
    assert left.turned_rad.tolist() == [0.0, angles[0], sum(angles)]
    with pytest.raises(ValueError, match="4 dwells need 3 steps"):
        dwells.FourPositionData(tuple(made), steps[:2])


def test_a_dwell_is_as_sure_as_its_noise_its_tilt_and_its_rest() -> None:
    covariance = np.diag([4.0, 9.0, 100.0])
    dwell = dwells.Dwell(0.0, 1.0, FIELD, covariance, np.diag([5.0, 7.0, 0.0]), tilt_sigma_rad=0.01)
    assert dwell.heading_sigma_rad(200.0, 400.0) == pytest.approx(math.hypot(4.0, 4.0) / 200.0)
    rough = replace(dwell, unsteady_mgauss=7.0)
    assert rough.heading_sigma_rad(200.0, -400.0) == pytest.approx(math.hypot(4.0, 4.0, 7.0) / 200.0)
