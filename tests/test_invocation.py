"""Commands that a person is told to type are spelt as they can be typed here."""

from __future__ import annotations

import sys
from pathlib import Path

import pytest

from mavcompass.installation.invocation import CALLED, pip_install, program


@pytest.fixture(autouse=True)
def nowhere(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> Path:
    """Have an empty search path and no launcher."""
    monkeypatch.delenv(CALLED, raising=False)
    monkeypatch.setenv("PATH", str(tmp_path))
    return tmp_path


def executable(path: Path) -> None:
    path.write_text("#!/bin/sh\n")
    path.chmod(0o755)


def test_the_launcher_is_named_as_it_was_called(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv(CALLED, "./my boat/mavcompass")
    assert program() == "'./my boat/mavcompass'"


def test_what_is_on_the_path_goes_by_its_name(nowhere: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(sys, "argv", ["/opt/mavcompass/bin/mavcompass"])
    assert program() == "/opt/mavcompass/bin/mavcompass"
    executable(nowhere / "mavcompass")
    assert program() == "mavcompass"


def test_another_program_that_uses_the_package_names_ours(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(sys, "argv", ["/usr/bin/ground-station"])
    assert program() == "mavcompass"


def test_pip_is_that_of_the_environment_that_runs(nowhere: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    executable(nowhere / "pip")  # the system's
    assert pip_install("mavcompass[ulog]") == f"{sys.executable} -m pip install 'mavcompass[ulog]'"
    monkeypatch.setattr(sys, "executable", str(nowhere / "python"))
    assert pip_install("mavcompass[ulog]") == "pip install 'mavcompass[ulog]'"
