"""`import mavcompass`: what it offers, and what it costs."""

from __future__ import annotations

import shutil
import subprocess
import sys
from pathlib import Path

import pytest

import mavcompass

API = """
def heading(track, correction):
    from mavcompass.heading.tilt import level
    return level, track, correction
def calibrate(track, method="four-positions"):
    return method, track
"""


def run(code: str, folder: Path | None = None) -> str:
    done = subprocess.run(
        [sys.executable, "-c", code], cwd=folder, capture_output=True, text=True, timeout=300
    )
    assert done.returncode == 0, done.stderr
    return done.stdout.strip()


@pytest.fixture
def small_house(tmp_path: Path) -> Path:
    """The real `mavcompass/__init__.py` with an interface and rooms that are easy to see through."""
    package = tmp_path / "mavcompass"
    for room in ("heading", "calibration"):
        (package / room).mkdir(parents=True)
        (package / room / "__init__.py").touch()
    (package / "heading" / "tilt.py").write_text("level = 'level'\n")
    (package / "calibration" / "sphere.py").touch()
    (package / "api.py").write_text(API)
    shutil.copy(mavcompass.__file__, package / "__init__.py")
    return tmp_path


@pytest.mark.parametrize(
    "before",
    [
        "",
        "import mavcompass.heading",
        "import mavcompass.heading.tilt",
        "import mavcompass.heading.tilt as tilt; assert tilt.level",
        "from mavcompass.heading.tilt import level",
        "from mavcompass import heading; assert heading.__name__ == 'mavcompass.heading'",
        "import mavcompass.api",
        "import mavcompass; mavcompass.heading(0, 0); import mavcompass.heading.tilt as tilt",
    ],
)
def test_heading_is_called_and_entered_whatever_was_imported_before(small_house: Path, before: str) -> None:
    code = f"""{before}
import mavcompass
print(mavcompass.heading("track", "correction"))
import mavcompass.heading.tilt
print(mavcompass.heading("track", "correction"), mavcompass.heading.tilt.level)
from mavcompass import heading
print(heading("track", "correction"))
"""
    called = "('level', 'track', 'correction')"
    assert run(code, small_house).splitlines() == [called, f"{called} level", called]


@pytest.mark.parametrize("before", ["", "import mavcompass.calibration.sphere", "import mavcompass.api"])
def test_calibrate_is_the_function_whatever_was_imported_before(small_house: Path, before: str) -> None:
    code = f"{before}\nimport mavcompass\nprint(mavcompass.calibrate('track', method='sphere'))"
    assert run(code, small_house) == "('sphere', 'track')"


def test_names_of_the_ground_floor_are_found() -> None:
    from mavcompass.correction import FieldCorrection
    from mavcompass.errors import MavCompassError
    from mavcompass.track import Track

    assert mavcompass.Track is Track
    assert mavcompass.FieldCorrection is FieldCorrection
    assert mavcompass.MavCompassError is MavCompassError


def test_a_name_that_does_not_exist_is_an_attribute_error() -> None:
    with pytest.raises(AttributeError, match="no_such_name"):
        mavcompass.no_such_name  # noqa: B018


def test_dir_lists_the_public_names() -> None:
    assert {"calibrate", "heading", "read_track", "connect", "diagnose_gap"} <= set(dir(mavcompass))


@pytest.mark.parametrize("module", ["mavcompass", "mavcompass.cli.main"])
def test_import_loads_no_heavy_library(module: str) -> None:
    heavy = ("numpy", "scipy", "pymavlink", "mavsdk", "rich", "matplotlib", "asyncio")
    assert run(f"import sys, {module}; print([name for name in {heavy!r} if name in sys.modules])") == "[]"
