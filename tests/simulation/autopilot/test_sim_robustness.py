"""Nothing that comes over a wire may upset a simulated flight controller."""

import dataclasses
import math
import struct

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from mavcompass import messages as m
from mavcompass.enums import MavCmd
from mavcompass.simulation.autopilot.telemetry import MESSAGES
from mavcompass.simulation.vehicle import SimulatedAutopilot

KINDS = sorted(
    (k for k in vars(m).values() if isinstance(k, type) and issubclass(k, m.Message) and k is not m.Message),
    key=lambda k: k.__name__,
)
NUMBERS = st.one_of(
    st.sampled_from(
        [0.0, 1.0, -1.0, 2.0, 4.0, 6.0, 76.0, 21196.0, math.nan, math.inf, -math.inf, 3e38, 1e-40]
    ),
    st.floats(width=32),
    st.sampled_from([float(n) for n in MESSAGES]),
)
WHOLE = st.one_of(
    st.sampled_from([0, 1, 2, 15, 255, 511, 65535, 0x9FF, 0x5FF, 0x9C7, 0x5C7, *map(int, MavCmd)]),
    st.integers(0, 2**31),
)
NAMES = st.one_of(
    st.sampled_from(["COMPASS_OFS_X", "COMPASS_ORIENT", "COMPASS_DIA_X", "CAL_MAG0_ROT", "CAL_MAG0_ID", ""]),
    st.text(max_size=16),
)


@st.composite
def any_message(draw):
    kind = draw(st.sampled_from(KINDS))
    values = {}
    for field in dataclasses.fields(kind):
        if field.name in ("target_system", "target_component", "target"):
            values[field.name] = draw(st.sampled_from([0, 1, 1, 1, 2]))
        elif isinstance(field.default, str):
            values[field.name] = draw(NAMES)
        elif isinstance(field.default, float):
            values[field.name] = draw(NUMBERS)
        elif isinstance(field.default, int):
            values[field.name] = draw(WHOLE)
        elif field.name == "q":
            values[field.name] = tuple(draw(NUMBERS) for _ in range(4))
    return kind(**values)


@pytest.mark.parametrize("vehicle", ["rover", "copter", "sub", "px4-copter"])
@given(messages=st.lists(any_message(), max_size=25), armed=st.booleans())
@settings(max_examples=15, deadline=None)
def test_any_message_with_any_numbers_is_survived(vehicle, messages, armed):
    v = SimulatedAutopilot(vehicle, armed=armed, ready_s=0.1)
    for message in messages:
        v.receive(message, 255, 190)
        v.advance(v.time_s + 0.15)
    v.advance(v.time_s + 3.0)
    assert math.isfinite(v.truth.yaw_rad)
    assert math.isfinite(v.filter.yaw_rad)
    assert all(math.isfinite(x) for x in v.truth.position_ned_m)


@pytest.mark.parametrize("vehicle", ["rover", "copter", "sub"])
def test_absurd_calibrations_are_survived(station, vehicle):
    s = station(vehicle)
    s.stream(27, 20)
    for name in ("COMPASS_OFS_X", "COMPASS_DIA_X", "COMPASS_ODI_X", "COMPASS_MOT_X"):
        s.set(name, 3e38)
    s.set("COMPASS_MOTCT", 2.0)
    s.set("COMPASS_DIA2_Y", 0.0)
    s.wait(1.0)
    assert s.command(42006, 0.0) == 0
    for name in ("ATC_STR_ANG_P", "ATC_STR_RAT_MAX", "ATC_STR_ACC_MAX", "ATC_SLEW_YAW"):
        s.set(name, -3e38)
    s.command(115, 90.0, 0.0, 1.0, 1.0)
    s.hold_heading(1.0, 2.0)
    assert math.isfinite(s.vehicle.filter.yaw_rad)
    assert math.isfinite(s.vehicle.truth.yaw_rad)
    assert s.of(m.RawImu)[-1].time_usec > 60_000_000


def test_absurd_px4_calibrations_are_survived(station):
    s = station("px4-copter", armed=False)
    s.stream(26, 20)
    s.stream(105, 20)
    for name, value in (("CAL_MAG0_XOFF", 3e38), ("CAL_MAG0_XSCALE", 3e38), ("CAL_MAG1_YSCALE", 0.0)):
        s.set(name, value)
    s.ask(m.ParamSet(1, 1, "CAL_MAG0_ROT", struct.unpack("<f", struct.pack("<i", 77))[0], 6), m.ParamValue)
    s.wait(1.0)
    assert s.command(42006, 0.0) == 0
    assert math.isfinite(s.vehicle.filter.yaw_rad)
    assert len(s.of(m.ScaledImu)) > 15


@pytest.mark.parametrize(
    "message",
    [
        m.SetAttitudeTarget(0, 1, 1, 0x07, (math.inf, 0.0, 0.0, math.inf)),
        m.SetAttitudeTarget(0, 1, 1, 0x83, body_yaw_rate=math.nan),
        m.SetPositionTargetLocalNed(0, 1, 1, 1, 0x9FF, yaw=math.nan),
        m.SetPositionTargetLocalNed(0, 1, 1, 1, 0x5FF, yaw_rate=math.inf),
        m.SetPositionTargetLocalNed(0, 1, 1, 1, 0x9C7, vx=math.nan),
    ],
)
def test_targets_that_are_no_numbers_are_ignored(station, message):
    s = station()
    before = s.vehicle.truth.yaw_rad
    s.send(message)
    s.wait(1.0)
    assert s.vehicle.truth.yaw_rad == before


def test_negative_integers_survive_the_bytewise_wire(station):
    s = station("px4-copter")
    (told,) = s.ask(m.ParamRequestRead(1, 1, "CAL_MAG2_PRIO"), m.ParamValue)
    assert struct.unpack("<i", struct.pack("<f", told.param_value)) == (-1,)
