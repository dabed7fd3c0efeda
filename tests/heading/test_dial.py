"""The compass card of `mavcompass heading` on a terminal."""

from __future__ import annotations

import os
import pty
import subprocess
import sys

import pytest

from mavcompass.cli.terminal.lines import card


@pytest.mark.parametrize(
    ("heading_deg", "drawn"),
    [(0.0, "·  ·  N  ·  ·"), (92.0, "·  ·  E  ·  ·"), (359.0, "·  ·  N  ·  ·"), (315.0, "·  ·  NW ·  ·")],
)
def test_the_card_has_the_heading_in_its_middle(heading_deg: float, drawn: str) -> None:
    assert card(heading_deg, 13) == drawn


@pytest.mark.parametrize("heading_deg", range(0, 360, 7))
def test_the_card_is_always_as_wide(heading_deg: int) -> None:
    assert len(card(float(heading_deg))) == 31


def test_a_terminal_gets_one_line_that_is_redrawn_and_a_pipe_plain_lines() -> None:
    command = [sys.executable, "-m", "mavcompass", "heading", "sim:rover", "--duration", "1"]
    plain = subprocess.run(command, capture_output=True, text=True, check=True).stdout
    assert len(plain.splitlines()) > 3 and "\r" not in plain and "\x1b" not in plain

    ours, theirs = pty.openpty()
    subprocess.run(command, stdout=theirs, env={**os.environ, "TERM": "xterm", "COLUMNS": "200"}, check=True)
    os.close(theirs)
    seen = os.read(ours, 100_000).decode()
    os.close(ours)
    assert seen.count("\n") == 1 and seen.count("\r") > 4
    assert "magnetic" in seen and "W" in seen
