"""What makes readings late, and how changes of a reading go along."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import cached_property

import numpy as np

from mavcompass.frames import FloatArray, rotate_back
from mavcompass.gap.replay.nuisance import TELEMETRY_AGE
from mavcompass.simulation.effects.causes.timing import followed, late, late_beside, late_field, turned_since
from mavcompass.simulation.effects.effect import LAG, SMOOTHING, Effect, Signals, Stage
from mavcompass.simulation.physics.signals import RecordedStimulus

# Matrices that differ by so much count.
_APART = 0.03
# Stages whose changes turn with the vehicle.
TURNING = frozenset({Stage.ATTITUDE, Stage.WORLD})
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
    """Return the members that make readings late, where what follows them is the sensor's alone; none at the
    end of all others."""
    late = [at for at, (effect, _) in enumerate(order) if _is_late(effect)]
    if not late or any(effect.stage is not Stage.SENSOR for effect, _ in order[late[-1] + 1 :]):
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


class Late:
    """Make changes of a reading late as readings are: by a delay, and smoothed by a time constant."""

    def __init__(
        self, before: Signals, by_s: tuple[float, float], seen_as: Callable[[FloatArray], FloatArray]
    ) -> None:
        """Take the signals `before`, and how the compass sees small changes of the world's field.

        `seen_as` tells the matrix of all (3, 3), or of each row (N, 3, 3), where one is roughly known.
        """
        assert isinstance(before.stimulus, RecordedStimulus)
        self._stimulus, self._reading, self._seen_as = before.stimulus, before.reading, seen_as
        delay_s, self._time_constant_s = by_s
        self._wanted_s = before.stimulus.time_s - delay_s
        self._world = rotate_back(before.stimulus.rotation, before.stimulus.field_ned_mgauss)

    @cached_property
    def _follows(self) -> FloatArray:
        """Return by which matrix (3, 3) readings follow the world's field in body axes, beside an offset."""
        return np.eye(3) + followed(self._world, self._reading.mag_mgauss - self._world).T

    @cached_property
    def _seen(self) -> FloatArray:
        return self._seen_as(self._follows)

    @cached_property
    def interpolates(self) -> bool:
        """Tell whether the compass sees a change of the field otherwise than its reading follows the field:
        that part does not turn with it, but is interpolated."""
        return bool(np.abs(self._seen - self._follows).max() > _APART)

    def make(self, mag_mgauss: FloatArray, stages: Sequence[Stage | None]) -> None:
        """Delay and smooth changes (N, 3, k) in place, by the stages that they are of.

        Those of attitude and world's field turn with the vehicle, as the compass sees them. Those without a
        stage stay.
        """
        s, world, wanted_s = self._stimulus, self._world, self._wanted_s
        back = turned_since(s.turning, wanted_s, self._time_constant_s).transpose(0, 2, 1)
        if turning := [i for i, stage in enumerate(stages) if stage in TURNING]:
            stacked = np.linalg.inv(self._seen) @ mag_mgauss[:, :, turning]
            apart = (self._seen - self._follows) @ stacked if self.interpolates else None
            if moving := [n for n, i in enumerate(turning) if stages[i] is Stage.WORLD]:
                # What differs from place to place changes as the vehicle moves, besides.
                placed = self._columns(s.rotation @ stacked[:, :, moving])
                stacked[:, :, moving] = s.rotation.transpose(0, 2, 1) @ placed
            stacked = back @ stacked
            if apart is None:
                stacked = self._seen @ stacked
            else:
                stacked = self._follows @ stacked + self._columns(apart)
            mag_mgauss[:, :, turning] = stacked
        if rest := [i for i, stage in enumerate(stages) if stage is not None and stage not in TURNING]:
            flat = mag_mgauss[:, :, rest].reshape(len(world), -1)
            late_ned = late(s.time_s, s.field_ned_mgauss, wanted_s, self._time_constant_s)
            then = np.matmul(back, rotate_back(s.rotation, late_ned)[:, :, None])[:, :, 0]
            flat = late_beside(s.time_s, world, then, flat, wanted_s, self._time_constant_s)
            mag_mgauss[:, :, rest] = flat.reshape(len(world), 3, -1)

    def _columns(self, columns: FloatArray) -> FloatArray:
        """Return columns (N, 3, k) at the other times, and smoothed."""
        flat = columns.reshape(len(columns), -1)
        made = late(self._stimulus.time_s, flat, self._wanted_s, self._time_constant_s)
        return made.reshape(columns.shape)
