"""What the simulated ArduPilot's magnetometer messages carry."""

import numpy as np
import pytest

from mavcompass import messages as m
from mavcompass.compass_parameters import ardupilot_values
from mavcompass.correction import IDENTITY, FieldCorrection
from mavcompass.frames import rotate_back
from mavcompass.simulation.autopilot.reports import int16
from mavcompass.simulation.physics.sensors import CompassModel, CompassSetup

IRON = FieldCorrection((120.0, -80.0, 40.0), (1.1, 0.9, 1.0), (0.02, 0.0, -0.01))


def quiet(in_force=IDENTITY, iron=IRON):
    """Three noiseless compasses."""
    return [CompassSetup(CompassModel(iron, noise_mgauss=0.0), in_force)] * 3


def fields(station, kind=m.RawImu, seconds=0.6):
    return np.array([(i.xmag, i.ymag, i.zmag) for i in station.of(kind, station.wait(seconds))])


def test_raw_imu_carries_the_corrected_field(station):
    s = station(compasses=quiet(IRON), tilt_deg=0.0)
    s.stream(27, 10)
    truth = s.vehicle.truth
    expected = np.trunc(rotate_back(truth.rotation, truth.field_ned_mgauss))
    np.testing.assert_array_equal(fields(s), np.tile(expected, (len(fields(s)), 1)))


def test_an_offset_written_shows_at_once(station):
    s = station(compasses=quiet(IRON), tilt_deg=0.0)
    s.stream(27, 10)
    before = fields(s)[-1]
    s.set("COMPASS_OFS_X", 220.0)
    s.wait(0.1)
    shift = fields(s)[-1] - before
    np.testing.assert_allclose(shift, [110.0, 2.0, 0.0], atol=1.0)


def test_all_three_compasses_are_corrected_each_by_its_own(station):
    s = station(compasses=quiet(IRON), tilt_deg=0.0)
    for number in (26, 116, 129):
        s.stream(number, 10)
    s.set("COMPASS_OFS2_Z", 140.0)
    s.wait(0.2)
    s.heard.clear()
    s.wait(0.2)
    first, second, third = (s.of(kind)[-1] for kind in (m.ScaledImu, m.ScaledImu2, m.ScaledImu3))
    assert (first.xmag, first.zmag) == (third.xmag, third.zmag)
    assert second.zmag - first.zmag == pytest.approx(100, abs=1)
    assert (third.xacc, third.zacc, third.zgyro) == (0, 0, 0)
    assert second.zacc == pytest.approx(-1000, abs=60)


def test_the_field_is_truncated_toward_zero_and_wraps():
    assert [int16(v) for v in (52.7, -528.9, 32768.0, -32769.0, 70000.5)] == [52, -528, -32768, 32767, 4464]


@pytest.mark.parametrize(("scale", "applied"), [(1.2, 1.2), (0.6, 1.0), (1.6, 1.0), (0.0, 1.0)])
def test_a_scale_outside_its_limits_is_echoed_but_not_used(station, scale, applied):
    s = station(compasses=quiet(IRON), tilt_deg=0.0)
    s.stream(27, 10)
    before = fields(s)[-1]
    assert s.set("COMPASS_SCALE", scale)[0].param_value == pytest.approx(scale)
    s.wait(0.1)
    np.testing.assert_allclose(fields(s)[-1], before * applied, atol=2.0)


@pytest.mark.parametrize(("zeros", "left"), [("XYZ", (1.0, 1.0, 1.0)), ("Y", (1.0, 0.0, 1.0))])
def test_all_zero_diagonals_mean_no_matrix_and_one_is_applied(station, zeros, left):
    s = station(compasses=quiet(FieldCorrection((120.0, -80.0, 40.0)), FieldCorrection((120.0, -80.0, 40.0))))
    s.stream(27, 10)
    before = fields(s)[-1]
    for axis in zeros:
        s.set(f"COMPASS_DIA_{axis}", 0.0)
    s.wait(0.1)
    np.testing.assert_array_equal(fields(s)[-1], before * left)


def test_the_motor_term_follows_the_current(station):
    s = station("copter", compasses=quiet(IRON), tilt_deg=0.0)
    s.stream(27, 10)
    s.wait(1.0)
    before = fields(s).mean(axis=0)
    s.set("COMPASS_MOT_X", -5.0)
    s.set("COMPASS_MOTCT", 2.0)
    # Looked at before the copter has followed its bent compass.
    shift = fields(s).mean(axis=0) - before
    np.testing.assert_allclose(shift, [-5.0 * 28.0, 0.0, 0.0], atol=10.0)


def test_the_compass_is_read_at_ten_hertz_and_repeated(station):
    s = station(seed=3)
    s.stream(27, 40)
    values = fields(s, seconds=10.0)
    repeats = np.all(values[1:] == values[:-1], axis=1).mean()
    assert 0.6 <= repeats <= 0.85


def test_the_field_lags_a_turning_vehicle_by_about_a_tenth_of_a_second(station):
    s = station("copter", compasses=quiet(IRON, IRON), tilt_deg=0.0)
    s.stream(27, 50)
    s.stream(164, 50)
    s.command(115, 90.0, 30.0, 1.0, 1.0)
    s.wait(0.8)
    s.heard.clear()
    s.wait(1.5)
    imu, sim = s.of(m.RawImu), s.of(m.Simstate)
    yaw = np.array([x.yaw for x in sim])
    declination = s.vehicle.truth.declination_rad
    mag = np.array([np.arctan2(-i.ymag, i.xmag) + declination for i in imu])
    lag = np.unwrap(yaw) - np.unwrap(mag)
    rate = np.gradient(np.unwrap(yaw), 0.02).mean()
    # The tilt of a hovering copter, which these two numbers leave out, makes for the tolerance.
    assert float(np.mean(lag) / rate) == pytest.approx(0.10, abs=0.05)


def test_a_rotated_compass_is_turned_by_its_orientation(station):
    s = station(compasses=quiet(FieldCorrection(), FieldCorrection()), tilt_deg=0.0)
    s.stream(27, 10)
    x, y, z = fields(s)[-1]
    s.set("COMPASS_ORIENT", 2.0)
    s.wait(0.1)
    np.testing.assert_allclose(fields(s)[-1], [-y, x, z], atol=1.0)


def test_an_invalid_orientation_is_an_internal_error_until_the_reboot(station):
    s = station(armed=False, ready_s=1.0)
    s.set("COMPASS_ORIENT", 99.0)
    assert any("bad_rotation" in t for t in s.texts())
    s.set("COMPASS_ORIENT", 0.0)
    s.wait(5.0)
    assert s.command(400, 1.0) == 4
    assert "bad_rotation" in s.texts()[-1]


def test_an_unplugged_compass_keeps_streaming_and_loses_its_health(station):
    s = station(seed=1)
    s.stream(27, 10)
    s.stream(1, 2)
    s.vehicle.cut_sensor(1)
    s.wait(0.2)
    s.hold_heading(0.0, 4.0)
    s.heard.clear()
    values = fields(s, seconds=2.0)
    assert len(np.unique(values, axis=0)) == 1
    assert not s.of(m.SysStatus)[-1].onboard_control_sensors_health & 4


def test_a_compass_of_zeros_shows_only_its_offsets(station):
    s = station(seed=1, parameters=ardupilot_values(FieldCorrection((11.0, -22.0, 33.0)), 1))
    s.stream(27, 10)
    s.vehicle.zero_compass(1)
    s.wait(0.2)
    np.testing.assert_array_equal(fields(s)[-1], [11, -22, 33])


def test_compass_enable_zero_freezes_the_field(station):
    s = station(seed=1)
    s.stream(27, 10)
    s.set("COMPASS_ENABLE", 0.0)
    s.wait(0.2)
    s.hold_heading(0.0, 3.0)
    assert len(np.unique(fields(s, seconds=2.0), axis=0)) == 1
