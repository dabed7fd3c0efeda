"""Fixtures that many tests share."""

from __future__ import annotations

import os
from pathlib import Path

import pytest
from hypothesis import settings

# A busy machine is no failure, and a suite that is green stays green: the examples follow from the test.
settings.register_profile("mavcompass", deadline=None, derandomize=True)
settings.load_profile("mavcompass")

PROJECT = Path(__file__).resolve().parents[1]


def pytest_addoption(parser: pytest.Parser) -> None:
    parser.addoption(
        "--mav-url",
        metavar="URL",
        default=None,
        help="run the tests that need a vehicle against the one at this address, e.g. udpin:0.0.0.0:14550",
    )


@pytest.fixture(scope="session")
def shared_data() -> Path:
    """The folder of recordings, which stands beside the project and not in it."""
    folder = Path(os.environ.get("MAVCOMPASS_SHARED_DATA") or PROJECT.parent / "shared" / "data")
    if not folder.is_dir():
        pytest.skip(f"the recordings are not at {folder}; set MAVCOMPASS_SHARED_DATA to their folder")
    return folder


@pytest.fixture(scope="session")
def mav_url(request: pytest.FixtureRequest) -> str:
    """The address of a real or separately started vehicle."""
    url = request.config.getoption("--mav-url")
    if url is None:
        pytest.skip("needs a vehicle: give its address with --mav-url URL")
    return str(url)
