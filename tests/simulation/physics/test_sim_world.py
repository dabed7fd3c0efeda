"""The simulated world and the motion in it obey geometry and kinematics."""

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from mavcompass import messages as m
from mavcompass.correction import FieldCorrection
from mavcompass.earth_field import decimal_year, earth_field
from mavcompass.frames import euler_to_matrix
from mavcompass.simulation.heading_error import heading_error_rms_deg, heading_errors_rad
from mavcompass.simulation.physics.hand import HandMove, four_turns
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


# --- A simulated vehicle in a person's hands, and one that cannot turn


def turned_deg(s, before):
    return math.degrees(math.remainder(s.vehicle.truth.yaw_rad - before, 2 * math.pi))


@pytest.mark.parametrize("vehicle", ["rover", "copter", "boat", "px4-copter"])
@pytest.mark.parametrize("angle", [90.0, -75.0])
def test_a_person_turns_a_disarmed_vehicle_by_an_angle(station, vehicle, angle):
    s = station(vehicle, armed=False)
    before = s.vehicle.truth.yaw_rad
    s.vehicle.turn_by_hand([HandMove(math.radians(angle), lasts_s=3.0)])
    s.wait(3.2)
    assert turned_deg(s, before) == pytest.approx(angle, abs=0.1)
    s.wait(3.0)
    assert turned_deg(s, before) == pytest.approx(angle, abs=1.0 if vehicle == "boat" else 0.1)


def test_the_gyro_feels_the_hands(station):
    s = station(armed=False, tilt_deg=0.0)
    s.stream(27, 40)
    s.heard.clear()
    s.vehicle.turn_by_hand([HandMove(math.radians(90.0), lasts_s=3.0)])
    s.wait(4.0)
    imu = s.of(m.RawImu)
    angle = np.trapezoid([i.zgyro * 1e-3 for i in imu], [i.time_usec * 1e-6 for i in imu])
    assert math.degrees(angle) == pytest.approx(90.0, abs=1.0)
    assert np.std([i.xgyro for i in imu]) > 10.0  # they tremble


def test_a_tilt_is_held_until_the_next_move(station):
    s = station(armed=False, tilt_deg=0.0)
    tilted = HandMove(0.0, lasts_s=1.0, rests_s=2.0, roll_rad=math.radians(12.0))
    s.vehicle.turn_by_hand([tilted, HandMove(0.0, lasts_s=1.0)])
    s.wait(2.5)
    assert math.degrees(s.vehicle.truth.roll_rad) == pytest.approx(12.0, abs=0.01)
    s.wait(3.0)
    assert math.degrees(s.vehicle.truth.roll_rad) == pytest.approx(0.0, abs=0.01)


def test_the_gyro_feels_how_what_trembles_comes_to_rest(station):
    """No tilt ends without a rate: what the gyro adds up to, over move and rest, is how far it leans."""
    s = station(armed=False, tilt_deg=0.0)
    s.wait(1.0)
    s.vehicle.turn_by_hand([HandMove(0.0, lasts_s=3.0)])
    angle = worst = 0.0
    for _ in range(200):
        before = s.vehicle.body.rate_radps[0]
        s.wait(0.02)
        angle += 0.01 * (before + s.vehicle.body.rate_radps[0])
        worst = max(worst, abs(angle - s.vehicle.truth.roll_rad))
    assert math.degrees(worst) < 0.1 and math.degrees(abs(s.vehicle.truth.roll_rad)) < 0.1


def test_a_persons_four_turns_are_uneven(station):
    s = station(armed=False, seed=8)
    before = s.vehicle.truth.yaw_rad
    moves = four_turns(8)
    s.vehicle.turn_by_hand(moves)
    s.wait(sum(move.lasts_s + move.rests_s for move in moves))
    total = math.degrees(sum(move.turn_rad for move in moves))
    assert turned_deg(s, before) == pytest.approx(math.remainder(total, 360.0), abs=0.2)
    assert np.std([move.turn_rad for move in moves]) > math.radians(2.0)


def test_a_jammed_vehicle_accepts_targets_and_stays(station):
    s = station()
    s.vehicle.jam()
    before = s.vehicle.truth.yaw_rad
    s.hold_heading(before + 1.5, 4.0)
    assert s.vehicle.truth.yaw_rad == before


def test_a_firmware_can_be_deaf_to_a_message(station):
    s = station(deaf_to=[m.SetPositionTargetLocalNed])
    before = s.vehicle.truth.yaw_rad
    s.hold_heading(before + 1.5, 2.0)
    assert s.vehicle.truth.yaw_rad == before
    s.send(m.SetAttitudeTarget(0, 1, 1, 0x83, body_yaw_rate=0.5))
    s.wait(1.0)
    assert s.vehicle.truth.yaw_rate_radps == pytest.approx(0.5, abs=0.05)
