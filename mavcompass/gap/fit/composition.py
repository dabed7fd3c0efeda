"""The simulation that a hypothesis makes of a replay: nuisances and effects in order, and its derivatives.

Derivatives are differences of the forward models: each parameter runs the composition again from its own
stage on. What an attitude may be off by, and a common delay, are reckoned once for all columns.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import replace
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from mavcompass.frames import FloatArray, rotate_back
from mavcompass.gap.attitude import Reference, cross_matrices
from mavcompass.gap.fit.hypothesis import Term
from mavcompass.gap.replay import REFERENCE_YAW, TELEMETRY_AGE, WHEREABOUTS, Nuisance, Replay, turned
from mavcompass.simulation.effects.causes.timing import followed, late, late_beside, late_field, turned_since
from mavcompass.simulation.effects.effect import EACH_BY_ITSELF, PLACED, Effect, Signals, Stage
from mavcompass.simulation.physics.signals import Reading, RecordedStimulus

_STEP = 1e-3
_NUDGE_RAD, _NUDGE_M = 1e-5, 1e-4
_NUDGE_MGAUSS = 1.0
# Matrices that differ by so little are alike; by so much they count.
_ALIKE, _APART = 1e-9, 0.03
# Stages whose changes turn with the vehicle.
_TURNING = frozenset({Stage.ATTITUDE, Stage.WORLD})
# What makes readings late.
_SMOOTHING = "low_pass"
_LATE = frozenset({"transport_lag", TELEMETRY_AGE, _SMOOTHING})


def difference(after: Reading, before: Reading, step: float = 1.0) -> Reading:
    """Return the change of a reading, over a step."""
    return Reading(
        *(
            _nothing(b.shape) if a is b else (a - b) / step
            for a, b in (
                (after.mag_mgauss, before.mag_mgauss),
                (after.acc_mps2, before.acc_mps2),
                (after.gyro_radps, before.gyro_radps),
            )
        )
    )


@lru_cache(maxsize=8)
def _nothing(shape: tuple[int, ...]) -> FloatArray:
    """Return zeros that all share."""
    zeros = np.zeros(shape)
    zeros.flags.writeable = False
    return zeros


def _nudged(signals: Signals) -> list[Signals]:
    """Turn an attitude a little about each of the world's axes."""
    return [
        turned(signals, np.broadcast_to(axis, (signals.stimulus.time_s.size, 3)))
        for axis in _NUDGE_RAD * np.eye(3)
    ]


def _turns(reference: Reference, yaw_rad: float) -> FloatArray:
    """Return the turns in world axes, (N, 3, 1 + k), by a constant of the yaw and by curves.

    The curves' frame is turned by that yaw.
    """
    c, d = math.cos(yaw_rad), math.sin(yaw_rad)
    curves = reference.curves_rad
    beside = np.broadcast_to(reference.with_yaw, (len(curves), 3))[:, :, None]
    turns = np.array([[c, -d, 0.0], [d, c, 0.0], [0.0, 0.0, 1.0]]) @ np.concatenate([beside, curves], axis=2)
    turns[:, 2, 0] += 1.0
    return turns


def _of_the_compass(mag_mgauss: FloatArray, like: Reading) -> list[Reading]:
    """Return changes (N, 3, k) of the compass alone as readings."""
    acc, gyro = np.zeros_like(like.acc_mps2), np.zeros_like(like.gyro_radps)
    return [Reading(mag_mgauss[:, :, k], acc, gyro) for k in range(mag_mgauss.shape[2])]


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
            together = _together(order, at)
            if len(together) == 1:
                states.append(effect.forward(states[-1], everything[place], {}, None))
            else:
                # What is late and is made later waits for that.
                last = at == together[-1]
                members = [order[i] for i in together]
                before = states[together[0]]
                states.append(_made_late(before, members, everything) if last else states[-1])
        return states

    def changes(
        self, terms: Sequence[Term], thetas: Sequence[FloatArray], nuisance_thetas: Sequence[FloatArray],
        states: list[Signals], wanted: Sequence[int],
    ) -> list[Reading]:  # fmt: skip
        """Return the derivatives of the prediction by the free parameters of some members, in their order."""
        everything = [*nuisance_thetas, *thetas]
        order = self._ordered(terms, everything)
        places = {place: at for at, (_, place) in enumerate(order)}
        # What makes late comes last, the same for all that comes before it: once for all columns.
        end = len(order)
        while end and order[end - 1][0].id in _LATE:
            end -= 1
        after = _After(order[:end], everything, states[: end + 1])
        changes: list[Reading] = []
        # By the member whose derivative it is, and its stage.
        made_by: list[tuple[int, Stage]] = []
        for place in wanted:
            at, free = places[place], self.free(terms, place)
            if not free.size:
                continue
            effect = order[at][0]
            together = _together(order, at)
            if effect.id == REFERENCE_YAW:
                turns = _turns(self.replay.reference, float(everything[place][0]))
                changes += after.turned(at + 1, turns)
            elif effect.id == WHEREABOUTS:
                changes += after.shifted(at + 1, self.replay.place_curves_m)
            elif len(together) > 1:
                step, at = _STEP * float(effect.parameters[0].scale), together[-1]
                later = [*everything[:place], everything[place] + step, *everything[place + 1 :]]
                then = _made_late(states[together[0]], [order[i] for i in together], later)
                changes.append(difference(then.reading, states[at + 1].reading, step))
            else:
                moved, steps = [], []
                for j in free:
                    theta = everything[place].copy()
                    step = _STEP * max(effect.parameters[j].scale, 1e-12)
                    if theta[j] + step > effect.parameters[j].high:
                        step = -step
                    theta[j] += step
                    moved.append(effect.forward(states[at], theta, {}, None))
                    steps.append(step)
                if at < end:
                    changes += after.changes(at + 1, moved, steps)
                else:
                    own = states[at + 1].reading
                    changes += [difference(m.reading, own, s) for m, s in zip(moved, steps, strict=True)]
            made_by += [(at, effect.stage)] * (len(changes) - len(made_by))
        early = {i: stage for i, (by, stage) in enumerate(made_by) if by < end}
        if early and end < len(order):
            self._make_late(changes, early, _lateness(order[end:], everything), states[end], after)
        return changes

    def _make_late(
        self,
        changes: list[Reading],
        early: Mapping[int, Stage],
        lateness: tuple[float, float],
        before: Signals,
        after: _After,
    ) -> None:
        """Delay and smooth changes of the reading `before`, by their places and stages.

        Those of attitude and world's field turn with the vehicle, as the compass sees them.
        """
        s = before.stimulus
        assert isinstance(s, RecordedStimulus)
        delay_s, time_constant_s = lateness
        wanted_s = s.time_s - delay_s
        back = turned_since(s.turning, wanted_s, time_constant_s).transpose(0, 2, 1)
        world = rotate_back(s.rotation, s.field_ned_mgauss)
        changed: dict[int, FloatArray] = {}
        if turning := [i for i, stage in early.items() if stage in _TURNING]:
            follows = np.eye(3) + followed(world, before.reading.mag_mgauss - world).T
            seen = after.seen(follows)
            stacked = np.linalg.inv(seen) @ np.stack([changes[i].mag_mgauss for i in turning], axis=2)
            apart = (seen - follows) @ stacked if np.abs(seen - follows).max() > _APART else None
            if moving := [n for n, i in enumerate(turning) if early[i] is Stage.WORLD]:
                # What differs from place to place changes as the vehicle moves, besides.
                placed = s.rotation @ stacked[:, :, moving]
                placed = _late_columns(s.time_s, placed, wanted_s, time_constant_s)
                stacked[:, :, moving] = s.rotation.transpose(0, 2, 1) @ placed
            stacked = back @ stacked
            # What does not follow the world's field by one matrix does not turn with it, but is interpolated.
            if apart is None:
                stacked = seen @ stacked
            else:
                stacked = follows @ stacked + _late_columns(s.time_s, apart, wanted_s, time_constant_s)
            changed = {i: np.asarray(stacked[:, :, n]) for n, i in enumerate(turning)}
        if rest := [i for i in early if i not in changed]:
            flat = np.hstack([changes[i].mag_mgauss for i in rest])
            late_ned = late(s.time_s, s.field_ned_mgauss, wanted_s, time_constant_s)
            then = np.matmul(back, rotate_back(s.rotation, late_ned)[:, :, None])[:, :, 0]
            flat = late_beside(s.time_s, world, then, flat, wanted_s, time_constant_s)
            changed |= {i: flat[:, 3 * n : 3 * n + 3] for n, i in enumerate(rest)}
        for i, mag in changed.items():
            changes[i] = Reading(mag, changes[i].acc_mps2, changes[i].gyro_radps)


def _late_columns(
    time_s: FloatArray, columns: FloatArray, wanted_s: FloatArray, time_constant_s: float
) -> FloatArray:
    """Return columns (N, 3, k) at other times, and smoothed."""
    return late(time_s, columns.reshape(len(columns), -1), wanted_s, time_constant_s).reshape(columns.shape)


def _together(order: Sequence[tuple[Effect, int]], at: int) -> range:
    """Return the members that are reckoned with member `at`: those that make readings late are one.

    One after the other they would interpolate what was interpolated, and a fit between them would stick.
    """
    first, end = at, at + 1
    if order[at][0].id in _LATE:
        while first and order[first - 1][0].id in _LATE:
            first -= 1
        while end < len(order) and order[end][0].id in _LATE:
            end += 1
    return range(first, end)


def _lateness(members: Sequence[tuple[Effect, int]], everything: Sequence[FloatArray]) -> tuple[float, float]:
    """Return by how many seconds members delay readings, and the time constant by which they smooth them."""
    each = [(effect.id == _SMOOTHING, float(everything[place][0])) for effect, place in members]
    return sum(s for smooths, s in each if not smooths), sum(s for smooths, s in each if smooths)


def _made_late(
    before: Signals, members: Sequence[tuple[Effect, int]], everything: Sequence[FloatArray]
) -> Signals:
    """Return signals as several members make them late together."""
    delay_s, time_constant_s = _lateness(members, everything)
    wanted_s = before.stimulus.time_s - delay_s
    return before.with_mag(late_field(before, wanted_s, time_constant_s=time_constant_s))


class _After:
    """Carry changes through the members of a composition that come after them."""

    def __init__(
        self, order: list[tuple[Effect, int]], thetas: list[FloatArray], states: list[Signals]
    ) -> None:
        self._order, self._thetas, self._states = order, thetas, states
        # Where every reading is changed by itself, the rest is a matrix of each row, (N, 3, 3).
        self._matrices: dict[int, FloatArray] = {}

    def changes(self, at: int, moved: Sequence[Signals], steps: Sequence[float]) -> list[Reading]:
        """Return the changes of the prediction when the signals before member `at` are moved by steps."""
        before, rest = self._states[at], self._order[at:]
        # What comes after asks the world for its attitude at most, and the compass for the rest.
        same = all(one.stimulus.rotation is before.stimulus.rotation for one in moved)
        if same and all(effect.stage in EACH_BY_ITSELF for effect, _ in rest):
            own = [difference(m.reading, before.reading, s) for m, s in zip(moved, steps, strict=True)]
            if not rest or not own:
                return own
            mag = self._matrix(at) @ np.stack([one.mag_mgauss for one in own], axis=2)
            return [Reading(mag[:, :, k], one.acc_mps2, one.gyro_radps) for k, one in enumerate(own)]
        end, out = self._states[-1].reading, []
        for one, step in zip(moved, steps, strict=True):
            for effect, place in rest:
                one = effect.forward(one, self._thetas[place], {}, None)
            out.append(difference(one.reading, end, step))
        return out

    def turned(self, at: int, turns: FloatArray) -> list[Reading]:
        """Return the changes when the attitude before member `at` is turned in world axes, (N, 3, k)."""
        first, count = at, len(self._order)
        while first < count and self._order[first][0].stage is Stage.WORLD:
            first += 1
        if any(effect.stage not in EACH_BY_ITSELF for effect, _ in self._order[first:]):
            # What comes after asks for more of the attitude than how it turns the field.
            by_axis = self.changes(at, _nudged(self._states[at]), [_NUDGE_RAD] * 3)
            return _of_the_compass(np.stack([one.mag_mgauss for one in by_axis], axis=2) @ turns, by_axis[0])
        state = self._states[first]
        s = state.stimulus
        # R exp(v x) sees B as R' (B + B x v).
        mag = s.rotation.transpose(0, 2, 1) @ (cross_matrices(s.field_ned_mgauss) @ turns)
        return _of_the_compass(mag if first == count else self._matrix(first) @ mag, state.reading)

    def shifted(self, at: int, shifts_m: FloatArray) -> list[Reading]:
        """Return the changes when the places before member `at` are shifted, (N, 3, k)."""
        state = self._states[at]
        s = state.stimulus
        if not any(effect.needs & PLACED for effect, _ in self._order[at:]):
            return _of_the_compass(np.zeros_like(shifts_m), state.reading)
        nudged = [
            Signals(replace(s, position_ned_m=s.position_ned_m + axis), state.reading)
            for axis in _NUDGE_M * np.eye(3)
        ]
        by_axis = self.changes(at, nudged, [_NUDGE_M] * 3)
        slopes = np.stack([one.mag_mgauss for one in by_axis], axis=2)
        return _of_the_compass(slopes @ shifts_m, state.reading)

    def seen(self, roughly: FloatArray) -> FloatArray:
        """Return how the compass sees a small change of the world's field at last, (3, 3) or (N, 3, 3).

        Where no matrix of each row tells, that is what is `roughly` known, (3, 3).
        """
        first = sum(effect.stage in _TURNING for effect, _ in self._order)
        rest = self._order[first:]
        if not rest:
            return np.eye(3)
        if any(effect.stage not in EACH_BY_ITSELF for effect, _ in rest):
            return roughly
        matrix = self._matrix(first)
        return matrix[0] if np.abs(matrix - matrix[0]).max() < _ALIKE else matrix

    def _matrix(self, at: int) -> FloatArray:
        """Return the derivative of the prediction by the compass's reading before member `at`, (N, 3, 3)."""
        if at not in self._matrices:
            effect, place = self._order[at]
            state, end = self._states[at], self._states[at + 1].reading.mag_mgauss
            nudged = (
                effect.forward(state.with_mag(state.reading.mag_mgauss + axis), self._thetas[place], {}, None)
                for axis in _NUDGE_MGAUSS * np.eye(3)
            )
            own = np.stack([(one.reading.mag_mgauss - end) / _NUDGE_MGAUSS for one in nudged], axis=2)
            last = at + 1 == len(self._order)
            self._matrices[at] = own if last else self._matrix(at + 1) @ own
        return self._matrices[at]
