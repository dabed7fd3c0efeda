"""Recordings as vehicles: what was said comes again, what is asked is answered."""

from __future__ import annotations

import json
import math
import subprocess
import sys
from collections import Counter
from collections.abc import Callable, Iterator
from operator import itemgetter
from pathlib import Path

import numpy as np
import pytest
from far_ends import write_tlog
from serving import hear, serving

from mavcompass.cli.replay import parse_faults
from mavcompass.correction import FieldCorrection
from mavcompass.enums import MavAutopilot, MavCmd, MavParamType, MavResult, MavType
from mavcompass.errors import BadRecording, LinkLost, UsageError
from mavcompass.messages import (
    Attitude,
    CommandAck,
    CommandLong,
    GlobalPositionInt,
    GpsRawInt,
    Heartbeat,
    HighresImu,
    Incoming,
    Message,
    MessageInterval,
    ParamRequestList,
    ParamRequestRead,
    ParamSet,
    ParamValue,
    RawImu,
    ScaledImu,
    ScaledImu2,
    ServoOutputRaw,
    Simstate,
    SysStatus,
    SystemTime,
    VfrHud,
    message_id,
)
from mavcompass.track import InForce, MagSeries, Series, Track
from mavcompass.vehicle.link import Link
from mavcompass.vehicle.links.autopilot import SaidMessage
from mavcompass.vehicle.links.faults import Faults, FaultyRecording
from mavcompass.vehicle.opening import open_link
from mavcompass.vehicle.replay import Alterations, ReplayedLink, replayed_autopilot
from mavcompass.vehicle.replay import tlog as tlog_room
from mavcompass.vehicle.replay.replayed import ReplayedAutopilot
from mavcompass.vehicle.replay.tlog import LONGEST_PAUSE_S
from mavcompass.vehicle.replay.track_messages import track_contents, track_messages
from mavcompass.vehicle.transport import Tcp
from mavcompass.vehicle.wire import FrameWriter

VEHICLE = Heartbeat(type=MavType.GROUND_ROVER, autopilot=MavAutopilot.ARDUPILOTMEGA)
STATION = Heartbeat(type=MavType.GCS, autopilot=MavAutopilot.INVALID)
Line = tuple[float, int, int, Message]


def lines() -> Iterator[Line]:
    """Three seconds of a vehicle at 10 Hz, and a ground station that wrote a parameter."""
    yield 0.0, 255, 190, STATION
    yield 0.0, 1, 1, VEHICLE
    yield 0.05, 255, 190, ParamSet(1, 1, "COMPASS_OFS_X", 5.0)
    yield 0.06, 1, 1, ParamValue("COMPASS_OFS_X", 5.0, 9, 2, 65_535)
    yield 0.07, 1, 1, ParamValue("COMPASS_OFS_Y", 13.0, 9, 2, 65_535)
    yield 0.08, 1, 1, CommandAck(MavCmd.COMPONENT_ARM_DISARM, MavResult.FAILED)
    for i in range(30):
        yield 0.1 * i + 0.1, 1, 1, RawImu(time_usec=10_000_000 + 100_000 * i, xmag=200 + i, ymag=-50)
        if i % 10 == 9:
            yield 0.1 * i + 0.1, 1, 1, VEHICLE


@pytest.fixture
def tlog(tmp_path: Path) -> Path:
    return write_tlog(tmp_path / "a.tlog", lines())


def all_of(link: Link) -> list[Incoming]:
    return list(link)


def ask(link: Link, message: Message, kind: type[Message]) -> Message:
    link.send(message)
    end_s = link.now() + 1.0
    while link.now() < end_s:
        incoming = link.receive(0.1)
        if incoming is not None and type(incoming.message) is kind:
            return incoming.message
    raise AssertionError("no answer")


def test_what_was_said_comes_again_at_its_time(tlog: Path) -> None:
    with open_link(str(tlog)) as link:
        heard = all_of(link)
    vehicles = [line for line in lines() if line[1] == 1 or isinstance(line[3], Heartbeat)]
    assert [(i.system, i.component, i.message) for i in heard] == [line[1:] for line in vehicles]
    assert [i.time_s for i in heard] == pytest.approx([line[0] for line in vehicles], abs=1e-5)


def test_a_first_reading_is_not_waited_for_long(tmp_path: Path) -> None:
    """A station that was connected long before the vehicle: what it said then is known from the start."""
    late = ((40.0 * isinstance(line[3], RawImu) + line[0], *line[1:]) for line in lines())
    path = write_tlog(tmp_path / "late.tlog", sorted(late, key=itemgetter(0)))
    with open_link(str(path)) as link:
        heard = [i for i in all_of(link) if isinstance(i.message, RawImu)]
    assert (heard[0].time_s, heard[-1].time_s) == pytest.approx((3.0, 5.9), abs=0.01)
    with ReplayedLink(replayed_autopilot(path), "served, which may wait") as link:
        served = [i for i in all_of(link) if isinstance(i.message, RawImu)]
    assert served[0].time_s == pytest.approx(3.0 + LONGEST_PAUSE_S)


def test_what_a_ground_station_asked_then_is_not_asked_again(tlog: Path) -> None:
    with open_link(str(tlog)) as link:
        assert not any(isinstance(i.message, ParamSet) for i in all_of(link))


def test_the_end_is_a_lost_link(tlog: Path) -> None:
    with open_link(str(tlog)) as link:
        all_of(link)
        with pytest.raises(LinkLost, match="ended too soon"):
            link.receive(1.0)


def test_parameters_are_answered_from_the_first_moment(tlog: Path) -> None:
    with open_link(str(tlog)) as link:
        value = ask(link, ParamRequestRead(1, 1, "COMPASS_OFS_Y"), ParamValue)
        assert value == ParamValue("COMPASS_OFS_Y", 13.0, 9, 2, 1)
        assert ask(link, ParamRequestRead(1, 1, "", 0), ParamValue) == ParamValue(
            "COMPASS_OFS_X", 5.0, 9, 2, 0
        )


def test_unknown_parameters_get_silence(tlog: Path) -> None:
    with open_link(str(tlog)) as link:
        link.send(ParamRequestRead(1, 1, "NO_SUCH_NAME"))
        link.send(ParamSet(1, 1, "NO_SUCH_NAME", 1.0))
        told = {i.message.param_id for i in link if isinstance(i.message, ParamValue)}
        assert told == {"COMPASS_OFS_X", "COMPASS_OFS_Y"}


def test_a_written_parameter_stays_written_for_the_session(tlog: Path) -> None:
    with open_link(str(tlog)) as link:
        echo = ask(link, ParamSet(1, 1, "COMPASS_OFS_X", 77.0), ParamValue)
        assert echo == ParamValue("COMPASS_OFS_X", 77.0, 9, 2, 65_535)
        link.send(ParamRequestList(1, 1))
        values = [i.message for i in link if isinstance(i.message, ParamValue)]
        assert {v.param_value for v in values if v.param_id == "COMPASS_OFS_X"} == {77.0}


def test_requests_to_another_vehicle_are_not_ours(tlog: Path) -> None:
    with open_link(str(tlog)) as link:
        link.send(CommandLong(7, 1, MavCmd.COMPONENT_ARM_DISARM))
        assert Counter(type(i.message) for i in link)[CommandAck] == 1, "the recorded one"


@pytest.mark.parametrize(
    ("command", "result"),
    [
        (CommandLong(1, 1, MavCmd.COMPONENT_ARM_DISARM, 0, 1.0), MavResult.FAILED),
        (CommandLong(1, 1, MavCmd.CONDITION_YAW, 0, 90.0), MavResult.UNSUPPORTED),
        (CommandLong(1, 1, MavCmd.SET_MESSAGE_INTERVAL, 0, 27.0, 1e6 / 5), MavResult.ACCEPTED),
        (CommandLong(1, 1, MavCmd.SET_MESSAGE_INTERVAL, 0, 27.0, 1e6 / 10), MavResult.ACCEPTED),
        (CommandLong(1, 1, MavCmd.SET_MESSAGE_INTERVAL, 0, 27.0, 1e6 / 50), MavResult.DENIED),
        (CommandLong(1, 1, MavCmd.SET_MESSAGE_INTERVAL, 0, 30.0, 1e6 / 5), MavResult.DENIED),
        (CommandLong(1, 1, MavCmd.SET_MESSAGE_INTERVAL, 0, float("nan"), 1.0), MavResult.DENIED),
    ],
)
def test_commands_are_answered_as_the_recording_has_it(tlog: Path, command: CommandLong, result: int) -> None:
    with open_link(str(tlog)) as link:
        while link.now() < 0.2:  # past the recorded answer
            link.receive(0.05)
        assert ask(link, command, CommandAck) == CommandAck(command.command, result)


def test_rates_can_be_asked_for(tlog: Path) -> None:
    with open_link(str(tlog)) as link:
        of, how = float(message_id(RawImu)), float(message_id(MessageInterval))
        for question in (
            CommandLong(1, 1, MavCmd.GET_MESSAGE_INTERVAL, 0, of),
            CommandLong(1, 1, MavCmd.REQUEST_MESSAGE, 0, how, of),
        ):
            answer = ask(link, question, MessageInterval)
            assert isinstance(answer, MessageInterval) and answer.message_id == of
            assert answer.interval_us == pytest.approx(100_000, rel=0.05)


@pytest.mark.parametrize(
    ("number", "told"),
    [
        (0, MessageInterval(0, 750_000)),  # the heartbeat's number
        (27, MessageInterval(27, 100_000)),
        (65_535, MessageInterval(65_535, 0)),
        (65_536, None),  # for which that message has no room
        (-1, None),
        (math.nan, None),
    ],
)
def test_the_rate_of_any_message_is_told_that_can_be_named(
    tlog: Path, number: float, told: MessageInterval | None
) -> None:
    with open_link(str(tlog)) as link:
        link.send(CommandLong(1, 1, MavCmd.GET_MESSAGE_INTERVAL, 0, number))
        heard = [i.message for i in all_of(link)]
    assert [m for m in heard if isinstance(m, MessageInterval)] == ([] if told is None else [told])
    result = MavResult.UNSUPPORTED if told is None else MavResult.ACCEPTED
    assert CommandAck(MavCmd.GET_MESSAGE_INTERVAL, result) in heard


def test_a_message_can_be_asked_for_again(tlog: Path) -> None:
    with open_link(str(tlog)) as link:
        while link.now() < 1.05:
            link.receive(0.05)
        question = CommandLong(1, 1, MavCmd.REQUEST_MESSAGE, 0, float(message_id(ParamValue)))
        assert ask(link, question, ParamValue) == ParamValue("COMPASS_OFS_Y", 13.0, 9, 2, 65_535)


def test_pauses_and_jumps_of_the_clock_are_not_waited_for(tmp_path: Path) -> None:
    stamps = [0.0, 1.0, 50_000.0, 50_001.0, 40_000.0, 40_001.0]
    path = write_tlog(tmp_path / "a.tlog", ((t, 1, 1, VEHICLE) for t in stamps))
    with open_link(str(path)) as link:
        times = [i.time_s for i in link]
    pause = LONGEST_PAUSE_S
    assert times == pytest.approx([0.0, 1.0, 1 + pause, 2 + pause, 2 + pause, 3 + pause], abs=0.01)


def test_damage_costs_only_what_it_hits(tlog: Path) -> None:
    data = bytearray(tlog.read_bytes())
    half = len(data) // 2
    data[half : half + 5] = b"\xfd\xfe\x00\xfd\xff"
    tlog.write_bytes(bytes(data) + data[:37])
    with open_link(str(tlog)) as link:
        images = [i for i in link if isinstance(i.message, RawImu)]
    assert 28 <= len(images) < 30


def test_a_frame_inside_a_message_is_no_message_wherever_the_file_is_cut_into_pieces(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    from pymavlink.dialects.v20 import ardupilotmega as theirs

    inner = bytes(8) + FrameWriter(1).write(VEHICLE, 1, 1)
    packer = theirs.MAVLink(None, 1, 1)
    outer = theirs.MAVLink_data64_message(0, 64, inner.rjust(64, b"\1")).pack(packer)
    path = tmp_path / "a.tlog"
    path.write_bytes(b"".join((1_700_000_000_000_000 + n).to_bytes(8, "big") + outer for n in range(200)))
    monkeypatch.setattr(tlog_room, "_PIECE", 1)  # as short as they can be
    assert [frame.raw for _, frame in tlog_room.tlog_frames(path)] == [outer] * 200


@pytest.mark.parametrize(
    ("content", "error"),
    [(b"", BadRecording), (b"not a log at all" * 100, BadRecording), (None, UsageError)],
)
def test_a_useless_file_is_told(tmp_path: Path, content: bytes | None, error: type[Exception]) -> None:
    path = tmp_path / "a.tlog"
    if content is not None:
        path.write_bytes(content)
    with pytest.raises(error):
        open_link(str(path))


def test_several_vehicles_are_told_apart(tmp_path: Path) -> None:
    said: list[Line] = [(0.0, 3, 1, VEHICLE), (0.0, 4, 1, VEHICLE)]
    said += [(0.1, system, 1, ParamValue("A", float(system))) for system in (3, 4)]
    said += [(0.2, 4, 1, RawImu(xmag=1))]
    path = write_tlog(tmp_path / "a.tlog", said)
    with open_link(str(path)) as link:
        link.send(ParamRequestRead(4, 1, "A"))
        link.send(ParamRequestRead(3, 1, "A"))
        answers = [(i.system, i.message.param_value) for i in link if isinstance(i.message, ParamValue)]
    assert answers == [(4, 4.0), (3, 3.0), (4, 4.0)], "the one recorded most answers, the other is heard"


# --- faults --------------------------------------------------------------------------------------


def test_the_link_can_be_made_lossy(tlog: Path) -> None:
    def play(seed: int) -> list[int]:
        bad = Faults(loss=0.3, duplicate=0.1, reorder=0.3, latency_s=0.2)
        with ReplayedLink(FaultyRecording(replayed_autopilot(tlog), bad, seed), "bad") as link:
            return [i.message.xmag for i in link if isinstance(i.message, RawImu)]

    once = play(1)
    assert once == play(1) != play(2)
    assert len(set(once)) < 30 and len(once) > len(set(once)) and once != sorted(once)


def test_the_vehicles_clock_can_jump(tlog: Path) -> None:
    recorded = replayed_autopilot(tlog, alterations=Alterations(time_jumps=((1.05, -5.0),)))
    with ReplayedLink(recorded, "jump") as link:
        times = [i.message.time_usec for i in link if isinstance(i.message, RawImu)]
    assert np.diff(times).min() == -4_900_000 and (np.diff(times) < 0).sum() == 1


@pytest.mark.parametrize(
    ("by_s", "recorded", "altered"),
    [
        (1.5, RawImu(time_usec=7), RawImu(time_usec=1_500_007)),
        (1.5, Attitude(time_boot_ms=7), Attitude(time_boot_ms=1507)),
        (-1.5, Attitude(time_boot_ms=1507), Attitude(time_boot_ms=7)),
        (-1.5, Attitude(time_boot_ms=1000), Attitude(time_boot_ms=0)),  # no clock shows less
        (1.0, Attitude(time_boot_ms=2**32 - 1), Attitude(time_boot_ms=999)),  # all the same is to be sent
        (1.0, RawImu(time_usec=2**64 - 1), RawImu(time_usec=999_999)),
        (1.5, VEHICLE, VEHICLE),
        (0.0, Attitude(time_boot_ms=7), Attitude(time_boot_ms=7)),
    ],
)
def test_a_clock_that_jumps_begins_anew_beyond_what_it_has_room_for(
    by_s: float, recorded: Message, altered: Message
) -> None:
    alter = Alterations(time_jumps=((3.0, by_s),)).begin()
    assert alter(SaidMessage(2.9, 1, 1, recorded)).message == recorded
    assert alter(SaidMessage(3.1, 1, 1, recorded)).message == altered


def test_the_compass_can_saturate_and_freeze(tlog: Path) -> None:
    recorded = replayed_autopilot(tlog, alterations=Alterations(saturation_mgauss=210, frozen_from_s=2.05))
    with ReplayedLink(recorded, "freeze") as link:
        x = [i.message.xmag for i in link if isinstance(i.message, RawImu)]
    assert x == [min(200 + i, 210) for i in range(30)]
    recorded = replayed_autopilot(tlog, alterations=Alterations(frozen_from_s=2.05))
    with ReplayedLink(recorded, "freeze") as link:
        x = [i.message.xmag for i in link if isinstance(i.message, RawImu)]
    assert x == [min(200 + i, 219) for i in range(30)], "the last reading before it froze"


def test_faults_are_read_as_people_write_them() -> None:
    on_link, on_vehicle = parse_faults(("loss=0.3", "latency=0.1", "time-jump=3:-1", "saturation=400"))
    assert (on_link.loss, on_link.latency_s) == (0.3, 0.1)
    assert on_vehicle == Alterations(((3.0, -1.0),), 400.0)
    for wrong in ("loss", "loss=2", "los=0.1", "time-jump=3"):
        with pytest.raises(UsageError):
            parse_faults((wrong,))


# --- recordings that are not MAVLink -------------------------------------------------------------


def track_of(autopilot: str, **columns: object) -> Track:
    time_s = np.arange(0.0, 4.0, 0.02) + 30.0
    yaw = np.linspace(0.0, 2.0, len(time_s))
    raw = np.stack([200 * np.cos(yaw) + 30.7, -200 * np.sin(yaw), np.full_like(yaw, 400.0)], axis=-1)
    first = FieldCorrection(offsets_mgauss=(-30.0, 0.0, 0.0))
    second = FieldCorrection(offsets_mgauss=(-31.0, 2.0, 0.0))
    reported = np.where(time_s[:, None] < 32.0, first.apply(raw), second.apply(raw))
    compass = MagSeries(1, Series.of(time_s, reported), (InForce(-np.inf, first), InForce(32.0, second)))
    still = np.zeros_like(raw)
    gravity = Series.of(time_s, still + np.array([0.0, 0.0, -9.80665]))
    other = MagSeries(2, Series.of(time_s, raw))
    everything: dict[str, object] = {
        "compasses": {1: compass, 2: other},
        "acc_mps2": gravity,
        "gyro_radps": Series.of(time_s, still + np.array([0.0, 0.0, 0.5])),
        "attitude_rad": Series.of(time_s, np.stack([0 * yaw, 0 * yaw, yaw], axis=-1)),
        "place": Series.of(time_s[::10], np.tile([47.0, 8.5, 400.0], (20, 1))),
        "current_a": Series.of(time_s, np.full(len(time_s), 12.5)),
        "motors": Series.of(time_s, np.tile([0.25, 0.5], (len(time_s), 1))),
        "vehicle": "copter",
    }
    return Track(autopilot=autopilot, **(everything | columns))  # type: ignore[arg-type]


def played(track: Track) -> ReplayedLink:
    """Play a Track."""
    return ReplayedLink(ReplayedAutopilot(track_messages(track), track_contents(track)), "a track")


@pytest.fixture
def play_track() -> Callable[[Track], list[Incoming]]:
    def play(track: Track) -> list[Incoming]:
        with played(track) as link:
            return all_of(link)

    return play


def kind_of(heard: list[Incoming], kind: type[Message]) -> list[Message]:
    return [i.message for i in heard if type(i.message) is kind]


def test_a_track_is_played_as_its_vehicle_would_speak(play_track: Callable[[Track], list[Incoming]]) -> None:
    track = track_of("ardupilot")
    heard = play_track(track)
    images = kind_of(heard, RawImu)
    assert len(images) == 200
    expected = np.trunc(track.compasses[1].reported.values).astype(int)
    assert [(m.xmag, m.ymag, m.zmag) for m in images] == [tuple(row) for row in expected.tolist()]
    assert {(m.zacc, m.zgyro) for m in images} == {(-1000, 500)}
    assert [m.time_usec for m in images] == [30_000_000 + 20_000 * i for i in range(200)]
    assert len(kind_of(heard, ScaledImu2)) == 200
    assert {(i.system, i.component) for i in heard} == {(1, 1)}
    assert kind_of(heard, Heartbeat) == [Heartbeat(MavType.QUADROTOR, 3, 1, 0, 3)] * 5  # one a second
    assert kind_of(heard, ServoOutputRaw)[0].time_usec == 30_000_000
    assert {m.current_battery for m in kind_of(heard, SysStatus)} == {1250}
    assert {(m.servo1_raw, m.servo2_raw) for m in kind_of(heard, ServoOutputRaw)} == {(1250, 1500)}
    assert kind_of(heard, GlobalPositionInt)[0].lat == 470_000_000
    assert kind_of(heard, GpsRawInt)[0].yaw == 0
    assert kind_of(heard, Attitude)[-1].yaw == pytest.approx(2.0, abs=0.05)
    assert [i.time_s for i in heard] == sorted(i.time_s for i in heard)


def test_place_velocity_course_and_time_are_told_in_the_units_of_their_messages(
    play_track: Callable[[Track], list[Incoming]],
) -> None:
    time_s = 30.0 + np.arange(11) / 5.0
    heard = play_track(
        track_of(
            "ardupilot",
            place=Series.of(time_s, np.linspace((47.0, -8.5, 400.0), (47.001, -8.501, 402.0), 11)),
            gps_velocity_mps=Series.of(time_s, np.tile([3.0, -4.0, 0.5], (11, 1))),
            gps_yaw_rad=Series.of(time_s, np.linspace(-0.5, 0.5, 11) % (2.0 * np.pi)),
            throttle=Series.of(time_s, np.full(11, 0.4)),
            truth_q=Series.of(time_s, np.tile([np.cos(0.3), 0.0, 0.0, np.sin(0.3)], (11, 1))),
            utc_offset_s=1.7e9,
        )
    )
    here = GlobalPositionInt(32_000, 470_010_000, -85_010_000, 402_000, 2_000, 300, -400, 50)
    assert kind_of(heard, GlobalPositionInt)[-1] == here
    gps = kind_of(heard, GpsRawInt)
    last = (gps[-1].time_usec, gps[-1].fix_type, gps[-1].lat, gps[-1].lon, gps[-1].alt)
    assert last == (32_000_000, 3, 470_010_000, -85_010_000, 402_000)
    assert {(m.vel, m.cog) for m in gps} == {(500, 30_687)}
    assert [m.yaw for m in gps][4:7] == [35_427, 36_000, 573]  # 0 would be none
    assert kind_of(heard, VfrHud)[0].throttle == 40 and kind_of(heard, Simstate)[0].yaw == pytest.approx(0.6)
    assert kind_of(heard, SystemTime)[1] == SystemTime(1_700_000_031_000_000, 31_000)


@pytest.mark.parametrize(("recorded_hz", "played_hz"), [(50.0, 25.0), (25.0, 25.0), (10.0, 10.0), (4.0, 4.0)])
def test_an_attitude_is_played_as_often_as_it_was_recorded_and_no_faster_than_telemetry_has_it(
    play_track: Callable[[Track], list[Incoming]], recorded_hz: float, played_hz: float
) -> None:
    time_s = 30.0 + np.arange(round(4.0 * recorded_hz)) / recorded_hz
    level = Series.of(time_s, np.zeros((len(time_s), 3)))
    heard = kind_of(play_track(track_of("ardupilot", attitude_rad=level)), Attitude)
    assert len(heard) == pytest.approx(4.0 * played_hz, abs=1)


def test_the_rates_of_a_track_can_be_asked_for() -> None:
    with played(track_of("ardupilot")) as link:
        for kind, interval_us in (
            (RawImu, 20_000),
            (Attitude, 40_000),
            (GlobalPositionInt, 200_000),
            (ServoOutputRaw, 200_000),
        ):
            question = CommandLong(1, 1, MavCmd.GET_MESSAGE_INTERVAL, 0, float(message_id(kind)))
            answer = ask(link, question, MessageInterval)
            assert isinstance(answer, MessageInterval) and answer.message_id == message_id(kind)
            assert answer.interval_us == pytest.approx(interval_us, rel=0.05)


def test_a_correction_that_changed_on_the_way_is_told(play_track: Callable[[Track], list[Incoming]]) -> None:
    told = [i for i in play_track(track_of("ardupilot")) if isinstance(i.message, ParamValue)]
    assert [(round(i.time_s, 2), i.message.param_id, i.message.param_value) for i in told] == [
        (2.0, "COMPASS_OFS_X", -31.0),
        (2.0, "COMPASS_OFS_Y", 2.0),
    ]


def test_the_parameters_let_a_client_undo_what_was_in_force() -> None:
    with played(track_of("unknown")) as link:
        answer = ask(link, ParamRequestRead(1, 1, "COMPASS_OFS_X"), ParamValue)
        assert isinstance(answer, ParamValue) and answer.param_value == -30.0


def test_px4_tells_the_raw_field_in_the_sensors_axes_and_the_corrected_one_in_gauss() -> None:
    parameters = {"CAL_MAG0_XOFF": 0.05, "CAL_MAG0_ROT": 4.0, "CAL_MAG0_XSCALE": 1.0}  # turned by 180 deg yaw
    time_s = np.arange(0.0, 1.0, 0.1)
    raw_body = np.tile([100.0, 50.0, 400.0], (10, 1))
    track = track_of(
        "px4", parameters=parameters, compasses={1: MagSeries(1, Series.of(time_s, raw_body))}, place=None
    )
    with played(track) as link:
        rotation = ask(link, ParamRequestRead(1, 1, "CAL_MAG0_ROT"), ParamValue)
        assert isinstance(rotation, ParamValue) and rotation.param_type == MavParamType.INT32
        assert np.float32(rotation.param_value).view(np.int32) == 4
        heard = all_of(link)
    raw, corrected = kind_of(heard, ScaledImu)[0], kind_of(heard, HighresImu)[0]
    assert (raw.xmag, raw.ymag, raw.zmag) == (-100, -50, 400)
    assert (corrected.xmag, corrected.ymag) == pytest.approx((0.15, 0.05)), "the offset is the sensor's"


# --- on a socket ---------------------------------------------------------------------------------


def test_a_replay_on_a_socket_keeps_even_messages_that_we_do_not_use(tmp_path: Path) -> None:
    from pymavlink.dialects.v20 import ardupilotmega as theirs

    path = write_tlog(tmp_path / "a.tlog", lines())
    radio = theirs.MAVLink_radio_status_message(99, 2, 3, 4, 5, 6, 7).pack(theirs.MAVLink(None, 1, 1))
    path.write_bytes(path.read_bytes() + (1_700_000_003_500_000).to_bytes(8, "big") + radio)
    with serving(replayed_autopilot(path), speed=20.0) as (_, port):
        with open_link(Tcp("127.0.0.1", port)) as link:
            while not link.statistics.unknown:
                assert link.receive(2.0) is not None or link.statistics.unknown
            assert link.statistics.lost == 0


def test_the_command_plays_to_the_end(
    tlog: Path, tmp_path: Path, start_process: Callable[..., subprocess.Popen[str]]
) -> None:
    result = tmp_path / "r.json"
    words = [sys.executable, "-m", "mavcompass", "replay", str(tlog), "--listen", "tcp:127.0.0.1:0"]
    words += ["--speed", "10", "--fault", "latency=0.05", "--json", str(result)]
    process = start_process(*words)
    assert process.stdout is not None
    port = int(process.stdout.readline().split(";")[0].rpartition(":")[2])
    with open_link(Tcp("127.0.0.1", port)) as link:
        assert hear(link, RawImu)
        assert process.wait() == 0
    assert json.loads(result.read_text())["to_the_end"] is True


def test_the_recorded_rover_comes_through_whole(shared_data: Path) -> None:
    from pymavlink import mavutil

    path = shared_data / "ardupilot-4.6.3" / "rover_dist.tlog"
    theirs = mavutil.mavlink_connection(str(path))
    expected = []
    while (m := theirs.recv_match(type="RAW_IMU")) is not None:
        expected.append((m.time_usec, m.xmag, m.ymag, m.zmag, m.zgyro))
    theirs.close()
    with open_link(str(path)) as link:
        images = kind_of(all_of(link), RawImu)
    assert [(m.time_usec, m.xmag, m.ymag, m.zmag, m.zgyro) for m in images] == expected
