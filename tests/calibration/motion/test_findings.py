"""What a fit of a motion shows to be wrong: each rule at its limit, with its figures."""

from __future__ import annotations

import math
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from mavcompass.calibration.findings import (
    findings,
    gain_words,
)
from mavcompass.calibration.model import GAIN, GYRO_SCALE, HORIZONTAL, MOTOR
from mavcompass.calibration.result import Limits
from mavcompass.frames import circle_covered_rad
from mavcompass.units import RAD_PER_DEG

EARTH: Any = object()  # only whether there is one matters
SECTIONS = 24


def sections(**changed: Any) -> Any:
    values = {
        "samples": np.full(SECTIONS, 20.0),
        "turned_rad": np.linspace(0.0, 2.0 * math.pi, SECTIONS),  # 15.7 degrees from one to the next
        "step_sigma_rad": np.full(SECTIONS - 1, 0.01),
        "gyro_rate_hz": 2.5,
        "load": np.zeros(SECTIONS),
        "middle_s": np.arange(SECTIONS) * 2.0,
        **changed,
    }
    return type("Sections", (SimpleNamespace,), {"__len__": lambda self: SECTIONS})(**values)


def fit(gains: tuple[float, ...] = (1.0, 1.0, 1.0), **changed: Any) -> Any:
    state = np.zeros(17 + SECTIONS)
    state[GAIN] = [*gains, *changed.pop("crosses", (0.0, 0.0, 0.0))]
    state[HORIZONTAL], state[MOTOR] = 200.0, changed.pop("motor", (0.0, 0.0, 0.0))
    sigma = np.full(state.size, changed.pop("gain_sigma", 0.01))
    values = {
        "state": state,
        "covariance": np.diag(sigma**2),
        "headings_rad": np.linspace(0.0, 2.0 * math.pi, SECTIONS, endpoint=False),
        "residual_mgauss": np.zeros((SECTIONS, 3)),
        "sound": np.ones(SECTIONS),
        **changed,
    }
    return SimpleNamespace(**values)


def told(
    seen: Any = None,
    fitted: Any = None,
    *,
    earth: Any = EARTH,
    rms_deg: float = 0.5,
    scatter_deg: float = 0.0,
    load: str = "current",
) -> tuple[tuple[str, ...], tuple[str, ...]]:
    error = SimpleNamespace(rms_rad=lambda: rms_deg * RAD_PER_DEG)
    honest: Any = SimpleNamespace(error=error, scatter_rad=scatter_deg * RAD_PER_DEG)
    motion: Any = SimpleNamespace(
        sections=seen or sections(),
        fit=fitted or fit(),
        load_source=load,
        motors_told=False,
        recorded=SimpleNamespace(earth=earth, limits=Limits(2.0)),
    )
    return findings(motion, honest)


def test_nothing_wrong_is_not_mentioned() -> None:
    assert told() == ((), ())


@pytest.mark.parametrize(
    ("off", "sigma", "said"),
    [(0.031, 0.01, "3 % more"), (-0.08, 0.02, "8 % less"), (0.029, 0.001, ""), (-0.08, 0.03, "")],
)
def test_a_gyro_whose_scale_is_off_is_told(off: float, sigma: float, said: str) -> None:
    fitted = fit(gain_sigma=sigma)
    fitted.state[GYRO_SCALE] = off
    reasons, warnings = told(fitted=fitted)
    assert not reasons and len(warnings) == bool(said)
    assert not said or f"The gyro reads {said} than the vehicle turned" in warnings[0]


@pytest.mark.parametrize(("sigma_deg", "rms_deg", "refused"), [(4.9, 1.1, 0), (5.1, 1.1, 1), (5.1, 0.9, 0)])
def test_a_gyro_recorded_too_seldom_is_told(sigma_deg: float, rms_deg: float, refused: int) -> None:
    seldom = sections(step_sigma_rad=np.full(SECTIONS - 1, sigma_deg * RAD_PER_DEG))
    reasons, warnings = told(seldom, rms_deg=rms_deg)
    assert len(reasons) == refused and not warnings
    if refused:
        assert "2.5 times a second, so that a turn is known to 5 degrees" in reasons[0]


def test_the_circle_seen_is_all_but_its_widest_gap() -> None:
    north = np.radians([350.0, 10.0, 359.0])
    assert circle_covered_rad(north) == pytest.approx(20.0 * RAD_PER_DEG)
    assert circle_covered_rad(np.radians([0.0, 120.0, -120.0])) == pytest.approx(240.0 * RAD_PER_DEG)
    assert told(fitted=fit(headings_rad=np.radians([0.0, 75.0, 150.1]))) == ((), ())
    (reason,), _ = told(fitted=fit(headings_rad=np.radians([0.0, 75.0, 149.4])))
    assert "only 149 degrees of the circle" in reason


@pytest.mark.parametrize(
    ("gains", "crosses", "refused"),
    [
        ((-0.1, 1.0, 1.0), (0.0, 0.0, 0.0), True),
        ((1.0, -0.1, 1.0), (0.0, 0.0, 0.0), True),
        ((1.0, 1.0, 1.0), (0.40, 0.0, 0.0), True),
        ((1.0, 1.0, 1.0), (0.0, 0.0, -0.40), True),
        ((1.0, 1.0, 1.0), (0.34, -0.34, 0.34), False),
    ],
)
def test_a_turned_mount_is_refused(
    gains: tuple[float, ...], crosses: tuple[float, ...], refused: bool
) -> None:
    reasons, warnings = told(fitted=fit(gains, crosses=crosses))
    assert [("does not turn as the vehicle" in reason) for reason in reasons] == [True] * refused
    assert not warnings


@pytest.mark.parametrize(
    ("gain", "sigma", "reasons", "warnings"),
    [
        (1.19, 0.01, 0, 0),
        (1.21, 0.01, 0, 1),
        (0.79, 0.01, 0, 1),
        (1.29, 0.10, 0, 1),  # a turn on the level need not show the vertical gain
        (1.31, 0.10, 1, 0),  # but so far off it must
        (1.31, 0.028, 0, 1),  # the difference's sigma: 0.028 sqrt(0.25 + 0.25 + 1) = 0.0343
        (1.31, 0.029, 1, 0),
        (1.39, 0.01, 0, 1),
        (1.41, 0.01, 1, 0),
        (0.59, 0.01, 1, 0),
    ],
)
def test_a_gain_is_told_or_refused(gain: float, sigma: float, reasons: int, warnings: int) -> None:
    fitted = fit((gain, gain, gain), gain_sigma=sigma)
    said = told(fitted=fitted)
    assert (len(said[0]), len(said[1])) == (reasons, warnings)
    assert told(fitted=fitted, earth=None) == ((), ())


def test_a_gain_is_put_down_to_the_sensor_only_where_the_axes_agree() -> None:
    alike, unlike = gain_words(np.array([0.71, 0.78, 0.61])), gain_words(np.array([0.72, 0.78, 0.57]))
    assert (
        "reads 70 % of the Earth's field" in alike and "COMPASS_SCALE" in alike and "off by a third" in alike
    )
    assert "reads 69 % of the Earth's field" in unlike and "Steel" in unlike and "COMPASS_SCALE" not in unlike


@pytest.mark.parametrize(
    ("scatter_deg", "reasons", "warnings"), [(0.9, 0, 0), (1.1, 0, 1), (1.9, 0, 1), (2.1, 1, 0)]
)
def test_scatter_is_told_and_beyond_the_limit_refused(
    scatter_deg: float, reasons: int, warnings: int
) -> None:
    said = told(scatter_deg=scatter_deg)
    assert (len(said[0]), len(said[1])) == (reasons, warnings)
    assert all(f"scatters by {scatter_deg:.1f} degrees" in words for words in (*said[0], *said[1]))


def test_scatter_has_the_largest_cause_that_the_data_show() -> None:
    load = np.concatenate([np.full(12, -5.0), np.full(12, 5.0)])  # swings by 10
    motors = {"fitted": fit(motor=(0.0, 2.1, 0.0)), "seen": sections(load=load)}
    _, (words,) = told(scatter_deg=1.5, **motors)
    assert "current swung by 10 A and moves the field by 2.1 mG/A" in words
    _, (words,) = told(scatter_deg=1.5, load="throttle", **motors)
    assert "throttle moves the field by 21 mG" in words
    changed = np.concatenate([np.full((12, 3), [-10.5, 0.0, 0.0]), np.full((12, 3), [10.5, 0.0, 0.0])])
    weak = fit(motor=(0.0, 1.9, 0.0), residual_mgauss=changed)
    _, (words,) = told(sections(load=load), weak, scatter_deg=1.5)
    assert "iron changed by 21 mG" in words
    still = fit(motor=(0.0, 1.9, 0.0), residual_mgauss=changed * 0.9)
    _, (words,) = told(sections(load=load), still, scatter_deg=1.5)
    assert "something magnetic near" in words


@pytest.mark.parametrize(("per_amp", "refused"), [(11.9, 0), (12.1, 1)])
def test_motors_beyond_compensation_are_refused(per_amp: float, refused: int) -> None:
    load = np.concatenate([np.zeros(12), np.full(12, 10.0)])  # 12 mG/A: 120 of 200 mG
    reasons, _ = told(sections(load=load), fit(motor=(0.0, 0.0, per_amp)))
    assert len(reasons) == refused
    assert told(sections(load=load), fit(motor=(0.0, 0.0, per_amp)), load="none")[0] == ()
    if refused:
        assert "121 mG is 60 % of the Earth's" in reasons[0]


def test_stretches_that_were_kept_out_are_counted() -> None:
    sound, residual = np.ones(SECTIONS), np.zeros((SECTIONS, 3))
    sound[3], residual[3] = 0.51, (3.0, 4.0, 0.0)
    assert told(fitted=fit(sound=sound)) == ((), ())
    sound[3] = 0.2
    sound[4] = 0.7
    _, (words,) = told(fitted=fit(sound=sound, residual_mgauss=residual))
    assert f"1 of {SECTIONS} stretches" in words and "the most at 6 s, 5 mG" in words
