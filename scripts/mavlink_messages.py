"""Write the table of MAVLink messages anew, from the installed pymavlink, and what type checkers are told."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import fields
from pathlib import Path
from xml.etree import ElementTree

from pymavlink.dialects.v20 import ardupilotmega

from mavcompass import messages

TABLE = Path(messages.__file__).with_name("messages.txt")
STUB = Path(messages.__file__).with_suffix(".pyi")
_CODES = {"char": "s", "float": "f", "double": "d"}
_CODES |= {f"uint{bits}_t": code for bits, code in ((8, "B"), (16, "H"), (32, "I"), (64, "Q"))}
_CODES |= {f"int{bits}_t": code for bits, code in ((8, "b"), (16, "h"), (32, "i"), (64, "q"))}


def lines() -> list[str]:
    """List what pymavlink says of each message: number, name, extra byte, layout, fields.

    Fields stand as its definitions have them, extensions behind a bar in the layout.
    """
    definitions = dict(_definitions("ardupilotmega"))
    return [
        " ".join([str(number), m.msgname, str(m.crc_extra), _layout(definitions[m.msgname]), *m.fieldnames])
        for number, m in sorted(ardupilotmega.mavlink_map.items())
    ]


def _definitions(name: str) -> Iterator[tuple[str, ElementTree.Element]]:
    """Yield each message's name and definition, of a dialect and those that it includes."""
    document = ElementTree.parse(Path(ardupilotmega.__file__).with_name(f"{name}.xml"))
    for included in document.iter("include"):
        yield from _definitions(str(included.text).removesuffix(".xml"))
    for message in document.iter("message"):
        yield message.attrib["name"], message


def _layout(definition: ElementTree.Element) -> str:
    codes = ""
    for part in definition:
        if part.tag == "extensions":
            codes += "|"
        elif part.tag == "field":
            kind, _, count = part.attrib["type"].rstrip("]").partition("[")
            codes += ("" if kind == "char" and count == "1" else count) + _CODES[kind.split("_mav")[0]]
    return codes


def stub() -> str:
    """Spell the classes of `mavcompass.messages`, which are made as they are asked for, for type checkers."""
    out = [
        "# Written by scripts/mavlink_messages.py: the classes that are made of the dialect.",
        "from dataclasses import dataclass\n",
        "from mavcompass.messages.message import Incoming as Incoming",
        "from mavcompass.messages.message import Message as Message\n",
        "def kind_named(name: str) -> type[Message] | None: ...",
        "def message_id(kind: type[Message]) -> int: ...",
    ]
    for name in sorted(set(dir(messages)) - {"Incoming", "Message", "kind_named", "message_id"}):
        kind = getattr(messages, name)
        (base,) = kind.__bases__
        own = [item for item in fields(kind) if base is messages.Message]
        told = [f"    {item.name}: {_type(item.default)} = ..." for item in own]
        body = "\n".join(["", *told]) if told else " ..."
        out.append(f"\n@dataclass(frozen=True, slots=True)\nclass {name}({base.__name__}):{body}")
    return "\n".join(out) + "\n"


def _type(default: object) -> str:
    if isinstance(default, tuple):
        return f"tuple[{_type(default[0])}, ...]"
    return type(default).__name__


if __name__ == "__main__":
    TABLE.write_text("\n".join(lines()) + "\n", "ascii")
    STUB.write_text(stub(), "ascii")
