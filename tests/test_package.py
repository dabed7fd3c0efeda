"""`import mavcompass`: what it offers, and what it costs."""

from __future__ import annotations

import pydoc
import shutil
import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import mavcompass
from mavcompass.gap.trial.cases import Recipe, make_track
from mavcompass.logs.formats.csv.writer import write_track_csv

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


def test_help_shows_the_public_functions_first() -> None:
    assert "init" not in dir(mavcompass), "whoever lists it looks at it, and MAVProxy is seldom there"
    said = pydoc.plain(pydoc.render_doc(mavcompass))
    for name in ("read_track", "calibrate", "heading", "diagnose_gap", "connect"):
        assert said.index(f"{name}(") < said.index("PACKAGE CONTENTS")
        assert name == "heading" or f"    {name}(" in said.partition("\nFUNCTIONS\n")[2], name


@pytest.fixture(scope="module")
def turned(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A recording of a vehicle that turned in four steps."""
    path = tmp_path_factory.mktemp("turned") / "turned.csv"
    write_track_csv(make_track(Recipe("yaw-steps", duration_s=60.0, seed=3), []), path)
    return path


def test_a_path_is_taken_wherever_a_track_is_and_results_show_themselves(turned: Path) -> None:
    track = mavcompass.read_track(str(turned))
    result = mavcompass.calibrate(str(turned))
    assert result.correction == mavcompass.calibrate(track).correction
    headings = mavcompass.heading(turned, result.correction)
    assert len(headings.time_s) == len(track.compasses[1].time_s)
    told = mavcompass.diagnose_gap(turned, baseline=turned)
    for shown, words in (
        (track, "compass 1: "),
        (result, "Compass 1: "),
        (headings, "headings"),
        (told, "verdict"),
    ):
        assert words in shown._repr_html_(), words
    assert "<script>" not in replace(track, source="<script>")._repr_html_()


def test_a_track_goes_to_pandas_and_back(turned: Path) -> None:
    pytest.importorskip("pandas")
    track = mavcompass.read_track(turned)
    frame = track.to_pandas()
    assert (
        frame.index.name == "time_s"
        and "mag_x_mgauss" in frame
        and len(frame) >= len(track.compasses[1].time_s)
    )
    again = mavcompass.Track.from_pandas(frame)
    assert np.array_equal(again.raw_field(), track.raw_field())
    assert again.gyro_radps is not None and np.array_equal(again.gyro_radps.values, track.gyro_radps.values)
    mine = frame.reset_index()[["time_s", "mag_x_mgauss", "mag_y_mgauss", "mag_z_mgauss"]]
    assert len(mavcompass.Track.from_pandas(mine).compasses[1].time_s) == len(track.compasses[1].time_s)
