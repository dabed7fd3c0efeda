"""What makes readings late, and how changes of a reading go along."""

from __future__ import annotations

from collections.abc import Sequence

from mavcompass.frames import FloatArray
from mavcompass.gap.replay.nuisance import TELEMETRY_AGE
from mavcompass.simulation.effects.causes.timing import late, late_field
from mavcompass.simulation.effects.effect import LAG, SMOOTHING, Effect, Signals, Stage

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


def make_changes_late(mag_mgauss: FloatArray, time_s: FloatArray, by_s: tuple[float, float]) -> FloatArray:
    """Return changes of readings (N, 3, k) as late as `lateness` says readings are, and as smooth.

    They are interpolated in the body's axes: between two rows a vehicle turns too little for a derivative to
    tell that from turning with it.
    """
    delay_s, time_constant_s = by_s
    flat = mag_mgauss.reshape(len(mag_mgauss), -1)
    return late(time_s, flat, time_s - delay_s, time_constant_s).reshape(mag_mgauss.shape)
