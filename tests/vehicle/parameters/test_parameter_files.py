"""Parameter files of three ground stations."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from mavcompass.errors import UsageError
from mavcompass.vehicle.parameters.files import (
    FORMS,
    format_value,
    parameter_text,
    parse_parameters,
    read_parameter_file,
    write_parameter_file,
)
from mavcompass.vehicle.parameters.undo import load_record

names = st.from_regex(r"[A-Z][A-Z0-9_]{0,15}", fullmatch=True)
singles = st.floats(width=32, allow_nan=False, allow_infinity=False)


@settings(suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(st.dictionaries(names, singles, min_size=1, max_size=20), st.sampled_from(FORMS))
def test_what_is_written_is_read_back_to_the_bit(tmp_path: Path, values: dict[str, float], form: str) -> None:
    path = tmp_path / f"compass.{form}"
    write_parameter_file(path, values, comment=("a comment, with a comma", "and COMPASS_OFS_X 3"))
    read = read_parameter_file(path)
    assert list(read) == list(values)
    assert np.array_equal(np.float32(list(read.values())), np.float32(list(values.values())))


def test_mission_planners_form() -> None:
    text = "#NOTE: made 2026\nCOMPASS_OFS_X,5\nCOMPASS_DEC,0.2233572\r\nCOMPASS_OFS_Y , -80.5 # by hand\n\n"
    assert parse_parameters(text) == {"COMPASS_OFS_X": 5, "COMPASS_DEC": 0.2233572, "COMPASS_OFS_Y": -80.5}


def test_mavproxys_form() -> None:
    text = "COMPASS_OFS_X    5.000000\nCOMPASS_OFS_Y\t-80.000000\n# COMPASS_OFS_Z 3\n"
    assert parse_parameters(text) == {"COMPASS_OFS_X": 5.0, "COMPASS_OFS_Y": -80.0}


def test_qgroundcontrols_form() -> None:
    text = (
        "# Onboard parameters for Vehicle 1\n#\n# Vehicle-Id Component-Id Name Value Type\n"
        "1\t1\tCAL_MAG0_ID\t396809\t6\n1\t1\tCAL_MAG0_XOFF\t0.019999999552965164\t9\n"
    )
    assert parse_parameters(text) == {"CAL_MAG0_ID": 396809.0, "CAL_MAG0_XOFF": 0.019999999552965164}
    written = parameter_text(
        {"CAL_MAG0_ID": 396809.0, "CAL_MAG0_XOFF": 0.02}, "params", types={"CAL_MAG0_ID": 6}
    )
    assert written == "1\t1\tCAL_MAG0_ID\t396809\t6\n1\t1\tCAL_MAG0_XOFF\t0.02\t9\n"


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("COMPASS_OFS_X,5\nCOMPASS_OFS_Y\n", r"line 2: 'COMPASS_OFS_Y' is not a parameter"),
        ("COMPASS_OFS_X,five\n", r"line 1: 'five' is not a number"),
        ("\n\nCOMPASS_OFS_X,nan\n", r"line 3: COMPASS_OFS_X is nan"),
        ("COMPASS_OFS_X,inf\n", r"line 1: COMPASS_OFS_X is inf"),
        ("COMPASS_OFS_X,1\nCOMPASS_OFS_X,2\n", r"line 2: COMPASS_OFS_X is 2 here and 1 in line 1"),
        ("A_NAME_THAT_IS_TOO_LONG,1\n", r"line 1: 'A_NAME_THAT_IS_TOO_LONG' is not a parameter's name"),
        ("1,2\n", r"line 1: '1' is not a parameter's name"),
        ("V 1 A 2 9\n", r"line 1: 'V 1 A 2 9' is not a parameter"),
        ("1 C A 2 9\n", r"line 1: '1 C A 2 9' is not a parameter"),
        ("# only words\n", r"holds no parameters"),
        ("", r"holds no parameters"),
    ],
)
def test_what_is_wrong_is_told_with_its_line(text: str, said: str) -> None:
    with pytest.raises(UsageError, match=said):
        parse_parameters(text, "compass.param")


def test_the_same_line_twice_is_no_contradiction() -> None:
    assert parse_parameters("A 1\nA 1\n") == {"A": 1.0}


def test_what_is_no_parameter_file_is_told(tmp_path: Path) -> None:
    binary = tmp_path / "flight.param"
    binary.write_bytes(b"\xa3\x95\x80\x80\xff\xfe")
    with pytest.raises(UsageError, match="not a text file"):
        read_parameter_file(binary)
    with pytest.raises(UsageError, match="cannot be read"):
        read_parameter_file(tmp_path / "absent.param")
    with pytest.raises(UsageError, match="which form"):
        write_parameter_file(tmp_path / "compass.txt", {"A": 1.0})
    with pytest.raises(UsageError, match="could not be written"):
        write_parameter_file(tmp_path / "absent" / "a.param", {"A": 1.0})


UNDO = '{"schema":"mavcompass.undo/1","made_at":"","autopilot":"px4","source":"","before":{"A":%s}'


@pytest.mark.parametrize(
    "text",
    [
        "{}",
        "[1]",
        "not json",
        '{"schema": "other/1"}',
        '{"schema":"mavcompass.undo/1"}',
        UNDO % ("9" * 400) + ',"planned":{},"parameters":{}}',
        "[" * 5000,
    ],
)
def test_what_is_no_undo_file_is_told(tmp_path: Path, text: str) -> None:
    path = tmp_path / "undo.json"
    path.write_text(text)
    with pytest.raises(UsageError, match="not an undo file"):
        load_record(path)


def test_values_are_short_and_exact() -> None:
    shortest = {5.0: "5", -80.5: "-80.5", 0.1: "0.1", 131874.0: "131874", 1e-7: "0.0000001"}
    assert {value: format_value(value) for value in shortest} == shortest
