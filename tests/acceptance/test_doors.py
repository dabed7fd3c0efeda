"""A drawn sample of `scripts/campaigns/doors.py`: a situation is judged alike through every door."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import pytest

# One of each verdict, a remark of what the parameters tell, and one, of many, that is mended.
SAMPLE = (
    "two contradict, rover",
    "exactly right, rover",
    "duplicate device id",
    "two autopilots on an id",
    "mounted at right angles, rover",
)


@pytest.fixture(scope="module")
def doors(campaigns: Callable[[str], Any]) -> Iterator[Any]:
    with pytest.MonkeyPatch.context() as patch:
        doors = campaigns("doors")
        # As many readings a second as a compass has: recordings of half the size.
        patch.setattr(doors, "CalibrateSettings", partial(doors.CalibrateSettings, rate_hz=10.0))
        # A minute of being turned about shows a service as much as two.
        patch.setattr(doors, "ABOUT_MOVES", doors.ABOUT_MOVES[:12])
        made = tuple(doors.situations(0))
        patch.setattr(doors, "situations", lambda _: made)
        yield doors


def sampled(doors: Any, name: str) -> list[Any]:
    family = [one for one in doors.situations(0) if one.family == name]
    return [family[np.random.default_rng(52).integers(len(family))]]


@pytest.mark.parametrize("name", SAMPLE)
def test_a_situation_is_judged_alike_through_every_door(
    doors: Any, name: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("MAVCOMPASS_UNDO_DIR", str(tmp_path))
    found = doors.tried(sampled(doors, name))
    assert doors.contradictions(found) == []
    asked = {"turns itself", "by hand", "its .tlog", "fleet", "its .csv", "learnt"}
    assert {one.door for one in found} >= asked


def test_a_contradiction_is_noticed(doors: Any, tmp_path: Path) -> None:
    """What is expected is told from what is found: the verdict, its words, and the claim."""
    (right,) = sampled(doors, "exactly right, rover")
    cell = doors.cell
    entry = {
        "accepted": True,
        "already_right": False,
        "heading_sigma_deg": 0.01,
        "warnings": [],
        "parameters": {"COMPASS_OFS_X": 300.0},
    }
    wire = doors.Wire([right.make(True)], right.edit, tmp_path / "a.tlog")
    before = dict(wire.vehicles[0].firmware.parameters.store.values)
    wrong = cell(right, "Python", lambda: (entry, False), wire=wire, before=before, mends=False).wrong
    wire.close()
    words = ["instead of right", "deg off", "not written"]
    assert [part for part in words if any(part in w for w in wrong)] == words
