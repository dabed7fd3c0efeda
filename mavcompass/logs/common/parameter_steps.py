"""From the parameters seen in a recording to the corrections in force, with their times."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass

from mavcompass.compass_parameters import (
    PER_MOTOR,
    PER_MOTOR_NAMES,
    PX4_BOARD,
    ardupilot_correction,
    ardupilot_correction_names,
    ardupilot_naming,
    px4_correction,
    px4_name,
)
from mavcompass.correction import IDENTITY, FieldCorrection
from mavcompass.track import InForce

_UNKNOWN = ((InForce(-math.inf, IDENTITY),), False)


@dataclass(frozen=True, slots=True)
class Seen:
    """Say that a parameter was seen to have a value.

    `announced` is True where the vehicle said so because it had just been set (then it holds from this
    time on), False where it was merely read (then it may have held for longer).
    """

    time_s: float
    name: str
    value: float
    announced: bool = False
    power_up: int = 0


@dataclass(frozen=True, slots=True)
class Change:
    """Say that a parameter has a value from a time on; minus infinity for before the recording."""

    from_s: float
    name: str
    value: float


def changes(seen: Iterable[Seen], power_up_s: Sequence[float]) -> tuple[Change, ...]:
    """Reduce what was seen, in the recording's order, to the changes, in order of time.

    What was set again to the same value is kept: it may take effect only then (see `ulog.in_force`).
    The first value of a parameter also held before it was seen. A value that is merely read after a
    restart and differs from the one before held since that restart: `power_up_s` are their times.
    """
    last: dict[str, float] = {}
    read_in: dict[str, int] = {}
    out: list[Change] = []
    for one in seen:
        if not math.isfinite(one.value):
            continue
        first_here = read_in.get(one.name) != one.power_up
        read_in[one.name] = one.power_up
        if one.name not in last:
            out.append(Change(-math.inf, one.name, one.value))
        elif last[one.name] != one.value or one.announced:
            since_restart = first_here and not one.announced
            from_s = power_up_s[one.power_up] if since_restart else one.time_s
            out.append(Change(from_s, one.name, one.value))
        last[one.name] = one.value
    return tuple(sorted(out, key=lambda change: change.from_s))


def ardupilot_steps(history: Sequence[Change], instance: int) -> tuple[tuple[InForce, ...], bool]:
    """Return ArduPilot's corrections of one compass over time, and whether they are known and possible."""
    final = {change.name: change.value for change in history}
    names = {*ardupilot_correction_names(instance, ardupilot_naming(final)), "COMPASS_MOTCT"}
    names |= {PER_MOTOR, *PER_MOTOR_NAMES} if instance == 1 else set()
    offsets = ardupilot_correction_names(instance, ardupilot_naming(final))[:3]
    known = all(name in final for name in offsets)
    return _steps(history, names, known, lambda values: ardupilot_correction(values, instance))


def px4_steps(history: Sequence[Change], instance: int) -> tuple[tuple[InForce, ...], bool]:
    """Return PX4's corrections of one compass over time, and whether they are known and possible."""
    prefix = px4_name("", instance)
    own = {change.name for change in history if change.name.startswith(prefix)}
    known = all(px4_name(f"{axis}OFF", instance) in own for axis in "XYZ")
    names = own | {"CAL_MAG_COMP_TYP", *PX4_BOARD}
    try:
        return _steps(history, names, known, lambda values: px4_correction(values, instance))
    except ValueError:  # numbers beyond all reckoning
        return _UNKNOWN


def unknown_correction(instance: int) -> str:
    """Tell that the correction inside a compass's readings is not known."""
    return (
        f"The parameters of compass {instance} are not in the recording, or no compass can have them: its "
        "readings are taken as they are, with whatever correction was inside them."
    )


def _steps(
    history: Sequence[Change],
    names: set[str],
    known: bool,
    correct: Callable[[Mapping[str, float]], FieldCorrection],
) -> tuple[tuple[InForce, ...], bool]:
    """Build the corrections in force; one that no compass can have makes all that was in force unknown."""
    values: dict[str, float] = {}
    moments: dict[float, FieldCorrection] = {-math.inf: IDENTITY}
    for change in history:
        if change.name in names:
            values[change.name] = change.value
            moments[change.from_s] = correct(values)
    out: list[InForce] = []
    for from_s, correction in moments.items():
        if not out or out[-1].correction != correction:
            out.append(InForce(from_s, correction))
    return (tuple(out), known) if all(step.correction.possible for step in out) else _UNKNOWN
