"""What the simulated ArduPilot's estimator does with a compass that has just become right: as 4.5.7 did."""

import math

from mavcompass import messages as m
from mavcompass.correction import FieldCorrection
from mavcompass.frames import wrap_pi
from mavcompass.simulation.physics.sensors import CompassModel, CompassSetup

IRON = FieldCorrection((50.0, -30.0, 20.0))
WRONG = FieldCorrection((170.0, -110.0, 60.0))
SWITCH, DENIED = 42007, 2


def bent(station, vehicle="rover", parameters=None):
    """A vehicle whose compasses are all wrong, and whose filter has long believed them."""
    setups = [CompassSetup(CompassModel(IRON, 1.0), WRONG)] * 3
    s = station(vehicle, compasses=setups, tilt_deg=0.0, start_yaw_deg=0.0, parameters=parameters or {})
    s.wait(40.0)
    return s


def put_right(s):
    for axis, value in zip("XYZ", IRON.offsets_mgauss, strict=True):
        s.set(f"COMPASS_OFS_{axis}", value)
    s.wait(0.5)


def error_deg(s):
    vehicle = s.vehicle
    return abs(math.degrees(float(wrap_pi(vehicle.filter.yaw_rad - vehicle.body.yaw_rad))))


def test_the_yaw_follows_a_new_calibration_slowly_and_swings_past_it(station):
    s = bent(station)
    put_right(s)
    assert error_deg(s) > 10.0
    s.wait(5.0)
    assert error_deg(s) > 5.0
    assert abs(s.vehicle.filter.bias_radps) > math.radians(0.03)


def test_a_set_without_a_compass_and_back_takes_the_compass_yaw_over_at_once(station):
    s = bent(station)
    put_right(s)
    assert s.command(SWITCH, 2.0) == 0
    s.wait(0.2)
    assert error_deg(s) > 10.0
    assert s.command(SWITCH, 1.0) == 0
    s.wait(0.3)
    assert error_deg(s) < 1.0


def test_a_set_that_names_the_compass_too_changes_nothing(station):
    s = bent(station, parameters={"EK3_SRC2_YAW": 1.0})
    put_right(s)
    assert s.command(SWITCH, 2.0) == s.command(SWITCH, 1.0) == 0
    s.wait(0.3)
    assert error_deg(s) > 5.0


def test_a_hovering_copter_goes_on_with_what_it_has_learnt(station):
    s = bent(station, "copter")
    put_right(s)
    before = error_deg(s)
    assert s.command(SWITCH, 2.0) == 0
    s.wait(0.2)
    assert s.command(SWITCH, 1.0) == 0
    s.wait(0.3)
    assert error_deg(s) > 0.7 * before


def test_there_are_three_sets(station):
    s = bent(station)
    assert s.command(SWITCH, 3.0) == 0
    assert s.command(SWITCH, 1.0) == 0
    assert s.command(SWITCH, 4.0) == s.command(SWITCH, 0.0) == DENIED


def test_the_compass_variance_tells_the_disagreement_in_units_of_86_degrees(station):
    s = bent(station)
    put_right(s)
    s.stream(193, 4.0)
    s.wait(1.0)
    told = s.of(m.EkfStatusReport)[-1].compass_variance
    assert 0.5 * error_deg(s) / 86.0 < told < 1.5 * error_deg(s) / 86.0 + 0.05
