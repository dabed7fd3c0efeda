"""`mavcompass heading`: rows of recordings and of live vehicles, thinned out, as text and as JSON."""

from __future__ import annotations

import json
import math
import os
import pty
import subprocess
import sys
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

from mavcompass import api
from mavcompass.cli.main import main
from mavcompass.cli.terminal.lines import card
from mavcompass.heading import evidence
from mavcompass.track import Track

TIMES = np.arange(0.0, 4.0, 0.5)
Shown = pytest.CaptureFixture[str]


@pytest.fixture
def flight(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> str:
    """A recording of eight headings; where its place was unknown, none is true."""
    path = tmp_path / "flight.BIN"
    path.write_bytes(b"")
    true = np.where(TIMES < 1.0, math.nan, math.radians(92.0))
    found = SimpleNamespace(
        time_s=TIMES,
        magnetic_rad=np.full(8, math.radians(90.0)),
        true_rad=true,
        grid_rad=None,
        sigma_rad=np.full(8, math.radians(1.5)),
        north=None,
    )
    monkeypatch.setattr(api, "read_track", lambda source: Track(source=source))
    monkeypatch.setattr(evidence, "heading_of_track", lambda track, earth, instance, two_axis: found)
    return str(path)


@pytest.mark.parametrize(
    ("words", "times"),
    [
        ([], list(TIMES)),
        (["--rate", "1"], [0.0, 1.0, 2.0, 3.0]),
        (["--duration", "1"], [0.0, 0.5, 1.0]),
        (["--rate", "100"], list(TIMES)),
    ],
)
def test_rows_of_a_recording(words: list[str], times: list[float], flight: str, capsys: Shown) -> None:
    assert main(["heading", flight, "--json-lines", *words]) == 0
    rows = [json.loads(line) for line in capsys.readouterr().out.splitlines()]
    assert [row["time_s"] for row in rows] == times
    assert {row["magnetic_deg"] for row in rows} == {90.0} and {row["sigma_deg"] for row in rows} == {1.5}
    assert [row["true_deg"] for row in rows] == [None if t < 1.0 else 92.0 for t in times]
    assert {row["grid_deg"] for row in rows} == {None}


def test_one_document_of_all(flight: str, capsys: Shown) -> None:
    assert main(["heading", flight, "--json", "-"]) == 0
    document = json.loads(capsys.readouterr().out)
    assert document["schema"] == "mavcompass.heading/1" and document["source"] == flight
    assert len(document["headings"]) == 8


def test_lines_for_a_person(flight: str, capsys: Shown) -> None:
    assert main(["heading", flight, "--rate", "1"]) == 0
    lines = capsys.readouterr().out.splitlines()
    assert len(lines) == 4 and all("90.0" in line for line in lines)


def test_two_axes_are_of_the_first_compass(capsys: Shown) -> None:
    assert main(["heading", "sim:rover", "--two-axis", "--compass", "2"]) == 2
    assert "--two-axis works on compass 1 of a live vehicle" in capsys.readouterr().err
    assert main(["heading", "sim:rover", "--two-axis", "--duration", "2", "--json-lines"]) == 0
    assert 9 <= len(capsys.readouterr().out.splitlines()) <= 11  # 5 rows a second, as the help says


@pytest.mark.parametrize(
    ("heading_deg", "drawn"),
    [(0.0, "·  ·  N  ·  ·"), (92.0, "·  ·  E  ·  ·"), (359.0, "·  ·  N  ·  ·"), (315.0, "·  ·  NW ·  ·")],
)
def test_the_card_has_the_heading_in_its_middle(heading_deg: float, drawn: str) -> None:
    assert card(heading_deg, 13) == drawn


@pytest.mark.parametrize("heading_deg", range(0, 360, 7))
def test_the_card_is_always_as_wide(heading_deg: int) -> None:
    assert len(card(float(heading_deg))) == 31


def test_a_terminal_gets_one_line_that_is_redrawn_and_a_pipe_plain_lines(capsys: Shown) -> None:
    words = ["heading", "sim:rover", "--duration", "1"]
    assert main(words) == 0
    plain = capsys.readouterr().out
    assert len(plain.splitlines()) > 3 and "\r" not in plain and "\x1b" not in plain

    ours, theirs = pty.openpty()
    command = [sys.executable, "-m", "mavcompass", *words]
    subprocess.run(command, stdout=theirs, env={**os.environ, "TERM": "xterm", "COLUMNS": "200"}, check=True)
    os.close(theirs)
    seen = os.read(ours, 100_000).decode()
    os.close(ours)
    assert seen.count("\n") == 1 and seen.count("\r") > 4
    assert "magnetic" in seen and "W" in seen
