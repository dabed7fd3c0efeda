"""The table of messages against its source, pymavlink's dialect."""

from __future__ import annotations

import runpy
import sys
from pathlib import Path
from subprocess import run

import pytest
from pymavlink.dialects.v20 import ardupilotmega

from mavcompass.messages.dialect import crc_extras, describe, message_ids

SCRIPT = Path(__file__).parents[2] / "scripts" / "mavlink_messages.py"


def test_the_table_is_what_pymavlink_says() -> None:
    script = runpy.run_path(str(SCRIPT))
    stored = script["TABLE"].read_text("ascii").splitlines()
    newest = {line.split()[0]: line for line in script["lines"]()}
    # A newer pymavlink may know more messages; those in the table are the same.
    assert [line for line in stored if newest[line.split()[0]] != line] == []


@pytest.mark.parametrize("name", ["HEARTBEAT", "ATTITUDE", "PARAM_EXT_VALUE", "STATUSTEXT", "SIMSTATE"])
def test_a_message_is_described_as_pymavlink_packs_it(name: str) -> None:
    theirs = ardupilotmega.mavlink_map[message_ids()[name]]
    ours = describe(theirs.id)
    assert ours is not None and ours.name == theirs.msgname == name
    assert ours.payload.format == theirs.unpacker.format and ours.payload.size == theirs.unpacker.size
    assert crc_extras()[theirs.id] == ours.crc_extra == theirs.crc_extra
    assert [f.name for f in ours.fields] == theirs.ordered_fieldnames
    texts = [n for n, kind in zip(theirs.fieldnames, theirs.fieldtypes, strict=True) if kind == "char"]
    assert {f.name for f in ours.fields if f.is_text} == set(texts)


def test_what_type_checkers_are_told_of_messages_is_what_they_are() -> None:
    script = runpy.run_path(str(SCRIPT))
    assert script["STUB"].read_text("ascii") == script["stub"]()


def test_an_unknown_message_has_no_description() -> None:
    assert describe(16_777_215) is None


def test_pymavlink_is_not_loaded_for_it() -> None:
    """It takes half a second and a hundred megabytes."""
    asks = "import sys; from mavcompass.messages.dialect import describe; describe(30); "
    out = run(
        [sys.executable, "-c", asks + "print('pymavlink' in sys.modules)"], capture_output=True, text=True
    )
    assert out.stdout == "False\n"
