"""A small fleet."""

from __future__ import annotations

import os
from pathlib import Path

import pytest
from fleet_samples import write_recording

DAY_S = 86_400.0
COUNT = 12


@pytest.fixture(scope="session")
def twelve(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Twelve recordings of three boats, a day apart; the iron of boat-2 grows by 8 mG a day."""
    folder = tmp_path_factory.mktemp("fleet")
    for number in range(COUNT):
        boat, day = number % 3 + 1, number // 3
        offset = (20.0 + (8.0 * day if boat == 2 else 0.0), -10.0, 5.0)
        where = folder / f"boat-{boat}"
        where.mkdir(exist_ok=True)
        path = write_recording(where / f"day{day}.csv", offset, seed=number)
        os.utime(path, (1_700_000_000.0 + day * DAY_S,) * 2)
    return folder
