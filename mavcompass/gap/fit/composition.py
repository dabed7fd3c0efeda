"""The simulation that a hypothesis makes of a replay: nuisances and effects in order, and its derivatives.

Derivatives are differences of the forward models: each parameter runs the composition again from its own
stage on. What an attitude may be off by, and a common delay, are reckoned once for all columns.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence

import numpy as np
from numpy.typing import NDArray

from mavcompass.frames import FloatArray
from mavcompass.gap.fit.hypothesis import Term
from mavcompass.gap.replay import REFERENCE_YAW, TELEMETRY_AGE, Nuisance, Replay, turned
from mavcompass.simulation.effects.effect import Effect, Signals, Stage
from mavcompass.simulation.effects.sampling import at_times, central_differences
from mavcompass.simulation.physics.signals import Reading

_STEP = 1e-3
_NUDGE_RAD = 1e-5
# Stages whose changes turn with the vehicle, and of them those that differ from place to place.
_TURNING = ({Stage.ATTITUDE, Stage.WORLD}, {Stage.WORLD})


def difference(after: Reading, before: Reading, step: float = 1.0) -> Reading:
    """Return the change of a reading, over a step."""
    return Reading(
        *(
            np.zeros_like(b) if a is b else (a - b) / step
            for a, b in (
                (after.mag_mgauss, before.mag_mgauss),
                (after.acc_mps2, before.acc_mps2),
                (after.gyro_radps, before.gyro_radps),
            )
        )
    )


def _nudged(signals: Signals) -> list[Signals]:
    """Turn an attitude a little about each of the world's axes."""
    return [
        turned(signals, np.broadcast_to(axis, (signals.stimulus.time_s.size, 3)))
        for axis in _NUDGE_RAD * np.eye(3)
    ]


def _along(by_axis: Sequence[Reading], curves_rad: FloatArray, yaw_rad: float) -> list[Reading]:
    """Combine the changes by turns about the world's axes to those by curves of a frame turned by a yaw."""
    if not curves_rad.shape[2]:
        return []
    c, d = math.cos(yaw_rad), math.sin(yaw_rad)
    turns = np.array([[c, -d, 0.0], [d, c, 0.0], [0.0, 0.0, 1.0]]) @ curves_rad
    mag = np.stack([one.mag_mgauss for one in by_axis], axis=2) @ turns
    still = by_axis[0]
    return [Reading(mag[:, :, k], 0.0 * still.acc_mps2, 0.0 * still.gyro_radps) for k in range(mag.shape[2])]


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

    def _ordered(self, terms: Sequence[Term]) -> list[tuple[Effect, int]]:
        """List the effects of the composition in order, with their places in the list of parameters."""
        members = [(n.effect, i) for i, n in enumerate(self.nuisances)]
        members += [(t.effect, len(self.nuisances) + i) for i, t in enumerate(terms)]
        # Sorting is stable: a nuisance acts before the effects of its stage.
        return sorted(members, key=lambda member: member[0].stage)

    def states(
        self, terms: Sequence[Term], thetas: Sequence[FloatArray], nuisance_thetas: Sequence[FloatArray]
    ) -> list[Signals]:
        """Return the signals after each member of the composition, the replay's own first."""
        everything = [*nuisance_thetas, *thetas]
        states = [self.replay.signals]
        for effect, place in self._ordered(terms):
            states.append(effect.forward(states[-1], everything[place], {}, None))
        return states

    def _run_from(
        self, order: list[tuple[Effect, int]], at: int, state: Signals, thetas: list[FloatArray]
    ) -> Reading:
        for effect, place in order[at:]:
            state = effect.forward(state, thetas[place], {}, None)
        return state.reading

    def changes(
        self, terms: Sequence[Term], thetas: Sequence[FloatArray], nuisance_thetas: Sequence[FloatArray],
        states: list[Signals], wanted: Sequence[int],
    ) -> list[Reading]:  # fmt: skip
        """Return the derivatives of the prediction by the free parameters of some members, in their order."""
        order = self._ordered(terms)
        everything = [*nuisance_thetas, *thetas]
        places = {place: at for at, (_, place) in enumerate(order)}
        # A common delay comes last and is the same for all that comes before it: once for all columns.
        late = order[-1][0].id == TELEMETRY_AGE if order else False
        end = len(order) - 1 if late else len(order)
        changes: list[Reading] = []
        early: dict[int, Stage] = {}
        for place in wanted:
            at = places[place]
            effect = order[at][0]
            stop = end if at < end else len(order)
            base = states[stop].reading
            free = self.free(terms, place)
            for j in free[:1] if effect.id == REFERENCE_YAW else free:
                theta = everything[place].copy()
                step = _STEP * max(effect.parameters[j].scale, 1e-12)
                if theta[j] + step > effect.parameters[j].high:
                    step = -step
                theta[j] += step
                moved = everything.copy()
                moved[place] = theta
                if stop < len(order):
                    early[len(changes)] = effect.stage
                changes.append(difference(self._run_from(order[:stop], at, states[at], moved), base, step))
            if effect.id == REFERENCE_YAW:
                if stop < len(order):
                    curves = range(len(changes), len(changes) + free.size - 1)
                    early |= dict.fromkeys(curves, effect.stage)
                after = (self._run_from(order[:stop], at + 1, s, everything) for s in _nudged(states[at + 1]))
                by_axis = [difference(reading, base, _NUDGE_RAD) for reading in after]
                yaw = float(everything[place][0])
                changes += _along(by_axis, self.replay.reference.curves_rad, yaw)
        if early and late:
            self._delay(changes, early, float(everything[order[-1][1]][0]))
        return changes

    def _delay(self, changes: list[Reading], early: Mapping[int, Stage], delay_s: float) -> None:
        """Delay changes, by their places and stages: of attitude and world's field they turn with the
        vehicle."""
        s = self.replay.signals.stimulus
        stacked = np.stack([changes[i].mag_mgauss for i in early], axis=1)

        def slopes_of(values: FloatArray) -> FloatArray:
            flat = values.reshape(s.time_s.size, -1)
            return central_differences(s.time_s, flat).reshape(values.shape)

        slopes = slopes_of(stacked)
        turns, of_world = (np.array([stage in few for stage in early.values()]) for few in _TURNING)
        slopes[:, turns] = np.cross(stacked[:, turns], s.rate_radps[:, None])
        if of_world.any():
            there = np.einsum("nij,nkj->nki", s.rotation, stacked[:, of_world])
            slopes[:, of_world] += np.einsum("nji,nkj->nki", s.rotation, slopes_of(there))
        flat, wanted = stacked.reshape(s.time_s.size, -1), s.time_s - delay_s
        late = at_times(s.time_s, flat, wanted, slopes.reshape(flat.shape)).reshape(stacked.shape)
        for n, i in enumerate(early):
            changes[i] = Reading(late[:, n], changes[i].acc_mps2, changes[i].gyro_radps)
