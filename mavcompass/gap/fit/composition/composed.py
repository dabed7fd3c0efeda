"""The simulation that a hypothesis makes of a replay: nuisances and effects in order, and its derivatives."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from mavcompass.frames import FloatArray
from mavcompass.gap.fit.composition.derivatives import Changes, Derivatives
from mavcompass.gap.fit.composition.lateness import made_late, together
from mavcompass.gap.fit.hypothesis import Term
from mavcompass.gap.replay import Nuisance, Replay
from mavcompass.simulation.effects.effect import Effect, Signals


class Composition:
    """Run nuisances and effects on a replay; places count the nuisances first, then the terms."""

    def __init__(self, replay: Replay, nuisances: Sequence[Nuisance]) -> None:
        self.replay = replay
        self.nuisances = nuisances

    def free(self, terms: Sequence[Term], place: int) -> NDArray[np.int64]:
        """Return the places of the free parameters of a member."""
        n = len(self.nuisances)
        if place < n:
            return np.arange(len(self.nuisances[place].effect.parameters))
        return np.flatnonzero(terms[place - n].free)

    def _ordered(self, terms: Sequence[Term], everything: Sequence[FloatArray]) -> list[tuple[Effect, int]]:
        """List the effects of the composition in order, with their places in the list of parameters."""
        members = [(n.effect, i) for i, n in enumerate(self.nuisances)]
        members += [(t.effect, len(self.nuisances) + i) for i, t in enumerate(terms)]
        # Sorting is stable: a nuisance acts before the effects of its stage.
        return sorted(members, key=lambda member: member[0].stage_at(everything[member[1]]))

    def states(
        self, terms: Sequence[Term], thetas: Sequence[FloatArray], nuisance_thetas: Sequence[FloatArray],
        without_last: Sequence[Signals] = (),
    ) -> list[Signals]:  # fmt: skip
        """Return the signals after each member of the composition, the replay's own first.

        `without_last` are those without the last of the terms, where they are known.
        """
        everything = [*nuisance_thetas, *thetas]
        order = self._ordered(terms, everything)
        states = [self.replay.signals]
        if without_last:
            states = list(without_last[: 1 + [place for _, place in order].index(len(everything) - 1)])
        for at, (effect, place) in enumerate(order[len(states) - 1 :], len(states) - 1):
            late = together(order, at)
            if len(late) == 1:
                states.append(effect.forward(states[-1], everything[place], {}, None))
            else:
                # What is late and is made later waits for that.
                last = at == late[-1]
                members = [order[i] for i in late]
                before = states[late[0]]
                states.append(made_late(before, members, everything) if last else states[-1])
        return states

    def changes(
        self, terms: Sequence[Term], thetas: Sequence[FloatArray], nuisance_thetas: Sequence[FloatArray],
        states: list[Signals], wanted: Sequence[int],
    ) -> Changes:  # fmt: skip
        """Return the derivatives of the prediction by the free parameters of some members, in their order;
        nothing where there are none."""
        everything = [*nuisance_thetas, *thetas]
        order = self._ordered(terms, everything)
        places = {place: at for at, (_, place) in enumerate(order)}
        derivatives = Derivatives(self.replay, order, everything, states)
        for place in wanted:
            derivatives.by_member(places[place], self.free(terms, place))
        return derivatives.changes()

    def changes_beside(
        self, terms: Sequence[Term], thetas: Sequence[FloatArray], nuisance_thetas: Sequence[FloatArray],
        states: list[Signals], others: Sequence[tuple[Term, FloatArray]],
    ) -> Changes:  # fmt: skip
        """Return the derivatives by the free parameters of others that do nothing yet, in their order."""
        everything = [*nuisance_thetas, *thetas]
        derivatives = Derivatives(self.replay, self._ordered(terms, everything), everything, states)
        for term, theta in others:
            derivatives.as_it_begins(term.effect, theta, np.flatnonzero(term.free))
        return derivatives.changes()
