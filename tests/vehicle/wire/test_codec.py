"""The dataclasses against the dialect they are held to, and against pymavlink's own packing."""

from __future__ import annotations

import inspect
import math
import struct
import xml.etree.ElementTree as ElementTree
from dataclasses import fields, replace
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st
from pymavlink.dialects.v20 import ardupilotmega

from mavcompass import messages
from mavcompass.messages import Message, ParamValue, RawImu, Statustext, message_id
from mavcompass.vehicle.wire.codec import decode, encode, wire_format

KINDS = [
    kind
    for _, kind in inspect.getmembers(messages, inspect.isclass)
    if issubclass(kind, Message) and kind is not Message
]
SIZES = {"char": 1, "uint8_t": 1, "int8_t": 1, "uint16_t": 2, "int16_t": 2, "uint32_t": 4, "int32_t": 4}
SIZES |= {"float": 4, "uint64_t": 8, "int64_t": 8, "double": 8, "uint8_t_mavlink_version": 1}


def dialect_xml() -> dict[str, ElementTree.Element]:
    folder = Path(ardupilotmega.__file__).parent
    found: dict[str, ElementTree.Element] = {}
    for name in ("minimal", "standard", "common", "ardupilotmega"):
        path = folder / f"{name}.xml"
        if path.is_file():
            found |= {m.attrib["name"]: m for m in ElementTree.parse(path).iter("message")}
    return found


XML = dialect_xml()


def declared(message: ElementTree.Element) -> tuple[list[tuple[str, str]], list[tuple[str, str]]]:
    """Split a message's (name, type) fields into the base and the extension ones."""
    base: list[tuple[str, str]] = []
    extension: list[tuple[str, str]] = []
    into = base
    for child in message:
        if child.tag == "extensions":
            into = extension
        elif child.tag == "field":
            into.append((child.attrib["name"], child.attrib["type"]))
    return base, extension


def size_of(kind: str) -> int:
    stem, _, count = kind.rstrip("]").partition("[")
    return SIZES[stem] * int(count or 1)


@pytest.mark.parametrize("kind", KINDS, ids=lambda kind: kind.__name__)
def test_every_message_has_the_dialects_fields(kind: type[Message]) -> None:
    base, extension = declared(XML[kind.wire_name()])
    ours = [field.name for field in fields(kind)]
    names = [name for name, _ in base + extension]
    assert ours[: len(base)] == names[: len(base)], "all base fields, in the dialect's order"
    assert [name for name in names if name in ours] == ours, "extension fields may be left out, not invented"
    assert message_id(kind) == getattr(ardupilotmega, f"MAVLINK_MSG_ID_{kind.wire_name()}")


@pytest.mark.parametrize("kind", KINDS, ids=lambda kind: kind.__name__)
def test_lengths_without_extensions_are_the_dialects(kind: type[Message]) -> None:
    base, _ = declared(XML[kind.wire_name()])
    form = wire_format(message_id(kind))
    assert form is not None
    assert form.base_length == sum(size_of(type_) for _, type_ in base)


def values_of(field_type: str) -> st.SearchStrategy[object]:
    stem, bracket, count = field_type.rstrip("]").partition("[")
    if stem == "char":
        return st.text(st.characters(min_codepoint=1, max_codepoint=127), max_size=int(count))
    if stem in ("float", "double"):
        one: st.SearchStrategy[object] = st.floats(width=32, allow_nan=False)
    else:
        bits = 8 * SIZES[stem]
        signed = not stem.startswith("u")
        low, high = (-(2 ** (bits - 1)), 2 ** (bits - 1) - 1) if signed else (0, 2**bits - 1)
        one = st.integers(low, high)
    return st.tuples(*[one] * int(count)) if bracket else one


@st.composite
def any_message(draw: st.DrawFn) -> Message:
    kind = draw(st.sampled_from(KINDS))
    base, extension = declared(XML[kind.wire_name()])
    types = dict(base + extension)
    return kind(**{field.name: draw(values_of(types[field.name])) for field in fields(kind)})


@given(any_message())
def test_a_message_survives_the_wire(message: Message) -> None:
    form, payload = encode(message)
    assert len(payload) == form.full_length
    assert decode(form.id, payload) == message
    assert decode(form.id, payload.rstrip(b"\0")) == message, "cut zeros come back"
    assert decode(form.id, payload + b"\x07\x07") == message, "fields of a later dialect are ignored"


@given(any_message())
def test_payloads_are_those_of_pymavlink(message: Message) -> None:
    theirs = getattr(ardupilotmega, f"MAVLink_{message.wire_name().lower()}_message")
    values = {
        field.name: value.encode() if isinstance(value := getattr(message, field.name), str) else value
        for field in fields(message)
    }
    packed = theirs(**values).pack(ardupilotmega.MAVLink(None, 1, 1))
    form, payload = encode(message)
    assert payload[: packed[1]] == packed[10 : 10 + packed[1]]
    assert not payload[packed[1] :].strip(b"\0")
    assert form.crc_extra == theirs.crc_extra


def test_long_texts_are_cut_and_odd_letters_do_not_raise() -> None:
    form, payload = encode(Statustext(text="x" * 80))
    assert decode(form.id, payload) == Statustext(text="x" * 50)
    broken = bytearray(payload)
    broken[1:3] = b"\xff\xfe"
    read = decode(form.id, bytes(broken))
    assert isinstance(read, Statustext) and read.text.startswith("��")


def test_text_ends_at_the_first_zero() -> None:
    form, payload = encode(ParamValue(param_id="COMPASS_OFS_X", param_value=1.5))
    at = payload.index(b"COMPASS_OFS_X")
    garbage = payload[: at + 14] + b"zz" + payload[at + 16 :]
    assert decode(form.id, garbage) == ParamValue(param_id="COMPASS_OFS_X", param_value=1.5)


def test_nan_stays_nan() -> None:
    form, payload = encode(ParamValue(param_value=math.nan))
    read = decode(form.id, payload)
    assert isinstance(read, ParamValue) and math.isnan(read.param_value)


def test_a_number_too_large_for_its_field_is_our_mistake() -> None:
    with pytest.raises(struct.error):
        encode(replace(RawImu(), xmag=40_000))


def test_messages_without_a_dataclass_are_left_alone() -> None:
    radio = ardupilotmega.MAVLINK_MSG_ID_RADIO_STATUS
    assert wire_format(radio) is not None
    assert decode(radio, bytes(9)) is None
    assert wire_format(0xFFFFFF) is None and decode(0xFFFFFF, b"") is None
