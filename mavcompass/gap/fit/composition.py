"""The simulation that a hypothesis makes of a replay: nuisances and effects in order, and its derivatives.

Derivatives are differences of the forward models: each parameter runs the composition again from its own
stage on. What an attitude may be off by, and a common delay, are reckoned once for all columns.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from mavcompass.frames import FloatArray, rotate_back
from mavcompass.gap.attitude import Reference, about_down, cross_matrices
from mavcompass.gap.fit.hypothesis import Term
from mavcompass.gap.replay import (
    REFERENCE_YAW,
    TELEMETRY_AGE,
    WHEREABOUTS,
    Nuisance,
    Replay,
    group_values,
    turned,
)
from mavcompass.simulation.effects.causes.timing import followed, late, late_beside, late_field, turned_since
from mavcompass.simulation.effects.effect import EACH_BY_ITSELF, PLACED, Effect, Group, Signals, Stage
from mavcompass.simulation.physics.signals import Reading, RecordedStimulus

_STEP = 1e-3
_NUDGE_RAD, _NUDGE_M = 1e-5, 1e-4
_NUDGE_MGAUSS = 0.01
# Matrices that differ by so little are alike; by so much they count.
_ALIKE, _APART = 1e-9, 0.03
# Stages whose changes turn with the vehicle.
_TURNING = frozenset({Stage.ATTITUDE, Stage.WORLD})
# What makes readings late.
_SMOOTHING = "low_pass"
_LATE = frozenset({"transport_lag", TELEMETRY_AGE, _SMOOTHING})

# Changes of a prediction by k parameters, of the compass and other sensors that are replayed, (N, 3, k).
Changes = dict[Group, FloatArray]


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
    curves = reference.curves_rad
    beside = np.broadcast_to(reference.with_yaw, (len(curves), 3))[:, :, None]
    turns = about_down(yaw_rad) @ np.concatenate([beside, curves], axis=2)
    turns[:, 2, 0] += 1.0
    return turns


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
    ) -> Changes:  # fmt: skip
        """Return the derivatives of the prediction by the free parameters of some members, in their order;
        nothing where there are none."""
        everything = [*nuisance_thetas, *thetas]
        order = self._ordered(terms, everything)
        places = {place: at for at, (_, place) in enumerate(order)}
        # What makes late is the same for all that comes before it: once for all columns.
        late = _late_members(order)
        after, behind = (
            _After(order[some], everything, states[some.start :][: len(order[some]) + 1], self.replay.groups)
            for some in (slice(0, late.start), slice(late.stop, len(order)))
        )
        parts: list[Changes] = []
        # Of each column the member whose derivative it is; the first of three of an attitude's turns.
        made_by: list[int] = []
        by_axis: int | None = None
        for place in wanted:
            at, free = places[place], self.free(terms, place)
            if not free.size:
                continue
            effect, theta = order[at][0], everything[place]
            together = _together(order, at)
            if effect.id == REFERENCE_YAW:
                turns, by_axis = _turns(self.replay.reference, float(theta[0])), len(made_by)
                part = after.turned(at + 1)
            elif effect.id == WHEREABOUTS:
                part = after.shifted(at + 1, self.replay.place_curves_m)
            elif len(together) > 1:
                step, at = _STEP * float(effect.parameters[0].scale), together[-1]
                later = [*everything[:place], theta + step, *everything[place + 1 :]]
                then = _made_late(states[together[0]], [order[i] for i in together], later)
                part = after.between([then.reading], states[at + 1].reading, [step])
            elif effect.slopes is not None and at < late.start and after.by_itself(at + 1):
                part = after.of_readings(at + 1, effect.slopes(states[at], theta)[:, :, free])
            else:
                moved, steps = _moved(effect, theta, free, states[at])
                if at < late.start:
                    part = after.changes(at + 1, moved, steps)
                elif at >= late.stop:
                    part = behind.changes(at + 1 - late.stop, moved, steps)
                else:
                    part = after.between([one.reading for one in moved], states[at + 1].reading, steps)
            parts.append(part)
            made_by += [at] * part["mag"].shape[2]
        changes = {g: np.concatenate([part[g] for part in parts], axis=2) for g in after.groups if parts}
        if parts and late:
            mag, by = changes["mag"], np.array(made_by)
            stages = [order[at][0].stage if at < late.start else None for at in made_by]
            lateness = _lateness(order[late.start : late.stop], everything)
            self._make_late(mag, stages, lateness, states[late.start], after)
            if late.stop < len(order):
                mag[:, :, by < late.stop] = behind.through(0, mag[:, :, by < late.stop])
        if by_axis is None:
            return changes
        # What an attitude is off by at a reading, it is off by when that was taken.
        ends = (by_axis, by_axis + 3)
        split = {g: np.split(values, ends, axis=2) for g, values in changes.items()}
        return {g: np.concatenate([x, axes @ turns, y], axis=2) for g, (x, axes, y) in split.items()}

    def _make_late(
        self,
        mag_mgauss: FloatArray,
        stages: Sequence[Stage | None],
        lateness: tuple[float, float],
        before: Signals,
        after: _After,
    ) -> None:
        """Delay and smooth changes (N, 3, k) of the reading `before`, in place, by the stages that they are
        of.

        Those of attitude and world's field turn with the vehicle, as the compass sees them.
        """
        s = before.stimulus
        assert isinstance(s, RecordedStimulus)
        delay_s, time_constant_s = lateness
        wanted_s = s.time_s - delay_s
        back = turned_since(s.turning, wanted_s, time_constant_s).transpose(0, 2, 1)
        world = rotate_back(s.rotation, s.field_ned_mgauss)
        if turning := [i for i, stage in enumerate(stages) if stage in _TURNING]:
            follows = np.eye(3) + followed(world, before.reading.mag_mgauss - world).T
            seen = after.seen(follows)
            stacked = np.linalg.inv(seen) @ mag_mgauss[:, :, turning]
            apart = (seen - follows) @ stacked if np.abs(seen - follows).max() > _APART else None
            if moving := [n for n, i in enumerate(turning) if stages[i] is Stage.WORLD]:
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
            mag_mgauss[:, :, turning] = stacked
        if rest := [i for i, stage in enumerate(stages) if stage is not None and stage not in _TURNING]:
            flat = mag_mgauss[:, :, rest].reshape(len(world), -1)
            late_ned = late(s.time_s, s.field_ned_mgauss, wanted_s, time_constant_s)
            then = np.matmul(back, rotate_back(s.rotation, late_ned)[:, :, None])[:, :, 0]
            flat = late_beside(s.time_s, world, then, flat, wanted_s, time_constant_s)
            mag_mgauss[:, :, rest] = flat.reshape(len(world), 3, -1)


def _moved(
    effect: Effect, theta: FloatArray, free: NDArray[np.int64], before: Signals
) -> tuple[list[Signals], list[float]]:
    """Return what an effect makes of signals with each of its free parameters moved by a small step."""
    moved, steps = [], []
    for j in free:
        beside = theta.copy()
        step = _STEP * max(effect.parameters[j].scale, 1e-12)
        if beside[j] + step > effect.parameters[j].high:
            step = -step
        beside[j] += step
        moved.append(effect.forward(before, beside, {}, None))
        steps.append(step)
    return moved, steps


def _late_members(order: Sequence[tuple[Effect, int]]) -> range:
    """Return the members that make readings late, where what follows them is the sensor's alone; none at the
    end of all others."""
    late = [at for at, (effect, _) in enumerate(order) if effect.id in _LATE]
    if not late or any(effect.stage is not Stage.SENSOR for effect, _ in order[late[-1] + 1 :]):
        return range(len(order), len(order))
    return range(late[0], late[-1] + 1)


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
    """Carry changes through the members of a composition that come after them, for some sensors."""

    def __init__(
        self,
        order: list[tuple[Effect, int]],
        thetas: list[FloatArray],
        states: list[Signals],
        groups: tuple[Group, ...],
    ) -> None:
        self._order, self._thetas, self._states = order, thetas, states
        self.groups: tuple[Group, ...] = ("mag", *(g for g in groups if g != "mag"))
        # Where every reading is changed by itself, the rest is a matrix, of each row or of all.
        self._matrices: dict[int, FloatArray] = {}

    def by_itself(self, at: int) -> bool:
        """Tell whether the members from `at` on change every reading of the compass by itself."""
        return all(effect.stage in EACH_BY_ITSELF for effect, _ in self._order[at:])

    def between(self, after: Sequence[Reading], before: Reading, steps: Sequence[float]) -> Changes:
        """Return how readings differ from one, over their steps."""
        return {
            g: (np.stack([group_values(a, g) for a in after], axis=2) - group_values(before, g)[:, :, None])
            / np.asarray(steps)
            for g in self.groups
        }

    def changes(self, at: int, moved: Sequence[Signals], steps: Sequence[float]) -> Changes:
        """Return the changes of the prediction when the signals before member `at` are moved by steps."""
        before, rest = self._states[at], self._order[at:]
        # What comes after asks the world for its attitude at most, and the compass for the rest.
        same = all(one.stimulus.rotation is before.stimulus.rotation for one in moved)
        if same and self.by_itself(at):
            own = self.between([one.reading for one in moved], before.reading, steps)
            return own | {"mag": self.through(at, own["mag"])}
        ends = []
        for one in moved:
            for effect, place in rest:
                one = effect.forward(one, self._thetas[place], {}, None)
            ends.append(one.reading)
        return self.between(ends, self._states[-1].reading, steps)

    def through(self, at: int, mag_mgauss: FloatArray) -> FloatArray:
        """Return what members from `at` on make of changes of the compass (N, 3, k)."""
        return mag_mgauss if at == len(self._order) else np.asarray(self._matrix(at) @ mag_mgauss)

    def of_readings(self, at: int, mag_mgauss: FloatArray) -> Changes:
        """Return the changes when the compass's reading before member `at` alone is changed, (N, 3, k)."""
        none = {g: np.zeros_like(mag_mgauss) for g in self.groups if g != "mag"}
        return none | {"mag": self.through(at, mag_mgauss)}

    def turned(self, at: int) -> Changes:
        """Return the changes by the attitude before member `at`, per turn about each of the world's axes."""
        first, count = at, len(self._order)
        while first < count and self._order[first][0].stage is Stage.WORLD:
            first += 1
        if not self.by_itself(first):
            # What comes after asks for more of the attitude than how it turns the field.
            by_axis = self.changes(at, _nudged(self._states[at]), [_NUDGE_RAD] * 3)
            return self.of_readings(count, by_axis["mag"])
        s = self._states[first].stimulus
        # R exp(v x) sees B as R' (B + B x v).
        return self.of_readings(first, s.rotation.transpose(0, 2, 1) @ cross_matrices(s.field_ned_mgauss))

    def shifted(self, at: int, shifts_m: FloatArray) -> Changes:
        """Return the changes when the places before member `at` are shifted, (N, 3, k)."""
        state = self._states[at]
        s = state.stimulus
        if not any(effect.needs & PLACED for effect, _ in self._order[at:]):
            return self.of_readings(len(self._order), np.zeros_like(shifts_m))
        nudged = [
            Signals(replace(s, position_ned_m=s.position_ned_m + axis), state.reading)
            for axis in _NUDGE_M * np.eye(3)
        ]
        by_axis = self.changes(at, nudged, [_NUDGE_M] * 3)
        return self.of_readings(len(self._order), by_axis["mag"] @ shifts_m)

    def seen(self, roughly: FloatArray) -> FloatArray:
        """Return how the compass sees a small change of the world's field at last, (3, 3) or (N, 3, 3).

        Where no matrix of each row tells, that is what is `roughly` known, (3, 3).
        """
        first = sum(effect.stage in _TURNING for effect, _ in self._order)
        if first == len(self._order):
            return np.eye(3)
        if not self.by_itself(first):
            return roughly
        matrix = self._matrix(first)
        alike = matrix.ndim == 3 and np.abs(matrix - matrix[0]).max() < _ALIKE
        return matrix[0] if alike else matrix

    def _matrix(self, at: int) -> FloatArray:
        """Return the derivative of the prediction by the compass's reading before member `at`, (3, 3) or
        (N, 3, 3)."""
        if at not in self._matrices:
            own = self._own_matrix(at)
            last = at + 1 == len(self._order)
            self._matrices[at] = own if last else self._matrix(at + 1) @ own
        return self._matrices[at]

    def _own_matrix(self, at: int) -> FloatArray:
        (effect, place), state = self._order[at], self._states[at]
        if effect.stage is Stage.FIELD:
            # It adds a field, whatever the reading is.
            return np.eye(3)
        mag = state.reading.mag_mgauss[:1] if effect.affine else state.reading.mag_mgauss
        ends = [
            effect.forward(state.with_mag(mag + axis), self._thetas[place], {}, None).reading.mag_mgauss
            for axis in (*(_NUDGE_MGAUSS * np.eye(3)), np.zeros(3))
        ]
        own = (np.stack(ends[:3], axis=2) - ends[3][:, :, None]) / _NUDGE_MGAUSS
        return own[0] if effect.affine else own
