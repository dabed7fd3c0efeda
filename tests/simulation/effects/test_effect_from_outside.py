"""A new effect is one new file: nothing else names it."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from types import ModuleType

import pytest

from mavcompass.errors import UsageError
from mavcompass.simulation import effects
from mavcompass.simulation.effects import causes
from mavcompass.simulation.effects.registry import catalogue

SEA_MONSTER = '''
    """A sea monster's own field."""

    from mavcompass.simulation.effects.effect import Effect, Stage, axes


    def _monster(signals, theta, memory, rng):
        return signals.with_mag(signals.reading.mag_mgauss + theta)


    EFFECTS = (
        Effect(
            id="sea_monster",
            title="a sea monster swims along",
            stage=Stage.HULL,
            parameters=axes(-900.0, 900.0, (40.0, 0.0, -25.0), 1.0, "mG"),
            forward=_monster,
            separated_by="bait",
            source="sailors",
        ),
    )
'''


@pytest.fixture
def sea_monster(add_file: Callable[[ModuleType, str, str], None]) -> Iterator[None]:
    add_file(causes, "sea_monster", SEA_MONSTER)
    catalogue.cache_clear()
    yield
    catalogue.cache_clear()


@pytest.mark.usefixtures("sea_monster")
def test_a_file_in_the_folder_is_an_effect() -> None:
    assert effects.parse("sea_monster:x=10").effect is catalogue()["sea_monster"]
    assert dict(effects.default("sea_monster").values) == pytest.approx({"x": 40.0, "y": 0.0, "z": -25.0})


def test_it_is_unknown_without_the_file() -> None:
    with pytest.raises(UsageError, match="no effect called 'sea_monster'"):
        effects.parse("sea_monster")
