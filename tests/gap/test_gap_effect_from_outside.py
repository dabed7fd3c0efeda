"""A new effect is one new file for the diagnosis too: it is searched, and named where it is."""

from __future__ import annotations

from collections.abc import Callable
from types import ModuleType

import pytest

from mavcompass.gap import diagnose_gap
from mavcompass.gap.trial.cases import Recipe, make_track
from mavcompass.simulation import effects
from mavcompass.simulation.effects import causes

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


def test_a_file_in_the_folder_is_named_by_the_diagnosis(
    add_file: Callable[[ModuleType, str, str], None],
) -> None:
    good = make_track(Recipe("rich", duration_s=60.0, rate_hz=10.0, seed=4))
    add_file(causes, "breathing_whale", BREATHING_WHALE)
    effects.catalogue.cache_clear()
    try:
        whale = [effects.parse("breathing_whale:x=40,y=-15,z=25")]
        found = diagnose_gap(make_track(Recipe("rich", duration_s=60.0, rate_hz=10.0, seed=5), whale), good)
    finally:
        effects.catalogue.cache_clear()
    (cause,) = found.causes
    assert found.verdict == "named" and cause.effect == "breathing_whale"
    assert cause.parameters["x"] == pytest.approx(40.0, abs=1.0)
