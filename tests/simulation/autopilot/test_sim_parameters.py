"""The parameter protocol of the simulated ArduPilot, traps included."""

import math

import pytest

from mavcompass import messages as m


def test_writing_the_x_element_is_echoed_with_all_three_as_they_still_are(station):
    s = station()
    y, z = s.read("COMPASS_OFS_Y"), s.read("COMPASS_OFS_Z")
    s.send(m.ParamSet(1, 1, "COMPASS_OFS_X", 120.0))
    s.send(m.ParamSet(1, 1, "COMPASS_OFS_Y", -80.0))
    echoes = [(v.param_id[8:], v.param_value) for v in s.of(m.ParamValue, s.wait(0.1))]
    assert echoes == [("OFS_X", 120.0), ("OFS_Y", y), ("OFS_Z", z), ("OFS_Y", -80.0)]


@pytest.mark.parametrize("name", ["COMPASS_OFS_Y", "COMPASS_DIA2_Z", "COMPASS_SCALE"])
def test_other_elements_are_echoed_once(station, name):
    assert [e.param_id for e in station().set(name, 1.0)] == [name]


def test_an_echo_has_no_index_and_is_a_float(station):
    (echo,) = station().set("COMPASS_SCALE", 1.05)
    assert (echo.param_index, echo.param_type) == (65535, 9)
    assert echo.param_value == pytest.approx(1.05, abs=1e-7)
    assert echo.param_value != 1.05  # a 32 bit float


def test_unknown_names_get_no_answer(station):
    s = station()
    assert s.set("COMPASS_NONSENSE", 1.0) == []
    assert s.ask(m.ParamRequestRead(1, 1, "COMPASS_NONSENSE"), m.ParamValue) == []


@pytest.mark.parametrize("value", [math.nan, math.inf, -math.inf, 1e39])
def test_numbers_that_are_none_are_ignored_in_silence(station, value):
    s = station()
    before = s.read("COMPASS_OFS_X")
    assert s.set("COMPASS_OFS_X", value) == []
    assert s.read("COMPASS_OFS_X") == before


@pytest.mark.parametrize("value", [5000.0, 1e6])
def test_absurd_offsets_are_taken_without_clamping(station, value):
    s = station()
    s.set("COMPASS_OFS_X", value)
    assert s.read("COMPASS_OFS_X") == value


def test_the_list_comes_complete_and_in_order(station):
    s = station()
    listed = s.ask(m.ParamRequestList(1, 1), m.ParamValue, seconds=5.0)
    assert [v.param_index for v in listed] == list(range(listed[0].param_count))
    assert {"COMPASS_OFS_X", "SYSID_THISMAV", "ARMING_CHECK"} <= {v.param_id for v in listed}
    assert all(len(v.param_id) <= 16 for v in listed)


def test_a_parameter_is_read_by_index(station):
    s = station()
    (value,) = s.ask(m.ParamRequestRead(1, 1, "", 10), m.ParamValue)
    assert value.param_index == 10
    assert s.ask(m.ParamRequestRead(1, 1, "", 9999), m.ParamValue) == []


def test_parameters_are_meant_for_one_vehicle(station):
    s = station()
    assert s.ask(m.ParamRequestRead(2, 1, "COMPASS_OFS_X"), m.ParamValue) == []
    assert len(s.ask(m.ParamRequestRead(0, 0, "COMPASS_OFS_X"), m.ParamValue)) == 1


def test_parameters_survive_a_reboot(station):
    s = station(armed=False)
    s.set("COMPASS_OFS_X", 77.0)
    assert s.command(246, 1.0) == 0
    s.wait(3.0)
    assert s.read("COMPASS_OFS_X") == 77.0


def test_written_parameters_can_be_handed_to_another_instance(station):
    storage: dict[str, float] = {}
    station(storage=storage).set("COMPASS_OFS_X", 77.0)
    assert storage == {"COMPASS_OFS_X": 77.0}
    assert station(storage=storage).read("COMPASS_OFS_X") == 77.0


def test_some_parameters_arrive_unasked(station):
    s = station(armed=False)
    s.wait(65.0)
    names = [v.param_id for v in s.of(m.ParamValue)]
    assert names.count("STAT_RUNTIME") == 2
    assert names.count("BARO1_GND_PRESS") == 2


def test_the_system_id_is_a_parameter(station):
    s = station(system=7)
    s.send(m.ParamRequestRead(7, 1, "SYSID_THISMAV"))
    (out,) = [o for o in s.wait(0.1) if isinstance(o.message, m.ParamValue)]
    assert (out.system, out.message.param_value) == (7, 7.0)


def test_integer_parameters_are_rounded_and_bounded(station):
    s = station()
    s.set("COMPASS_USE", 0.9)
    assert s.read("COMPASS_USE") == 1.0
    s.set("COMPASS_ORIENT", 1000.0)
    assert s.read("COMPASS_ORIENT") == 127.0
