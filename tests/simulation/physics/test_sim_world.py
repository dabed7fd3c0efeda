"""The simulated world and the motion in it obey geometry and kinematics."""

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from mavcompass.correction import FieldCorrection
from mavcompass.earth_field import decimal_year, earth_field
from mavcompass.frames import euler_to_matrix
from mavcompass.simulation.heading_error import heading_error_rms_deg, heading_errors_rad
from mavcompass.simulation.physics.hand import HandMove
from mavcompass.simulation.physics.motion import rotation_matrix
from mavcompass.simulation.physics.noise import NoiseTape, generator
from mavcompass.simulation.physics.profiles import Place
from mavcompass.simulation.physics.sensors import Compass, CompassModel, CompassSetup
from mavcompass.simulation.physics.world import World
from mavcompass.simulation.vehicle import SimulatedAutopilot

ANGLE = st.floats(-3.1, 3.1)
SLOPE = st.floats(-0.3, 0.3)


def test_the_field_is_the_world_models():
    world = World(Place(47.4, 8.55, 500.0))
    model = earth_field(47.4, 8.55, 500.0, decimal_year(world.utc_start_s))
    assert world.field_ned_mgauss == model.ned_mgauss
    assert world.declination_rad == model.declination_rad
    assert world.horizontal_mgauss == pytest.approx(model.horizontal_mgauss)


@given(ANGLE, SLOPE, SLOPE)
def test_a_vehicle_stands_upright_on_the_slope(yaw, north, east):
    world = World(Place(47.4, 8.55, 500.0), slope=(north, east))
    roll, pitch, _, _ = world.ground_tilt(yaw, 0.0)
    down = np.reshape(rotation_matrix(roll, pitch, yaw), (3, 3))[:, 2]
    normal = np.array([north, east, 1.0]) / math.sqrt(north**2 + east**2 + 1.0)
    np.testing.assert_allclose(down, normal, atol=1e-12)


@given(ANGLE, SLOPE, SLOPE)
def test_tilt_rates_on_a_slope_are_the_tilts_derivatives(yaw, north, east):
    world = World(Place(47.4, 8.55, 500.0), slope=(north, east))
    step = 1e-5
    before, after = (world.ground_tilt(yaw + s, 0.0) for s in (-step, step))
    _, _, roll_rate, pitch_rate = world.ground_tilt(yaw, 1.0)
    assert roll_rate == pytest.approx((after[0] - before[0]) / (2 * step), abs=1e-8)
    assert pitch_rate == pytest.approx((after[1] - before[1]) / (2 * step), abs=1e-8)


@given(ANGLE, st.floats(-1.5, 1.5), ANGLE)
def test_the_plain_rotation_matrix_is_that_of_the_frames(roll, pitch, yaw):
    plain = np.reshape(rotation_matrix(roll, pitch, yaw), (3, 3))
    np.testing.assert_allclose(plain, euler_to_matrix(roll, pitch, yaw), atol=1e-14)


@pytest.mark.parametrize("vehicle", ["rover", "boat", "copter"])
def test_the_body_rate_is_the_rotations_derivative(vehicle):
    """R' = R [w]x, by the middle of two steps."""
    v = SimulatedAutopilot(vehicle, seed=4, tilt_deg=8.0, armed=vehicle != "rover")
    v.turn_by_hand([HandMove(math.radians(120.0), lasts_s=4.0, roll_rad=0.1, pitch_rad=-0.05)])
    rotations, rates = [], []
    dt = v.board.tick_us * 1e-6
    for _ in range(100):
        v.advance(v.time_s + dt)
        rotations.append(np.reshape(v.body.rotation, (3, 3)))
        rates.append(v.body.rate_radps)
    for i in range(1, len(rates) - 1):
        turned = rotations[i - 1].T @ rotations[i + 1]
        vector = 0.5 * (turned - turned.T)[[2, 0, 1], [1, 2, 0]]
        before, now, after = np.array(rates[i - 1 : i + 2])
        np.testing.assert_allclose(vector, dt * (0.5 * before + now + 0.5 * after), atol=2e-4)


def test_the_accelerometer_at_rest_shows_gravity():
    v = SimulatedAutopilot("rover", seed=1, armed=False, tilt_deg=6.0)
    v.advance(1.0)
    force = np.reshape(v.body.rotation, (3, 3)) @ v.body.specific_force_mps2
    np.testing.assert_allclose(force, [0.0, 0.0, -9.80665], atol=1e-9)


def test_noise_averages_down_over_a_tenth_of_a_second():
    compass = Compass(CompassModel(noise_mgauss=3.0), seed=1, instance=1)
    readings = np.array([compass.add_noise((0.0, 0.0, 0.0), 0.1) for _ in range(4000)])
    np.testing.assert_allclose(readings.std(axis=0), 3.0 / math.sqrt(10.0), rtol=0.05)


def test_a_tape_deals_the_generators_numbers_in_order():
    tape, plain = NoiseTape(generator(5, "x"), 3), generator(5, "x").standard_normal((600, 3))
    np.testing.assert_array_equal([tape.row() for _ in range(600)], plain)
    assert generator(5, "y").standard_normal() != plain[0, 0]


@given(st.integers(0, 10_000), st.floats(-0.4, 0.4), st.floats(-0.4, 0.4))
@settings(max_examples=30, deadline=None)
def test_the_exact_cure_leaves_no_heading_error_at_any_tilt(seed, roll, pitch):
    v = SimulatedAutopilot("rover", seed=seed)
    errors = heading_errors_rad(v, 1, v.board.compass_setups[0].model.iron, roll, pitch)
    assert float(np.abs(errors).max()) < 1e-9


def test_hard_iron_bends_the_heading_as_geometry_says():
    """Offset b along x in a horizontal field H: error(psi) = atan2 of the summed vectors."""
    plain = FieldCorrection()
    v = SimulatedAutopilot("rover", compasses=[CompassSetup(CompassModel(plain), plain)] * 3)
    h = v.world.horizontal_mgauss
    errors = heading_errors_rad(v, 1, FieldCorrection((0.5 * h, 0.0, 0.0)))
    magnetic = np.linspace(-math.pi, math.pi, 72, endpoint=False) - v.world.declination_rad
    expected = np.arctan2(np.sin(magnetic), np.cos(magnetic) + 0.5) - magnetic
    np.testing.assert_allclose(np.exp(1j * errors), np.exp(1j * expected), atol=1e-9)
    assert heading_error_rms_deg(v, 1, FieldCorrection((0.5 * h, 0.0, 0.0))) == pytest.approx(21.0, abs=0.6)
