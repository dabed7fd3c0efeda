"""The heading, message by message."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from mavcompass.attitude import Level
from mavcompass.earth_field import EarthField
from mavcompass.frames import euler_to_matrix, rotate_back, wrap_pi
from mavcompass.heading.compute import tilt_compensated_heading
from mavcompass.heading.live import LiveCompass
from mavcompass.units import STANDARD_GRAVITY_MPS2

G = STANDARD_GRAVITY_MPS2


def resting(roll: float, pitch: float) -> Level:
    level = Level()
    acc = rotate_back(euler_to_matrix(roll, pitch, 0.0), [0.0, 0.0, -G])
    for k in range(100):
        level.update(0.05 * k, tuple(acc), (0.0, 0.0, 0.0))
    return level


def seen(roll: float, pitch: float, magnetic: float) -> tuple[float, float, float]:
    """The field of a place without declination, in body axes."""
    field = rotate_back(euler_to_matrix(roll, pitch, magnetic), [206.0, 0.0, 400.0])
    return (float(field[0]), float(field[1]), float(field[2]))


@given(st.floats(-1.2, 1.2), st.floats(-1.2, 1.2), st.floats(0.0, 2.0 * math.pi, exclude_max=True))
def test_tilt_does_not_turn_it_and_it_agrees_with_the_array_form(
    roll: float, pitch: float, magnetic: float
) -> None:
    field = seen(roll, pitch, magnetic)
    heading = LiveCompass(1).update(0.0, 0.0, field, resting(roll, pitch))
    assert heading is not None
    assert float(wrap_pi(heading.magnetic_rad - magnetic)) == pytest.approx(0.0, abs=1e-9)
    array_form = tilt_compensated_heading(field, roll_rad=roll, pitch_rad=pitch)
    assert float(wrap_pi(heading.magnetic_rad - array_form)) == pytest.approx(0.0, abs=1e-9)


def test_sigma_covers_the_error_of_disturbed_compasses() -> None:
    """A hard iron of unknown direction: errors stay within three sigmas for nearly all."""
    rng = np.random.default_rng(5)
    normalised = []
    for _ in range(400):
        iron = rng.normal(0.0, 15.0, 3)
        magnetic = rng.uniform(0.0, 2.0 * math.pi)
        compass = LiveCompass(1)
        compass.set_world(EarthField((206.155, 0.0, 400.0)))
        compass.calibration_sigma_rad = math.radians(1.0)
        field = np.array(seen(0.0, 0.0, magnetic)) + iron
        heading = compass.update(0.0, 0.0, tuple(field), resting(0.0, 0.0))
        assert heading is not None
        normalised.append(abs(float(wrap_pi(heading.magnetic_rad - magnetic))) / heading.sigma_rad)
    assert np.mean(np.array(normalised) < 3.0) > 0.9
    assert np.median(normalised) > 0.2  # nor is it absurdly large
