"""A little of `scripts/campaigns/fuzz.py`: its seeds, what broke something once, some mutations of each."""

from __future__ import annotations

import time
import tracemalloc
from collections.abc import Callable
from types import ModuleType

import pytest

NAMES = (
    "framing codec listeners tlog dataflash dataflash-text ulog csv"
    " param params undo diagnosis preset toml address effect body guard"
).split()


@pytest.fixture(scope="module")
def campaign(campaigns: Callable[[str], ModuleType]) -> tuple[ModuleType, ModuleType]:
    return campaigns("fuzz"), campaigns("fuzz_targets")


@pytest.mark.parametrize("name", NAMES)
def test_hostile_bytes_are_refused_or_read(campaign: tuple[ModuleType, ModuleType], name: str) -> None:
    fuzz, targets = campaign
    assert list(fuzz.NAMES) == NAMES == list(targets.TARGETS)
    corpus = [*targets.seeds(name), *fuzz.kept(name)]
    for content in [*corpus, b"", *(fuzz.mutated(corpus, 1, number) for number in range(12))]:
        targets.TARGETS[name](content)


@pytest.mark.parametrize("name", ["tlog", "dataflash", "ulog", "csv", "undo", "toml", "param"])
def test_a_kilobyte_takes_neither_seconds_nor_megabytes(
    campaign: tuple[ModuleType, ModuleType], name: str
) -> None:
    fuzz, targets = campaign
    target, seed = targets.TARGETS[name], targets.seeds(name)[0][:1024]
    target(seed)  # imports
    began_s = time.process_time()
    tracemalloc.start()
    for number in range(4):
        target(fuzz.mutated([seed], 1, number)[:1024])
    _, peak = tracemalloc.get_traced_memory()
    tracemalloc.stop()
    assert time.process_time() - began_s < 8.0
    assert peak < 64e6
