"""Frames: both versions, junk between them, signatures; pymavlink is the other implementation."""

from __future__ import annotations

import random
from dataclasses import dataclass

import pytest
from hypothesis import given
from hypothesis import strategies as st
from pymavlink.dialects.v20 import ardupilotmega as theirs

from mavcompass.messages import Attitude, CommandAck, Heartbeat, NamedValueFloat, RawImu
from mavcompass.vehicle.wire import Frame, FrameParser, FrameWriter, Signing, decode

SAMPLE = RawImu(time_usec=123_456_789, xacc=-3, zacc=-1000, xmag=232, ymag=52, zmag=-528, temperature=4100)


@dataclass
class Counts:
    malformed: int = 0
    unknown: int = 0
    signed: int = 0
    refused: int = 0


def pymavlink(system: int = 1, component: int = 1) -> theirs.MAVLink:
    return theirs.MAVLink(None, system, component)


def test_pymavlink_reads_what_we_write_in_both_versions() -> None:
    for version in (1, 2):
        writer = FrameWriter(version)
        for sequence in range(3):
            (read,) = pymavlink().parse_buffer(writer.write(SAMPLE, 7, 191)) or []
            assert read.get_type() == "RAW_IMU" and (read.xmag, read.zmag) == (232, -528)
            assert (read.get_srcSystem(), read.get_srcComponent(), read.get_seq()) == (7, 191, sequence)
            assert read.temperature == (4100 if version == 2 else 0), "version 1 knows no extension fields"


def test_version_1_frames_have_the_length_of_version_1() -> None:
    assert len(FrameWriter(1).write(SAMPLE, 1, 1)) == 8 + 26
    assert len(FrameWriter(1).write(CommandAck(command=400), 1, 1)) == 8 + 3


@pytest.mark.parametrize("version_1", [False, True])
def test_we_read_what_pymavlink_writes(version_1: bool) -> None:
    other = pymavlink(3, 9)
    raw = theirs.MAVLink_attitude_message(5, 0.5, 0.25, 1.5, 0.0, 0.0, 0.0).pack(other, version_1)
    (frame,) = FrameParser(Counts()).feed(raw)
    assert (frame.version, frame.system, frame.component) == (1 if version_1 else 2, 3, 9)
    assert decode(frame.message_id, frame.payload) == Attitude(5, 0.5, 0.25, 1.5)
    assert frame.raw == raw


@pytest.mark.parametrize("version", [1, 2])
@pytest.mark.parametrize("number", [254, 256])  # there is no message 255
def test_a_number_beyond_255_has_no_room_in_version_1(version: int, number: int) -> None:
    frame = Frame(version, 0, 1, 1, number, b"\1", b"")
    if version == 2 or number < 256:
        (read,) = FrameParser(Counts()).feed(FrameWriter().forward(frame))
        assert (read.version, read.message_id) == (version, number)
    else:
        with pytest.raises(ValueError, match="message 256 cannot be sent in MAVLink 1"):
            FrameWriter().forward(frame)


def test_a_message_that_nobody_knows_is_not_sent_on() -> None:
    with pytest.raises(ValueError, match="message 60123 is not in the dialect"):
        FrameWriter().forward(Frame(2, 0, 1, 1, 60_123, b"\1", b""))


def test_sequence_numbers_wrap() -> None:
    writer, parser = FrameWriter(), FrameParser(Counts())
    frames = [f for _ in range(300) for f in parser.feed(writer.write(Heartbeat(), 1, 1))]
    assert [f.sequence for f in frames] == [i % 256 for i in range(300)]


def test_an_empty_message_still_has_one_byte() -> None:
    raw = FrameWriter().write(RawImu(), 1, 1)
    assert raw[1] == 1
    (frame,) = FrameParser(Counts()).feed(raw)
    assert decode(frame.message_id, frame.payload) == RawImu()


@given(st.data())
def test_frames_are_found_however_the_bytes_are_cut(data: st.DataObject) -> None:
    writers = {1: FrameWriter(1), 2: FrameWriter(2)}
    versions = data.draw(st.lists(st.sampled_from([1, 2]), min_size=1, max_size=12))
    stream = b"".join(writers[v].write(NamedValueFloat(i, "a", i), 1, 1) for i, v in enumerate(versions))
    cuts = sorted(data.draw(st.lists(st.integers(0, len(stream)), max_size=8)))
    counts = Counts()
    parser = FrameParser(counts)
    frames = [
        frame
        for start, end in zip([0, *cuts], [*cuts, len(stream)], strict=True)
        for frame in parser.feed(stream[start:end])
    ]
    assert [f.version for f in frames] == versions
    assert counts == Counts()


@given(st.binary(max_size=400))
def test_random_bytes_never_raise(junk: bytes) -> None:
    parser = FrameParser(Counts())
    parser.feed(junk)
    flush = bytes(300)
    good = FrameWriter().write(SAMPLE, 1, 1)
    assert parser.feed(flush + good)[-1].raw == good


def test_junk_between_frames_costs_only_itself() -> None:
    rng = random.Random(5)
    writer, counts = FrameWriter(), Counts()
    parser = FrameParser(counts)
    heard = 0
    for _ in range(50):
        junk = bytes([0x41, *(rng.choice([0x00, 0x41, 0xFE, 0xFD]) for _ in range(rng.randrange(30)))])
        heard += len(parser.feed(junk + writer.write(SAMPLE, 1, 1)))
    heard += len(parser.feed(bytes(600)))
    assert heard == 50
    assert counts.malformed == 51


def test_a_flipped_bit_is_noticed_wherever_it_is() -> None:
    good = FrameWriter().write(SAMPLE, 1, 1)
    for bit in range(len(good) * 8):
        bad = bytearray(good)
        bad[bit // 8] ^= 1 << bit % 8
        counts = Counts()
        assert FrameParser(counts).feed(bytes(bad) + good + bytes(600)) == FrameParser(Counts()).feed(good)
        assert counts.malformed >= 1


def test_messages_of_another_dialect_are_skipped_as_a_whole() -> None:
    foreign = bytearray(FrameWriter().write(SAMPLE, 1, 1))
    foreign[7:10] = (60_123).to_bytes(3, "little")
    good = FrameWriter().write(SAMPLE, 1, 1)
    counts = Counts()
    assert [f.raw for f in FrameParser(counts).feed(bytes(foreign) + good)] == [good]
    assert counts == Counts(malformed=0, unknown=1)


FOREIGN = (
    b"\xfd\x03\0\0\0\1\1\xff\xff\xff\xfd\x09\0__"  # of another dialect; what might begin inside is cut off
)


@pytest.mark.parametrize("start", [b"\xfd", b"\xfd\xfd", b"\xfe", FOREIGN])
def test_frames_behind_what_might_begin_one_are_found_wherever_the_stream_is_cut(start: bytes) -> None:
    writer = FrameWriter()
    stream = start + b"".join(writer.write(SAMPLE, 1, 1) for _ in range(12))
    for cut in range(len(stream)):
        parser = FrameParser(Counts())
        frames = [f for part in (stream[:cut], stream[cut:], bytes(600)) for f in parser.feed(part)]
        assert [f.sequence for f in frames] == list(range(12)), cut


@pytest.mark.parametrize("lost_from", [1, 10])
def test_frames_that_follow_the_beginning_of_an_unknown_one_are_not_skipped_as_part_of_it(
    lost_from: int,
) -> None:
    """Of a frame of another dialect the rest is lost; where it says that it ends, a good one begins."""
    writer = FrameWriter()
    good = [writer.write(SAMPLE, 1, 1) for _ in range(12)]
    begun = bytes((0xFD, lost_from + 3 * len(good[0]) - 12, 0, 0, 0, 1, 1, 0xFF, 0xFF, 0xFF))[:lost_from]
    counts = Counts()
    assert [f.raw for f in FrameParser(counts).feed(begun + b"".join(good))] == good
    assert counts == Counts(malformed=1)


def test_frames_with_flags_that_must_be_understood_are_not_taken() -> None:
    raw = bytearray(FrameWriter().write(SAMPLE, 1, 1))
    raw[2] = 0x02
    counts = Counts()
    assert FrameParser(counts).feed(bytes(raw) + bytes(300)) == []
    assert counts.malformed == 1


KEY = bytes(range(32))


def test_pymavlink_accepts_our_signature() -> None:
    receiver = pymavlink()
    receiver.signing.secret_key = KEY
    receiver.signing.sign_outgoing = True
    read = receiver.parse_buffer(FrameWriter(signing=Signing(KEY, link_id=3)).write(SAMPLE, 1, 191))
    assert read is not None and read[0].get_signed() and read[0].xmag == 232


def test_we_accept_pymavlinks_signature_once() -> None:
    sender = pymavlink(4, 1)
    sender.signing.secret_key = KEY
    sender.signing.sign_outgoing = True
    sender.signing.timestamp = 10**13
    raw = theirs.MAVLink_heartbeat_message(2, 3, 0, 0, 0, 3).pack(sender)
    counts = Counts()
    parser = FrameParser(counts, Signing(KEY, clock=lambda: 1_420_070_400 + 1e8))
    assert [f.system for f in parser.feed(raw)] == [4]
    assert parser.feed(raw + bytes(300)) == [], "a replayed frame is an attack"
    assert counts.malformed == 1


def test_with_a_key_unsigned_and_wrongly_signed_frames_are_refused() -> None:
    counts = Counts()
    parser = FrameParser(counts, Signing(KEY))
    unsigned = FrameWriter().write(SAMPLE, 1, 1)
    wrong = FrameWriter(signing=Signing.from_passphrase("not it")).write(SAMPLE, 1, 1)
    assert parser.feed(unsigned + wrong + bytes(300)) == []
    right = FrameWriter(signing=Signing(KEY)).write(SAMPLE, 1, 1)
    assert [f.raw for f in parser.feed(right)] == [right]
    assert (counts.refused, counts.signed) == (2, 0)
    # A radio says how it is doing for itself, and has no key.
    radio = theirs.MAVLink_radio_status_message(99, 2, 3, 4, 5, 6, 7).pack(pymavlink(51, 68))
    assert [f.raw for f in parser.feed(radio)] == [radio] and counts.refused == 2


def test_without_a_key_signed_frames_are_read_like_any_other() -> None:
    raw = FrameWriter(signing=Signing(KEY)).write(SAMPLE, 1, 1)
    counts = Counts()
    frame, _ = FrameParser(counts).feed(raw + FrameWriter().write(SAMPLE, 1, 1))
    assert decode(frame.message_id, frame.payload) == SAMPLE
    assert counts == Counts(signed=1)


def test_a_key_of_the_wrong_length_is_refused() -> None:
    with pytest.raises(ValueError, match="32 bytes"):
        Signing(b"short")
