"""Several compasses that disagree: which of them is wrong, by the others, the gyro and the world model.

A majority that agrees is believed, unless the gyro or the Earth's field contradicts all of it and bears the
one outside out. Without a majority, as with two compasses, the gyro's turn decides, then the Earth's field.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

from mavcompass.frames import wrap_pi


@dataclass(frozen=True, slots=True)
class Witness:
    """Hold what one compass shows; what is not known is nan.

    Attributes:
        heading_deg: under the correction in force; only differences count.
        dip_off_deg, strength_off_percent: its field less the Earth's here.
        turn_off_deg: a turn as it saw it less the gyro's.
    """

    instance: int
    heading_deg: float
    dip_off_deg: float = math.nan
    strength_off_percent: float = math.nan
    turn_off_deg: float = math.nan


@dataclass(frozen=True, slots=True)
class Tolerances:
    """Hold what counts as agreement: with another compass, the gyro's turn, the Earth's dip and strength."""

    apart_deg: float = 5.0
    turn_deg: float = 3.0
    dip_deg: float = 3.0
    strength_percent: float = 6.0


@dataclass(frozen=True, slots=True)
class Blame:
    """Say that a compass is wrong, and why.

    Attributes:
        instance: the compass; 0 where nothing tells which it is.
        apart_deg: its heading less that of those believed, in [-180, 180).
    """

    instance: int
    apart_deg: float
    why: str


def who_is_wrong(witnesses: Sequence[Witness], tolerances: Tolerances | None = None) -> tuple[Blame, ...]:
    """Return the compasses at fault; empty where all agree, one of instance 0 where nothing tells."""
    limits = tolerances or Tolerances()
    together = _largest_group(witnesses, limits.apart_deg)
    outside = [w for w in witnesses if w not in together]
    if not outside:
        return ()
    if 2 * len(together) > len(witnesses):
        contradicted = all(_contradicted(w, limits) for w in together)
        borne_out = [w for w in outside if _borne_out(w, limits)]
        if not (contradicted and borne_out):
            return tuple(_outvoted(w, together, limits) for w in outside)
    for judge in (_by_turn, _by_world):
        wrong = [w for w in witnesses if judge(w, limits) is False]
        right = [w for w in witnesses if judge(w, limits) is True]
        if wrong and right and len(wrong) + len(right) == len(witnesses):
            return tuple(_convicted(w, right, limits) for w in wrong)
    first, *others = witnesses
    farthest = max(others, key=lambda w: abs(_apart_deg(w, [first])))
    apart_deg = _apart_deg(farthest, [first])
    names = _names(witnesses)
    return (
        Blame(
            0,
            apart_deg,
            f"Compasses {names} point {abs(apart_deg):.0f} deg apart; a turn tells which is wrong.",
        ),
    )


def _largest_group(witnesses: Sequence[Witness], within_deg: float) -> list[Witness]:
    """Return the most compasses that agree with each other; of as many, the first."""
    groups = [[w for w in witnesses if abs(_apart_deg(w, [middle])) <= within_deg] for middle in witnesses]
    return max(groups, key=len, default=[])


def _apart_deg(one: Witness, others: Sequence[Witness]) -> float:
    """Return one heading less the mean of others."""
    first = math.radians(others[0].heading_deg)
    mean = first + sum(_wrap(math.radians(w.heading_deg) - first) for w in others) / len(others)
    return math.degrees(_wrap(math.radians(one.heading_deg) - mean))


def _wrap(angle_rad: float) -> float:
    return float(wrap_pi(angle_rad))


def _by_turn(w: Witness, limits: Tolerances) -> bool | None:
    """Tell whether the gyro bears a compass out; None where there was no turn."""
    return None if math.isnan(w.turn_off_deg) else abs(w.turn_off_deg) <= limits.turn_deg


def _by_world(w: Witness, limits: Tolerances) -> bool | None:
    """Tell whether the Earth's field bears a compass out; None where the place is not known."""
    if math.isnan(w.dip_off_deg + w.strength_off_percent):
        return None
    return abs(w.dip_off_deg) <= limits.dip_deg and abs(w.strength_off_percent) <= limits.strength_percent


def _contradicted(w: Witness, limits: Tolerances) -> bool:
    return _by_turn(w, limits) is False or (_by_turn(w, limits) is None and _by_world(w, limits) is False)


def _borne_out(w: Witness, limits: Tolerances) -> bool:
    return _by_turn(w, limits) is not False and _by_world(w, limits) is True


def _outvoted(w: Witness, together: Sequence[Witness], limits: Tolerances) -> Blame:
    within_deg = max(abs(_apart_deg(a, [b])) for a in together for b in together)
    apart_deg = _apart_deg(w, together)
    bears_out = ""
    if all(_by_world(other, limits) for other in together):
        bears_out = " and with the Earth's dip and strength"
    elif all(_by_turn(other, limits) for other in together):
        bears_out = " and with the gyro"
    agree = f"{_names(together)} agree with each other within {max(within_deg, 0.1):.1f} deg{bears_out}"
    return Blame(w.instance, apart_deg, f"Compass {w.instance} is off by {abs(apart_deg):.0f} deg: {agree}.")


def _convicted(w: Witness, right: Sequence[Witness], limits: Tolerances) -> Blame:
    apart_deg, others = _apart_deg(w, right), _names(right)
    if _by_turn(w, limits) is False:
        why = f"its turn is {abs(w.turn_off_deg):.0f} deg another than the gyro's, that of {others} is not"
    else:
        why = (
            f"its field is {abs(w.dip_off_deg):.0f} deg in dip and {abs(w.strength_off_percent):.0f} % in"
            f" strength off the Earth's, and that of {others} fits"
        )
    return Blame(w.instance, apart_deg, f"Compass {w.instance} is off by {abs(apart_deg):.0f} deg: {why}.")


def _names(witnesses: Sequence[Witness]) -> str:
    numbers = [str(w.instance) for w in witnesses]
    return " and ".join([", ".join(numbers[:-1]), numbers[-1]] if len(numbers) > 1 else numbers)
