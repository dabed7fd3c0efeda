"""Every shared recording reads, calibrates and replays as it did when its golden result was stored."""

from __future__ import annotations

import json
from pathlib import Path

import pytest
from recorded_results import HERE, differences, recordings, results_of

STORED = sorted(path.name for path in HERE.glob("*.json"))


@pytest.mark.parametrize("name", STORED)
def test_a_recording_gives_its_golden_result(name: str, shared_data: Path) -> None:
    path = dict(recordings(shared_data)).get(name)
    if path is None:
        pytest.skip(f"the recording of {name} is not there")
    found = json.loads(json.dumps(results_of(path)))
    changed = list(differences(json.loads((HERE / name).read_text()), found))
    assert not changed, f"if that is meant: scripts/golden --write\n{chr(10).join(changed)}"


def test_every_recording_has_a_golden_result(shared_data: Path) -> None:
    assert {name for name, _ in recordings(shared_data)} <= set(STORED)


def test_a_difference_is_told_with_its_place() -> None:
    assert list(differences({"a": [1.0, {"b": 2}]}, {"a": [1.0 + 1e-7, {"b": 2}]})) == []
    told = list(differences({"a": [1.0, {"b": 2}]}, {"a": [1.1, {"c": 2}]}))
    assert [line.split(":")[0] for line in told] == ["/a/0", "/a/1/b", "/a/1/c"]
