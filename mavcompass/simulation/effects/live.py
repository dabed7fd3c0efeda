"""Run effects on a live simulated vehicle: the same forward models, fed block by block."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from mavcompass.simulation.effects.effect import Chain, Group, Setting, Signals
from mavcompass.simulation.physics.signals import Reading, Stimulus


class Distortion:
    """Distort what the sensors of a live vehicle say.

    Blocks follow each other in time and have one sample or more; what an effect must remember (a delay's
    buffer, a drift's value) is carried from block to block, so the split into blocks does not matter.
    """

    def __init__(self, settings: Sequence[Setting]) -> None:
        self._chain = Chain(settings)

    @property
    def settings(self) -> tuple[Setting, ...]:
        """Return the effects in the order in which they act."""
        return tuple(self._chain.settings)

    @property
    def groups(self) -> frozenset[Group]:
        """Return the sensors that the effects change."""
        return frozenset(group for setting in self._chain.settings for group in setting.effect.groups)

    def apply(self, stimulus: Stimulus, reading: Reading, rng: np.random.Generator) -> Reading:
        """Return the reading as the effects change it."""
        return self._chain.run(Signals(stimulus, reading), rng).reading
