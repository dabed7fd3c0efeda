"""What figures may take back: a name beside a yaw that has to wander keeps a remainder."""

from __future__ import annotations

import math
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from mavcompass.gap.answer.settled import Settled, _Settling, yaw_wander_deg
from mavcompass.gap.answer.verdict import Answer
from mavcompass.gap.attitude import Reference
from mavcompass.gap.fit import Fit, Term
from mavcompass.gap.replay import REFERENCE_YAW
from mavcompass.gap.result import Closing, Verdict
from mavcompass.simulation.effects import catalogue

_N = 50


def problem(witnessed: bool) -> Any:
    """Return a problem whose yaw may wander by one degree for each unit of its only curve."""
    curves = np.zeros((_N, 3, 1))
    curves[:, 2] = math.radians(1.0)
    known = np.ones(_N, dtype=np.bool_)
    reference = Reference(
        "fused", np.tile(np.eye(3), (_N, 1, 1)), np.zeros((_N, 3)), known, curves_rad=curves,
        witnessed=witnessed,
    )  # fmt: skip
    nuisance = SimpleNamespace(effect=SimpleNamespace(id=REFERENCE_YAW))
    return SimpleNamespace(replay=SimpleNamespace(reference=reference), nuisances=(nuisance,), usable=known)


def fit(wander: float, named: bool = True) -> Fit:
    effect = catalogue()["hard_iron"]
    term = Term(effect, np.ones(3, dtype=np.bool_), effect.lower, effect.upper)
    return Fit((term,) * named, (np.zeros(3),) * named, (np.array([0.0, wander]),), 10.0)


def said(verdict: Verdict, one: Fit) -> Settled:
    closing = Closing(20.0, 2.0, 2.0, 0.9, (0.8, 1.0))
    return Settled(Answer(verdict, one, False, None), closing, closing)


@pytest.mark.parametrize(
    ("wander", "witnessed", "measured", "told"),
    [
        (9.0, False, False, "named_with_remainder"),
        (1.0, False, False, "named"),
        (9.0, True, False, "named"),
        (9.0, False, True, "named"),
    ],
)
def test_a_name_keeps_a_remainder_where_no_heading_bears_it_out(
    wander: float, witnessed: bool, measured: bool, told: Verdict
) -> None:
    settling: Any = object.__new__(_Settling)
    settling._problem, settling._floor = problem(witnessed), SimpleNamespace(measured=measured)
    after = settling.beside_its_attitude(said("named", fit(wander))).answer
    assert after.verdict == told and after.flagged == (told == "named_with_remainder")


@pytest.mark.parametrize("verdict", ["no_gap", "ambiguous", "unknown", "not_testable"])
def test_who_is_not_sure_of_a_name_says_the_same_beside_a_yaw_that_wanders(verdict: Verdict) -> None:
    settling: Any = object.__new__(_Settling)
    settling._problem, settling._floor = problem(False), SimpleNamespace(measured=False)
    before = said(verdict, fit(9.0, named=verdict == "ambiguous"))
    assert settling.beside_its_attitude(before) is before


def test_the_yaw_wanders_as_its_curves_say() -> None:
    heading = said("named", fit(9.0)).heading

    def wander_deg(witnessed: bool, measured: bool, wander: float = 9.0) -> float:
        floor: Any = SimpleNamespace(measured=measured)
        return yaw_wander_deg(problem(witnessed), fit(wander), floor, heading)

    assert wander_deg(witnessed=False, measured=False) == pytest.approx(9.0)
    assert wander_deg(witnessed=True, measured=False) == 0.0
    assert wander_deg(witnessed=False, measured=True) == 0.0, "a baseline tells"
    assert wander_deg(witnessed=False, measured=False, wander=1.0) == 0.0, "no more than the floor"


@pytest.mark.parametrize(
    ("verdict", "floor_deg", "measured", "told"),
    [
        ("no_gap", 15.1, False, "not_testable"),
        ("no_gap", 14.9, False, "no_gap"),
        ("no_gap", 25.0, True, "no_gap"),
        ("unknown", 25.0, False, "unknown"),
    ],
)
def test_silence_tells_nothing_where_hardly_any_heading_shows(
    verdict: Verdict, floor_deg: float, measured: bool, told: Verdict
) -> None:
    settling: Any = object.__new__(_Settling)
    settling._floor = SimpleNamespace(measured=measured)
    heading = Closing(1.0, 1.0, floor_deg, 0.0, (0.0, 0.0))
    one = Settled(Answer(verdict, fit(0.0, named=False), False, None), heading, heading)
    assert settling.as_far_as_it_shows(one).answer.verdict == told
