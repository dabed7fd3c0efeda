"""The files of params/ are found in a checkout and travel in a wheel."""

from __future__ import annotations

import subprocess
import sys
import zipfile
from pathlib import Path

import pytest
from hatchling.builders.wheel import WheelBuilder

from mavcompass.errors import MavCompassError
from mavcompass.installation.parts import params_path

PROJECT = Path(__file__).resolve().parents[2]


def test_a_checkout_reads_its_own_params() -> None:
    assert params_path("README.md") == PROJECT / "params" / "README.md"
    assert params_path() == PROJECT / "params"


def test_a_missing_file_says_what_to_do() -> None:
    with pytest.raises(MavCompassError, match=r"no-such-file\.toml is missing .* Install mavcompass again"):
        params_path("no-such-file.toml")


def test_a_wheel_holds_the_package_and_its_params(tmp_path: Path) -> None:
    [wheel] = WheelBuilder(str(PROJECT)).build(directory=str(tmp_path), versions=["standard"])
    with zipfile.ZipFile(wheel) as archive:
        names = archive.namelist()
        archive.extractall(tmp_path / "site")
    assert {name.split("/")[0].split("-")[0] for name in names} == {"mavcompass"}
    assert "mavcompass/py.typed" in names

    code = "from mavcompass.installation.parts import params_path; print(params_path('README.md'))"
    # -S leaves out this environment, in which the checkout itself is installed
    done = subprocess.run(
        [sys.executable, "-S", "-c", code], cwd=tmp_path / "site", capture_output=True, text=True, timeout=300
    )
    assert done.stdout.strip() == str(tmp_path / "site" / "mavcompass" / "_params" / "README.md"), done.stderr
