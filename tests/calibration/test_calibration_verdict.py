"""Accepting and refusing a four-position fit: each rule at its limit, with its figures."""

from __future__ import annotations

import math
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from mavcompass.calibration.findings import judge, share_words
from mavcompass.calibration.model import GAIN, HORIZONTAL
from mavcompass.calibration.positions import WIDENED_BELOW
from mavcompass.calibration.result import Limits
from mavcompass.units import DEG_PER_RAD, RAD_PER_DEG

H = 200.0


def dwell(**changed: Any) -> SimpleNamespace:
    values = {"mean_mgauss": np.array([200.0, 0.0, 400.0]), "unsteady_mgauss": 0.0, "current_a": math.nan}
    return SimpleNamespace(**{**values, **changed})


def data(turned_deg: tuple[float, ...] = (0.0, 90.0, 180.0, 270.0), **of_second: Any) -> Any:
    dwells = [dwell(**(of_second if k == 1 else {})) for k in range(len(turned_deg))]
    return SimpleNamespace(dwells=tuple(dwells), turned_rad=np.radians(turned_deg), first_heading=None)


def fit(gain: float = 1.0, horizontal: float = H, xz: float = 0.0, yz: float = 0.0, **changed: Any) -> Any:
    state = np.zeros(20)
    state[GAIN], state[HORIZONTAL] = [gain, gain, 1.0, 0.0, xz, yz], horizontal
    values = {
        "state": state,
        "world_model": True,
        "mirrored": False,
        "magnetic_headings_rad": np.radians([10.0, 100.0, 190.0, 280.0]),
        "heading_sigma_rad": 0.5 * RAD_PER_DEG,
        "budget_rad": {"noise": 0.001, "tilt": 0.002, "disturbance": 0.0},
        "disturbance_mgauss": 0.0,
        "suspects": (),
        "consistency": 0.5,
        "residual_rms_mgauss": 0.0,
        "disturbed_probability": np.zeros(4),
    }
    return SimpleNamespace(**{**values, **changed})


def told(
    seen: Any = None, fitted: Any = None, limit_deg: float = 2.0
) -> tuple[tuple[str, ...], tuple[str, ...]]:
    return judge(seen or data(), fitted or fit(), Limits(limit_deg))


def test_a_good_fit_is_accepted_without_a_word() -> None:
    assert told() == ((), ())


@pytest.mark.parametrize(
    ("turned_deg", "covered"),
    [((0.0, 80.0, 161.0), None), ((0.0, 80.0, 159.0), 159), ((350.0, 5.0, -10.0), 15), ((0.0, 180.0), None)],
)
def test_the_positions_must_cover_the_circle(turned_deg: tuple[float, ...], covered: int | None) -> None:
    reasons, _ = told(data(turned_deg))
    assert [f"only {covered} degrees" in reason for reason in reasons] == [True] * (covered is not None)


@pytest.mark.parametrize(("mgauss", "refused"), [(31999.0, 0), (32001.0, 1), (-32001.0, 1)])
def test_a_saturated_compass_is_refused(mgauss: float, refused: int) -> None:
    reasons, _ = told(data(mean_mgauss=np.array([mgauss, 0.0, 0.0])))
    assert len(reasons) == refused and all("saturated" in reason for reason in reasons)


@pytest.mark.parametrize(
    ("gain", "world", "words"),
    [
        (1.29, True, None),
        (1.31, True, "off by a third: the field that turns with the vehicle is 131 % of"),
        (0.71, True, None),
        (0.6, True, "off by 40 %: the field that turns with the vehicle is 60 % of"),
        (1.5, False, None),
    ],
)
def test_the_field_must_be_the_earths(gain: float, world: bool, words: str | None) -> None:
    reasons, _ = told(fitted=fit(gain, world_model=world))
    assert len(reasons) == (words is not None) and all(words in reason for reason in reasons if words)


@pytest.mark.parametrize(
    ("horizontal", "gain", "words"),
    [
        (15.1, 1.0, None),
        (14.9, 1.0, "15 mG; the Earth's is nowhere so weak"),
        (20.0, 0.7, "14 mG; the Earth's is nowhere so weak"),
        (803.0, 1.0, None),
        (805.0, 1.0, "805 mG; the Earth's is nowhere so strong"),
    ],
)
def test_without_a_place_the_field_must_be_one_of_the_earths(
    horizontal: float, gain: float, words: str | None
) -> None:
    reasons, _ = told(fitted=fit(gain, horizontal, world_model=False))
    assert len(reasons) == (words is not None) and all(words in reason for reason in reasons if words)


@pytest.mark.parametrize(
    ("off", "words"), [(0.27, "27 %"), (0.29, "a third"), (-0.37, "a third"), (0.39, "39 %")]
)
def test_shares_are_told_as_people_do(off: float, words: str) -> None:
    assert share_words(off) == words


def test_a_mounting_that_is_wrong_is_told_first_of_its_kind() -> None:
    (reason,), _ = told(fitted=fit(mirrored=True))
    assert "upside down" in reason
    (reason,), _ = told(fitted=fit(xz=0.25, yz=-0.25))
    assert "on its side" in reason
    assert told(fitted=fit(xz=0.24, yz=-0.24)) == ((), ())


@pytest.mark.parametrize(("mgauss", "refused"), [(6.9, 0), (7.1, 1)])
def test_a_field_that_changes_at_rest_is_refused(mgauss: float, refused: int) -> None:
    # Two degrees of 200 mG: 6.98 mG.
    reasons, warnings = told(data(unsteady_mgauss=mgauss))
    assert (len(reasons), warnings) == (refused, ())
    assert all("At position 2 the field changed by 7 mG" in reason for reason in reasons)


@pytest.mark.parametrize(
    ("consistency", "sigma_deg", "reasons", "warnings"),
    [
        # The widened sigma decides, as for all else; a misfit that is within the limit is told.
        (0.99 * WIDENED_BELOW, 2.1, 2, 0),
        (0.99 * WIDENED_BELOW, 1.9, 0, 1),
        (1.01 * WIDENED_BELOW, 2.1, 1, 0),
        (1.01 * WIDENED_BELOW, 1.9, 0, 0),
    ],
)
def test_positions_that_fit_no_rigid_compass(
    consistency: float, sigma_deg: float, reasons: int, warnings: int
) -> None:
    seen = {"heading_sigma_rad": sigma_deg * RAD_PER_DEG, "residual_rms_mgauss": 1.2}
    said = told(fitted=fit(consistency=consistency, **seen))
    assert (len(said[0]), len(said[1])) == (reasons, warnings)
    assert ("disagree by 1 mG" in "".join(said[0])) is (reasons == 2)
    assert all("uncertainty is widened" in warning for warning in said[1])


@pytest.mark.parametrize(
    ("suspects", "sigma_deg", "name", "refused"),
    [
        ((2,), 1.9, "position 3", False),
        ((0, 2), 2.1, "position 1 or 3", True),
        ((0, 2), 1.9, "position 1 or 3", False),
        ((3, 0, 2), 2.1, "position 1, 3 or 4", True),
        ((), 0.5, "one of the positions", False),
        ((0, 1, 2, 3, 4), 0.5, "one of the positions", False),
    ],
)
def test_a_disturbed_position_is_named(
    suspects: tuple[int, ...], sigma_deg: float, name: str, refused: bool
) -> None:
    seen = {"disturbance_mgauss": 7.0, "suspects": suspects, "heading_sigma_rad": sigma_deg * RAD_PER_DEG}
    reasons, warnings = told(fitted=fit(disturbed_probability=np.array([0.3, 0.0, 0.21, 0.0]), **seen))
    assert (len(reasons), len(warnings)) == ((2, 0) if refused else (0, 1))
    words = (*reasons, *warnings)[0]
    assert f"The field at {name} is off by about 7 mG (2.0 degrees)" in words
    assert ("Repeat it there." in words) is refused
    assert ("others agree" in words) is (len(suspects) == 1)
    unlikely = told(fitted=fit(disturbed_probability=np.array([0.3, 0.0, 0.19, 0.0]), **seen))
    assert "is off by" not in "".join((*unlikely[0], *unlikely[1]))


@pytest.mark.parametrize(
    ("amperes", "share_deg", "reasons", "warnings"),
    [(0.9, 1.9, 0, 0), (1.1, 0.19, 0, 0), (1.1, 0.21, 0, 1), (1.1, 0.99, 0, 1), (1.1, 1.01, 1, 0)],
)
def test_a_current_that_differed_counts_by_what_it_may_bend(
    amperes: float, share_deg: float, reasons: int, warnings: int
) -> None:
    seen = data()
    for k, one in enumerate(seen.dwells):
        one.current_a = 3.0 + (amperes if k == 2 else 0.0)
    budget = {"noise": 0.0, "disturbance": share_deg * RAD_PER_DEG}
    said = told(seen, fit(budget_rad=budget))
    assert (len(said[0]), len(said[1])) == (reasons, warnings)
    assert all(f"differed by {amperes:.1f} A" in words for words in (*said[0], *said[1]))
    seen.dwells[0].current_a = math.nan  # not known everywhere
    assert told(seen, fit(budget_rad=budget)) == ((), ())


@pytest.mark.parametrize(("sigma_deg", "refused"), [(1.99, False), (2.01, True)])
def test_a_heading_less_certain_than_the_limit_is_refused_with_its_largest_cause(
    sigma_deg: float, refused: bool
) -> None:
    reasons, _ = told(fitted=fit(heading_sigma_rad=sigma_deg * RAD_PER_DEG))
    assert len(reasons) == refused
    assert all("uncertain by 2.0 degrees (limit 2), most of it from tilt" in reason for reason in reasons)
    assert told(fitted=fit(heading_sigma_rad=1.0), limit_deg=DEG_PER_RAD) == ((), ())  # just at it
