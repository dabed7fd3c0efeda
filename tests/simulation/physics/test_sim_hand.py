"""A simulated vehicle in a person's hands, and one that cannot turn."""

import math

import numpy as np
import pytest

from mavcompass import messages as m
from mavcompass.simulation.physics.hand import HandMove, four_turns


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
