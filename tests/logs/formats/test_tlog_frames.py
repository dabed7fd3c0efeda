"""Framing of telemetry logs: every good frame is found, whatever stands around it."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from fastcrc.crc16 import mcrf4xx
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from pymavlink import mavutil
from recorded_frames import Recording, attitude, frame, heartbeat, parameter, raw_imu, sys_status

from mavcompass.logs.formats.tlog.frames import checksums
from mavcompass.logs.formats.tlog.messages import ALL_FIELDS, TlogContents, read_messages, record_type
from mavcompass.messages.dialect import describe, message_ids

# With how many bytes of each hold every kind of message of them all.
TLOGS = (
    ("ardupilot-4.6.3/copter_dist_use2.tlog", 400_000),
    ("ardupilot-4.6.3/rover_plain.tlog", 400_000),
    ("real/bluerov2-tlog/small.tlog", 2_000_000),
    ("real/quad-flight-tlog/flight.tlog", 1_000_000),
)
EVERYTHING = {
    "ATTITUDE": ALL_FIELDS,
    "RAW_IMU": ALL_FIELDS,
    "HEARTBEAT": ALL_FIELDS,
    "PARAM_VALUE": ALL_FIELDS,
}


def read(path: Path, content: bytes, chunk_bytes: int = 1 << 20) -> TlogContents:
    path.write_bytes(content)
    return read_messages(path, EVERYTHING, chunk_bytes)


def stamped(frames: list[bytes]) -> bytes:
    return b"".join((1_700_000_000_000_000 + n).to_bytes(8, "big") + one for n, one in enumerate(frames))


@settings(deadline=None)
@given(
    st.lists(st.tuples(st.binary(min_size=6, max_size=269), st.integers(0, 255)), min_size=1, max_size=9),
    st.sampled_from([1, 500]),
)
def test_checksums_of_many_frames_are_those_of_each(frames: list[tuple[bytes, int]], copies: int) -> None:
    data = np.frombuffer(b"".join(content for content, _ in frames) + b"\0", dtype=np.uint8)
    lengths = np.repeat([len(content) for content, _ in frames], copies)
    ends = np.repeat(np.cumsum([len(content) for content, _ in frames]), copies)
    extras = np.repeat(np.array([extra for _, extra in frames], dtype=np.uint8), copies)
    expected = [mcrf4xx(content + bytes((extra,))) for content, extra in frames]
    np.testing.assert_array_equal(checksums(data, ends, lengths, extras), np.repeat(expected, copies))


def test_layouts_are_as_long_as_the_dialect_says() -> None:
    for number in message_ids().values():
        message = describe(number)
        assert message is not None
        assert record_type(message).itemsize == message.payload.size


@pytest.mark.parametrize(("name", "size"), TLOGS)
def test_every_value_equals_pymavlinks(shared_data: Path, tmp_path: Path, name: str, size: int) -> None:
    path = tmp_path / "a.tlog"
    path.write_bytes((shared_data / name).read_bytes()[:size])
    theirs: dict[tuple[int, int, str], list[Any]] = {}
    log = mavutil.mavlink_connection(str(path))
    while (message := log.recv_match()) is not None:
        kind = message.get_type()
        if kind != "BAD_DATA" and not kind.startswith("UNKNOWN"):
            key = (message.get_srcSystem(), message.get_srcComponent(), kind)
            theirs.setdefault(key, []).append(message)
    log.close()
    contents = read_messages(path, {kind: ALL_FIELDS for _, _, kind in theirs})
    ours = {(*sender, kind): m for sender, by in contents.senders.items() for kind, m in by.items()}
    assert ours.keys() == theirs.keys()
    assert contents.frames == sum(len(messages) for messages in theirs.values())
    for key, messages in theirs.items():
        stamps = [message._timestamp for message in messages]
        np.testing.assert_allclose(ours[key].log_time_s, stamps, rtol=0.0, atol=1e-5, strict=True)
        for field in messages[0].get_fieldnames():
            expected = [getattr(message, field) for message in messages]
            found = ours[key].rows[field]
            if isinstance(expected[0], str):
                assert [text.decode("utf-8", "replace") for text in found.tolist()] == expected, (key, field)
            else:
                np.testing.assert_array_equal(found, np.asarray(expected), err_msg=f"{key} {field}")


def test_versions_1_and_2_and_signed_frames_are_read_from_one_file(tmp_path: Path) -> None:
    frames = [
        frame(attitude(1.0, yaw=0.5), version=1),
        frame(attitude(1.1, yaw=0.5)),
        frame(attitude(1.2, yaw=0.5), key=bytes(range(32))),
        frame(attitude(1.3, yaw=0.0)),  # version 2 cuts the zeros off its end
    ]
    contents = read(tmp_path / "a.tlog", stamped(frames))
    rows = contents.senders[1, 1]["ATTITUDE"].rows
    assert rows.time_boot_ms.tolist() == [1000, 1100, 1200, 1300]
    assert rows.yaw.tolist() == [0.5, 0.5, 0.5, 0.0]
    assert contents.skipped_bytes == 0


def test_payload_that_looks_like_the_start_of_a_frame_is_not_taken_for_one(tmp_path: Path) -> None:
    clean = frame(attitude(1.0))
    payload_like = frame(raw_imu(1.0, (0xFDFE - 65536, 0xFEFD - 65536, 0xFDFD - 65536)))
    contents = read(tmp_path / "a.tlog", stamped([clean, payload_like, clean]))
    assert contents.frames == 3
    assert contents.skipped_bytes == 0


def test_a_whole_frame_inside_another_frames_payload_belongs_to_the_outer_one(tmp_path: Path) -> None:
    from pymavlink.dialects.v20 import ardupilotmega as dialect

    inner = (b"\0" * 8 + frame(heartbeat("rover"), version=1)).ljust(60, b"\1")
    outer = dialect.MAVLink_data64_message(0, 60, inner.ljust(64, b"\1"))
    contents = read(tmp_path / "a.tlog", stamped([frame(attitude(1.0)), frame(outer), frame(attitude(2.0))]))
    assert contents.frames == 3
    assert "HEARTBEAT" not in contents.senders[1, 1]


def test_a_damaged_frame_costs_itself_and_no_other(tmp_path: Path) -> None:
    frames = [frame(attitude(n * 0.1, yaw=0.1)) for n in range(20)]
    content = bytearray(stamped(frames))
    record = 8 + len(frames[0])
    content[7 * record + 20] ^= 0x10
    contents = read(tmp_path / "a.tlog", bytes(content))
    times = contents.senders[1, 1]["ATTITUDE"].rows.time_boot_ms.tolist()
    assert times == [n * 100 for n in range(20) if n != 7]
    assert (contents.skipped_bytes, contents.skipped_stretches) == (record, 1)


def test_a_file_cut_in_a_record_keeps_all_records_before(tmp_path: Path) -> None:
    content = stamped([frame(attitude(n * 0.1)) for n in range(5)])
    contents = read(tmp_path / "a.tlog", content[:-9])
    assert contents.frames == 4
    assert contents.cut_off


def test_messages_outside_the_dialect_are_told_from_damage(tmp_path: Path) -> None:
    body = bytes((3, 0, 0, 9, 1, 1, 0x39, 0x30, 0)) + b"abc"  # id 12345
    unknown = b"\xfd" + body + mcrf4xx(body + b"\7").to_bytes(2, "little")
    contents = read(
        tmp_path / "a.tlog", stamped([frame(attitude(1.0)), unknown, unknown, frame(attitude(2.0)), unknown])
    )
    assert describe(12345) is None
    assert contents.frames == 2
    assert contents.unknown_frames == 3
    assert contents.skipped_bytes == 0


def test_senders_are_told_apart(tmp_path: Path) -> None:
    recording = Recording().add(0, heartbeat("ground station"), system=255, component=190)
    recording.add(0, heartbeat("rover"), system=3).add(0, heartbeat("gimbal"), system=3, component=154)
    contents = read(tmp_path / "a.tlog", recording.content)
    assert list(contents.senders) == [(3, 1), (3, 154), (255, 190)]


@pytest.mark.parametrize("chunk_bytes", [1, 1500, 4000, 65536])
def test_the_size_of_the_chunks_changes_nothing(tmp_path: Path, chunk_bytes: int) -> None:
    content = bytearray(Recording().fly(30.0).fly(30.0, system=9, version=1).content)
    for place in range(500, len(content), 3001):
        content[place] ^= 0xFF
    whole = read(tmp_path / "a.tlog", bytes(content), 1 << 24)
    pieces = read(tmp_path / "a.tlog", bytes(content), chunk_bytes)
    assert whole.skipped_bytes > 0
    for count in ("frames", "unknown_frames", "skipped_bytes", "skipped_stretches", "cut_off"):
        assert getattr(pieces, count) == getattr(whole, count)
    for sender, by_name in whole.senders.items():
        for name, messages in by_name.items():
            np.testing.assert_array_equal(pieces.senders[sender][name].rows, messages.rows)
            np.testing.assert_array_equal(pieces.senders[sender][name].order, messages.order)


MESSAGES = st.one_of(
    st.builds(attitude, st.floats(0, 4e6), st.floats(-3, 3)),
    st.builds(raw_imu, st.floats(0, 1e9), st.tuples(*[st.integers(-32768, 32767)] * 3)),
    st.builds(parameter, st.text("ABC_", min_size=1, max_size=16), st.floats(-1e9, 1e9)),
    st.builds(sys_status, st.integers(-1, 30000)),
)
FRAMES = st.builds(
    frame,
    MESSAGES,
    st.integers(1, 255),
    st.integers(1, 255),
    st.sampled_from([1, 2]),
    st.sampled_from([None, b"k" * 32]),
)


@settings(suppress_health_check=[HealthCheck.function_scoped_fixture], deadline=None, max_examples=60)
@given(st.lists(st.tuples(st.binary(max_size=40), FRAMES), min_size=1, max_size=20))
def test_every_frame_is_found_between_any_garbage(tmp_path: Path, pieces: list[tuple[bytes, bytes]]) -> None:
    # Garbage that could itself swallow the next frame as a longer one is another test's business.
    clean = [garbage.replace(b"\xfd", b"\0").replace(b"\xfe", b"\0") for garbage, _ in pieces]
    content = b"".join(
        garbage + b"\0\6" + b"\1" * 6 + one for garbage, (_, one) in zip(clean, pieces, strict=True)
    )
    contents = read(tmp_path / "a.tlog", content)
    assert contents.frames == len(pieces)
    assert contents.skipped_bytes == sum(map(len, clean))


def test_asking_for_some_fields_gives_the_same_values(tmp_path: Path) -> None:
    path = Recording().fly(3.0).write(tmp_path / "a.tlog")
    all_ = read_messages(path, {"RAW_IMU": ALL_FIELDS}).senders[1, 1]["RAW_IMU"].rows
    some = read_messages(path, {"RAW_IMU": ("xmag", "time_usec")}).senders[1, 1]["RAW_IMU"].rows
    assert some.dtype.names == ("xmag", "time_usec")
    np.testing.assert_array_equal(some.xmag, all_.xmag)
    np.testing.assert_array_equal(some.time_usec, all_.time_usec)


def test_a_message_outside_the_dialect_cannot_be_asked_for(tmp_path: Path) -> None:
    with pytest.raises(KeyError):
        read_messages(tmp_path / "a.tlog", {"NO_SUCH_MESSAGE": ALL_FIELDS})
