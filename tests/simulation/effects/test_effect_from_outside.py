"""A new effect is one new file: nothing else names it, and the diagnosis finds it where it is."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from types import ModuleType

import pytest

from mavcompass.errors import UsageError
from mavcompass.gap import diagnose_gap
from mavcompass.gap.trial.cases import Recipe, make_track
from mavcompass.simulation import effects
from mavcompass.simulation.effects import causes
from mavcompass.simulation.effects.registry import catalogue

BREATHING_WHALE = '''
    """A whale below the boat breathes, and its iron rises and sinks with it."""

    import numpy as np

    from mavcompass.simulation.effects.effect import Effect, Stage, axes


    def _breath(signals, theta, memory, rng):
        wave = np.sin(2.0 * np.pi * signals.stimulus.time_s / 17.0)
        return signals.with_mag(signals.reading.mag_mgauss + wave[:, None] * theta)


    EFFECTS = (
        Effect(
            id="breathing_whale",
            title="a whale breathes below the boat",
            stage=Stage.HULL,
            parameters=axes(-900.0, 900.0, (40.0, 0.0, -25.0), 1.0, "mG"),
            forward=_breath,
            separated_by="patience",
            source="sailors",
        ),
    )
'''


@pytest.fixture
def whale(add_file: Callable[[ModuleType, str, str], None]) -> Iterator[None]:
    add_file(causes, "breathing_whale", BREATHING_WHALE)
    catalogue.cache_clear()
    yield
    catalogue.cache_clear()


@pytest.mark.usefixtures("whale")
def test_a_file_in_the_folder_is_an_effect() -> None:
    assert effects.parse("breathing_whale:x=10").effect is catalogue()["breathing_whale"]
    assert dict(effects.default("breathing_whale").values) == pytest.approx({"x": 40.0, "y": 0.0, "z": -25.0})


@pytest.mark.usefixtures("whale")
def test_a_file_in_the_folder_is_named_by_the_diagnosis() -> None:
    there = [effects.parse("breathing_whale:x=40,y=-15,z=25")]
    flight, good = (
        make_track(Recipe("rich", duration_s=60.0, rate_hz=10.0, seed=seed), what)
        for seed, what in ((5, there), (4, []))
    )
    found = diagnose_gap(flight, good)
    (cause,) = found.causes
    assert found.verdict == "named" and cause.effect == "breathing_whale"
    assert cause.parameters["x"] == pytest.approx(40.0, abs=1.0)


def test_it_is_unknown_without_the_file() -> None:
    with pytest.raises(UsageError, match="no effect called 'breathing_whale'"):
        effects.parse("breathing_whale")
