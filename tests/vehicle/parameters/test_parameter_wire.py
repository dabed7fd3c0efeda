"""The parameter protocol over good and bad radios."""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np
import pytest
from hypothesis import example, given
from hypothesis import strategies as st
from parameter_vehicle import ParameterVehicle, PX4Vehicle, Radio, ardupilot_parameters, px4_parameters

from mavcompass.errors import LinkLost, NoReply, Refused
from mavcompass.messages import ParamRequestRead, ParamSet, ParamValue
from mavcompass.messages.bits import bits_of_single, single_from_bits
from mavcompass.procedure.script import Context, Script
from mavcompass.vehicle.dialects import make_dialect
from mavcompass.vehicle.parameters import protocol as wire
from mavcompass.vehicle.parameters import values
from mavcompass.vehicle.wire import codec

BAD_RADIO = {"loss": 0.3, "duplication": 0.05, "delay_s": 0.3, "jitter_s": 0.2}


def test_all_compass_parameters_are_read_in_a_few_round_trips() -> None:
    radio = Radio(ParameterVehicle())
    held = radio.run(make_dialect("ardupilot").compass_parameters)
    names = {name for name in ardupilot_parameters()}
    assert set(held) == names
    assert held["COMPASS_DEC"] == 0.2233572  # the shortest decimal, not 0.22335720062255859
    # 60 names with 40 ms round trip, 8 under way; four patient tries for the few that do not exist.
    assert radio.now_s < 3.0


def test_a_name_that_the_vehicle_does_not_know_is_absent() -> None:
    radio = Radio(ParameterVehicle())
    held = radio.run(_read("COMPASS_OFS_X", "NO_SUCH_NAME"))
    assert held == {"COMPASS_OFS_X": 5.0}


def test_a_lone_unknown_name_is_absent_while_the_vehicle_beats() -> None:
    radio = Radio(ParameterVehicle())
    assert radio.run(_read("NO_SUCH_NAME")) == {}
    assert radio.now_s < 12.0


def _read(*names: str) -> Callable[[Context], Script[dict[str, float]]]:
    return lambda context: make_dialect("ardupilot").read_parameters(context, names)


def test_a_dead_link_is_a_lost_vehicle_not_an_empty_answer() -> None:
    radio = Radio(ParameterVehicle(), cut_s=0.0, silence_s=math.inf)
    with pytest.raises(LinkLost, match="silent"):
        radio.run(_read("COMPASS_OFS_X"))


def test_a_vehicle_that_only_beats_has_no_compass_parameters_to_read() -> None:
    vehicle = ParameterVehicle()
    vehicle.mute = True
    for autopilot in ("ardupilot", "px4"):
        with pytest.raises(NoReply, match="alive"):
            Radio(vehicle).run(make_dialect(autopilot).compass_parameters)


@pytest.mark.parametrize("seed", range(4))
def test_nothing_is_missed_on_a_bad_radio(seed: int) -> None:
    radio = Radio(ParameterVehicle(), seed=seed, silence_s=15.0, **BAD_RADIO)
    held = radio.run(make_dialect("ardupilot").compass_parameters)
    assert set(held) == set(ardupilot_parameters())
    assert held["COMPASS_DEV_ID2"] == 131874.0


def test_the_newer_spelling_is_found_by_two_questions() -> None:
    values = {
        name.replace("COMPASS_OFS2_", "COMPASS2_OFS_").replace("COMPASS_OFS_", "COMPASS1_OFS_"): value
        for name, value in ardupilot_parameters().items()
        if "OFS_" in name or "OFS2_" in name or name == "COMPASS_ENABLE"
    }
    radio = Radio(ParameterVehicle(values))
    dialect = make_dialect("ardupilot")
    held = radio.run(dialect.compass_parameters)
    assert held["COMPASS2_OFS_Y"] == 13.0
    assert dialect.instances(held) == (1, 2)
    assert not [m for m in radio.sent if isinstance(m, ParamRequestRead) and "OFS2_" in m.param_id]


def test_only_as_many_requests_are_under_way_as_the_vehicles_queue_holds() -> None:
    radio = Radio(ParameterVehicle(), delay_s=0.2)
    radio.run(make_dialect("ardupilot").compass_parameters)
    first_answer_s = 0.4
    asked = [m for m, t in zip(radio.sent, radio.sent_s, strict=True) if 0.4 <= t < 0.4 + first_answer_s]
    assert len(asked) == wire.WINDOW


def test_a_write_is_not_fooled_by_the_echo_of_its_neighbour() -> None:
    vehicle = ParameterVehicle()
    radio = Radio(vehicle, jitter_s=0.3, seed=3)
    offsets = {"X": 120.0, "Y": -80.0, "Z": 40.0}
    wanted = {f"COMPASS_OFS_{axis}": values.Parameter(value) for axis, value in offsets.items()}
    radio.run(lambda context: wire.write(context, wanted, "cast"))
    assert [vehicle.values[name] for name in wanted] == [120.0, -80.0, 40.0]


@pytest.mark.parametrize(("axis", "kept"), [("X", 5), ("Y", 13)])  # of an _X all three are told
def test_a_value_that_the_vehicle_keeps_in_seven_tries_is_refused_by_it(axis: str, kept: int) -> None:
    vehicle, name = ParameterVehicle(), f"COMPASS_OFS_{axis}"
    vehicle.stuck.add(name)
    with pytest.raises(wire.ValueRefused, match=f"keeps {name} at {kept} instead of -80"):
        Radio(vehicle).run(lambda context: wire.write(context, {name: values.Parameter(-80.0)}, "cast"))
    assert vehicle.writes == [name] * 7


@given(st.integers(-(2**31), 2**31 - 1))
@example(-1)
@example(0x7F800001)  # a signalling NaN, which the processor's float registers quieten
@example(-(2**31))  # minus zero
@example(1)  # the smallest denormal
def test_px4_integers_survive_the_trip_bit_for_bit(whole: int) -> None:
    context = Context(system=1, component=1)
    sent = values.encode("CAL_MAG0_ROT", values.Parameter(float(whole), 6), "bytewise", context)
    _, payload = codec.encode(sent)
    assert int.from_bytes(payload[:4], "little", signed=True) == whole
    heard = codec.decode(codec.message_id(ParamSet), payload)
    assert isinstance(heard, ParamSet)
    back = values.decode(ParamValue("CAL_MAG0_ROT", heard.param_value, 6), "bytewise")
    assert back == values.Parameter(float(whole), 6)


@given(st.integers(0, 2**32 - 1))
def test_every_pattern_of_bits_is_a_float_and_back(bits: int) -> None:
    assert bits_of_single(single_from_bits(bits)) == bits


def test_a_large_whole_number_is_not_taken_for_its_neighbour() -> None:
    neighbour = values.Parameter(float(2**31 - 2), 6)
    assert not values.holds(neighbour, float(2**31 - 1), "bytewise")
    assert values.holds(neighbour, float(2**31 - 1), "cast")  # ArduPilot's floats cannot tell them apart


@given(st.floats(width=32, allow_nan=False, allow_infinity=False))
def test_the_tidy_decimal_is_the_same_32_bit_float(value: float) -> None:
    assert np.float32(values.tidy(value)) == np.float32(value)
    assert values.same_value(values.tidy(value), value)
    assert len(repr(values.tidy(value))) <= len(repr(value)) + 1


def test_an_odd_parameter_type_does_not_stop_the_reading() -> None:
    assert values.decode(ParamValue("A", 2.5, 77), "bytewise") == values.Parameter(2.5, 77)
    assert math.isnan(values.decode(ParamValue("A", math.nan, 9), "cast").value)


def test_px4_is_read_and_written_with_its_types() -> None:
    vehicle = PX4Vehicle()
    dialect = make_dialect("px4")
    held = Radio(vehicle).run(dialect.compass_parameters)
    assert dialect.instances(held) == (1, 2)
    assert held["CAL_MAG0_ROT"] == -1.0 and held["CAL_MAG1_ID"] == 396825.0
    assert set(held) == {n for n in px4_parameters() if not n.startswith(("CAL_MAG2_", "CAL_MAG3_"))} | {
        "CAL_MAG2_ID",
        "CAL_MAG3_ID",
    }
    wanted = {"CAL_MAG0_ROT": values.Parameter(4.0, 6), "CAL_MAG0_XOFF": values.Parameter(0.1)}
    radio = Radio(vehicle)
    radio.run(lambda context: wire.write(context, wanted, "bytewise"))
    assert vehicle.values["CAL_MAG0_ROT"] == 4.0
    assert all(isinstance(m, ParamSet | ParamRequestRead) for m in radio.sent)


def test_an_unknown_autopilot_has_no_dialect() -> None:
    with pytest.raises(Refused, match="'generic'"):
        make_dialect("generic")
