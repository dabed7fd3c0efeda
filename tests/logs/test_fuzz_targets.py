"""A little of `scripts/campaigns/fuzz.py`: its seeds, what broke something once, some mutations of each."""

from __future__ import annotations

import random
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
    chance = random.Random(name)
    corpus = [*targets.seeds(name), *fuzz.kept(name)]
    for content in [*corpus, b"", *(fuzz.mutated(chance.choice(corpus), chance) for _ in range(12))]:
        targets.TARGETS[name](content)


@pytest.mark.parametrize("name", ["tlog", "dataflash", "ulog", "csv", "undo", "toml", "param"])
def test_a_kilobyte_takes_neither_seconds_nor_megabytes(
    campaign: tuple[ModuleType, ModuleType], name: str
) -> None:
    fuzz, targets = campaign
    chance, target = random.Random(name), targets.TARGETS[name]
    seed = targets.seeds(name)[0][:1024]
    target(seed)  # imports
    began_s = time.process_time()
    tracemalloc.start()
    for _ in range(4):
        target(fuzz.mutated(seed, chance)[:1024])
    _, peak = tracemalloc.get_traced_memory()
    tracemalloc.stop()
    assert time.process_time() - began_s < 8.0
    assert peak < 64e6
