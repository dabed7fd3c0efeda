"""The simulation that a hypothesis makes of a replay: nuisances and effects in order, and its derivatives.

They are differences: each parameter runs the composition again
from its own stage on. What an attitude may be off by, and a common delay, are reckoned once for all columns.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from mavcompass.frames import FloatArray, euler_to_matrix
from mavcompass.gap.attitude.reference import Reference
from mavcompass.gap.fit.hypothesis import Fit, Term
from mavcompass.gap.replay.noise import group_values
from mavcompass.gap.replay.nominal import Replay
from mavcompass.gap.replay.nuisance import REFERENCE_YAW, TELEMETRY_AGE, Prior, turned
from mavcompass.simulation.effects.causes.timing import late, late_field
from mavcompass.simulation.effects.effect import EACH_BY_ITSELF, LAG, SMOOTHING, Effect, Group, Signals, Stage
from mavcompass.simulation.physics.signals import Reading

# Effects in the order in which they act, with their places in the list of parameters.
Order = Sequence[tuple[Effect, int]]


def together(order: Order, at: int) -> range:
    """Return the members that are reckoned with member `at`: those that make readings late are one.

    One after the other they would interpolate what was interpolated, and a fit between them would stick.
    """
    first, end = at, at + 1
    if _is_late(order[at][0]):
        while first and _is_late(order[first - 1][0]):
            first -= 1
        while end < len(order) and _is_late(order[end][0]):
            end += 1
    return range(first, end)


def late_members(order: Order) -> range:
    """Return the members that make readings late, where what follows them is the sensors' alone; none at the
    end of all others."""
    late = [at for at, (effect, _) in enumerate(order) if _is_late(effect)]
    if not late or any(effect.stage < Stage.SENSOR for effect, _ in order[late[-1] + 1 :]):
        return range(len(order), len(order))
    return range(late[0], late[-1] + 1)


def _is_late(effect: Effect) -> bool:
    """Tell what delays or smooths readings, and nothing else."""
    return effect.id == TELEMETRY_AGE or LAG in effect.names or SMOOTHING in effect.names


def lateness(members: Order, everything: Sequence[FloatArray]) -> tuple[float, float]:
    """Return by how many seconds members delay readings, and the time constant by which they smooth them."""
    each = [(SMOOTHING in effect.names, float(everything[place][0])) for effect, place in members]
    return sum(s for smooths, s in each if not smooths), sum(s for smooths, s in each if smooths)


def made_late(before: Signals, members: Order, everything: Sequence[FloatArray]) -> Signals:
    """Return signals as several members make them late together."""
    delay_s, time_constant_s = lateness(members, everything)
    wanted_s = before.stimulus.time_s - delay_s
    return before.with_mag(late_field(before, wanted_s, time_constant_s=time_constant_s))


def after(order: Order, everything: Sequence[FloatArray], states: Sequence[Signals], at: int) -> Signals:
    """Return the signals after member `at`, of those before it and all before."""
    (effect, place), late = order[at], together(order, at)
    if len(late) == 1:
        return effect.forward(states[at], everything[place], {}, None)
    # What is late and is made later waits for that.
    return (
        made_late(states[late.start], [order[i] for i in late], everything) if at == late[-1] else states[at]
    )


def make_changes_late(mag_mgauss: FloatArray, time_s: FloatArray, by_s: tuple[float, float]) -> FloatArray:
    """Return changes of readings (N, 3, k) as late as `lateness` says readings are, and as smooth.

    They are interpolated in the body's axes: between two rows a vehicle turns too little for a derivative to
    tell that from turning with it.
    """
    delay_s, time_constant_s = by_s
    flat = mag_mgauss.reshape(len(mag_mgauss), -1)
    return late(time_s, flat, time_s - delay_s, time_constant_s).reshape(mag_mgauss.shape)


_STEP = 1e-3
_NUDGE_RAD = 1e-5
_NUDGE_MGAUSS = 0.01

# Changes of a prediction by k parameters, of the compass and other sensors that are replayed, (N, 3, k).
Changes = dict[Group, FloatArray]


class Derivatives:
    """Collect columns of a prediction's derivatives, and make those late together that are made before."""

    def __init__(
        self, replay: Replay, order: Order, thetas: Sequence[FloatArray], states: Sequence[Signals]
    ) -> None:
        """Differentiate about the `states` before the first member of a composition and after each."""
        self._replay, self._order, self._thetas, self._states = replay, order, thetas, states
        self._late = late_members(order)
        self._groups: tuple[Group, ...] = ("mag", *(g for g in replay.groups if g != "mag"))
        # Where every reading is changed by itself, the rest is a matrix, of each row or of all.
        self._matrices: dict[int, FloatArray] = {}
        self._parts: list[Changes] = []
        # Of each column the state that it is a change of.
        self._then: list[int] = []
        # The first of three columns of an attitude's turns about the axes, and how it may turn.
        self._turns: tuple[int, FloatArray] | None = None

    def by_member(self, at: int, free: NDArray[np.int64]) -> None:
        """Add the derivatives by the free parameters of member `at`."""
        effect, place = self._order[at]
        theta, then, late = self._thetas[place], at + 1, together(self._order, at)
        if not free.size:
            return
        if effect.id == REFERENCE_YAW:
            self._turns = len(self._then), _turns(self._replay.reference, float(theta[0]))
            part = self._turned(then)
        elif len(late) > 1:
            step, then = _STEP * float(effect.parameters[0].scale), late.stop
            later = [*self._thetas[:place], theta + step, *self._thetas[place + 1 :]]
            moved = made_late(self._states[late.start], [self._order[i] for i in late], later)
            part = self._between([moved.reading], self._states[then].reading, [step])
        else:
            part = self._by_parameters(effect, theta, free, at)
        self._parts.append(part)
        self._then += [then] * part["mag"].shape[2]

    def changes(self) -> Changes:
        """Return all columns in the order in which they were added; nothing where there are none."""
        if not self._parts:
            return {}
        changes = {g: np.concatenate([part[g] for part in self._parts], axis=2) for g in self._groups}
        late, then, mag = self._late, np.array(self._then), changes["mag"]
        if (early := then <= late.start).any() and late:
            by_s = lateness([self._order[i] for i in late], self._thetas)
            mag[:, :, early] = make_changes_late(mag[:, :, early], self._replay.time_s, by_s)
        if late.stop < len(self._order):
            behind = then <= late.stop
            mag[:, :, behind] = self._through(late.stop, mag[:, :, behind])
        return self._with_curves(changes)

    def _with_curves(self, changes: Changes) -> Changes:
        """Put the curves of an attitude in the place of its turns about the axes.

        What an attitude is off by at a reading, it is off by when that was taken.
        """
        if self._turns is None:
            return changes
        first, turns = self._turns
        split = {g: np.split(values, (first, first + 3), axis=2) for g, values in changes.items()}
        return {g: np.concatenate([x, axes @ turns, y], axis=2) for g, (x, axes, y) in split.items()}

    def _by_parameters(self, effect: Effect, theta: FloatArray, free: NDArray[np.int64], at: int) -> Changes:
        """Return the changes by the free parameters of an effect that acts on state `at`."""
        moved, steps = [], []
        for j in free:
            beside = theta.copy()
            step = _STEP * max(effect.parameters[j].scale, 1e-12)
            if beside[j] + step > effect.parameters[j].high:
                step = -step
            beside[j] += step
            moved.append(effect.forward(self._states[at], beside, {}, None))
            steps.append(step)
        if at in self._late:
            return self._between([one.reading for one in moved], self._states[at + 1].reading, steps)
        return self._carried(at + 1, moved, steps)

    def _turned(self, at: int) -> Changes:
        """Return the compass's changes by the attitude before member `at`, per turn about each world axis."""
        count = self._replay.time_s.size
        axes = (np.broadcast_to(axis, (count, 3)) for axis in _NUDGE_RAD * np.eye(3))
        by_axis = self._carried(at, [turned(self._states[at], axis) for axis in axes], [_NUDGE_RAD] * 3)
        return {g: values if g == "mag" else np.zeros_like(values) for g, values in by_axis.items()}

    def _between(self, after: Sequence[Reading], before: Reading, steps: Sequence[float]) -> Changes:
        """Return how readings differ from one, over their steps."""
        return {
            g: (np.stack([group_values(a, g) for a in after], axis=2) - group_values(before, g)[:, :, None])
            / np.asarray(steps)
            for g in self._groups
        }

    def _end(self, at: int) -> int:
        """Return the member up to which changes before member `at` are carried: the first that is late."""
        return self._late.start if at <= self._late.start else len(self._order)

    def _carried(self, at: int, moved: Sequence[Signals], steps: Sequence[float]) -> Changes:
        """Return the changes that come of it when the signals before member `at` are moved by steps."""
        before, end = self._states[at], self._end(at)
        # What comes after asks the world for its attitude at most, and the compass for the rest.
        same = all(one.stimulus.rotation is before.stimulus.rotation for one in moved)
        if same and all(effect.stage in EACH_BY_ITSELF for effect, _ in self._order[at:end]):
            own = self._between([one.reading for one in moved], before.reading, steps)
            return own | {"mag": self._through(at, own["mag"])}
        ends = []
        for one in moved:
            states = [*self._states[:at], one]
            for later in range(at, end):
                states.append(after(self._order, self._thetas, states, later))
            ends.append(states[-1].reading)
        return self._between(ends, self._states[end].reading, steps)

    def _through(self, at: int, mag_mgauss: FloatArray) -> FloatArray:
        """Return what members from `at` on make of changes of the compass (N, 3, k)."""
        return mag_mgauss if at == self._end(at) else np.asarray(self._matrix(at) @ mag_mgauss)

    def _matrix(self, at: int) -> FloatArray:
        """Return the derivative of what is carried by the compass's reading before member `at`, (3, 3) or
        (N, 3, 3)."""
        if at not in self._matrices:
            own, last = self._own_matrix(at), at + 1 == self._end(at)
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


def _turns(reference: Reference, yaw_rad: float) -> FloatArray:
    """Return the turns in world axes, (N, 3, 1 + k), by a constant of the yaw and by curves.

    The curves' frame is turned by that yaw.
    """
    curves = reference.curves_rad
    beside = np.broadcast_to(reference.with_yaw, (len(curves), 3))[:, :, None]
    turns = euler_to_matrix(0.0, 0.0, yaw_rad) @ np.concatenate([beside, curves], axis=2)
    turns[:, 2, 0] += 1.0
    return turns


class Composition:
    """Run nuisances and effects on a replay; places count the nuisances first, then the terms."""

    def __init__(self, replay: Replay, prior: Prior) -> None:
        self.replay = replay
        self._nuisances, self._places = prior.effects, list(prior.places.values())

    def free(self, terms: Sequence[Term], place: int) -> NDArray[np.int64]:
        """Return the places of the free parameters of a member."""
        n = len(self._nuisances)
        if place < n:
            return np.arange(len(self._nuisances[place].parameters))
        return np.flatnonzero(terms[place - n].free)

    def _ordered(self, fit: Fit) -> tuple[list[tuple[Effect, int]], list[FloatArray]]:
        """List the effects of the composition in order, with their places in the list of parameters, and
        that list."""
        everything = [*(fit.nuisances[at] for at in self._places), *fit.thetas]
        every = (*self._nuisances, *(term.effect for term in fit.terms))
        members = [(effect, place) for place, effect in enumerate(every)]
        # Sorting is stable: a nuisance acts before the effects of its stage.
        return sorted(members, key=lambda m: m[0].stage_at(everything[m[1]])), everything

    def states(self, fit: Fit, without_last: Sequence[Signals] = ()) -> list[Signals]:
        """Return the signals after each member of the composition, the replay's own first.

        `without_last` are those without the last of the terms, where they are known.
        """
        order, everything = self._ordered(fit)
        states = [self.replay.signals]
        if without_last:
            states = list(without_last[: 1 + [place for _, place in order].index(len(everything) - 1)])
        for at in range(len(states) - 1, len(order)):
            states.append(after(order, everything, states, at))
        return states

    def changes(self, fit: Fit, states: list[Signals], wanted: Sequence[int]) -> Changes:
        """Return the derivatives of the prediction by the free parameters of some members, in their order;
        nothing where there are none."""
        order, everything = self._ordered(fit)
        places = {place: at for at, (_, place) in enumerate(order)}
        derivatives = Derivatives(self.replay, order, everything, states)
        for place in wanted:
            derivatives.by_member(places[place], self.free(fit.terms, place))
        return derivatives.changes()
