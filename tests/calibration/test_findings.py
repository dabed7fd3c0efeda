"""What a fit shows to be wrong, in a pilot's words: each cause far beyond its limit, and none well within."""

from __future__ import annotations

import math
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from mavcompass.calibration.findings import findings, judge
from mavcompass.calibration.model import GAIN, GYRO_SCALE, HORIZONTAL, MOTOR
from mavcompass.calibration.motion.sections import Sections
from mavcompass.calibration.result import Limits
from mavcompass.units import RAD_PER_DEG

COUNT = 24
Told = tuple[tuple[str, ...], tuple[str, ...]]


def of_positions(**seen: Any) -> Told:
    """Judge four positions that fit well, but for what is given."""
    turned = np.radians(seen.pop("turned_deg", (0.0, 90.0, 180.0, 270.0)))
    at_each = {"mean_mgauss": np.array([200.0, 0.0, 400.0]), "unsteady_mgauss": 0.0, "current_a": math.nan}
    dwells = [SimpleNamespace(**{**at_each, **seen.pop(f"at_{k + 1}", {})}) for k in range(turned.size)]
    data: Any = SimpleNamespace(dwells=dwells, turned_rad=turned, first_heading=None)
    state = np.zeros(20)
    state[GAIN], state[HORIZONTAL] = (
        seen.pop("gains", (1.0, 1.0, 1.0, 0.0, 0.0, 0.0)),
        seen.pop("mgauss", 200.0),
    )
    values = {
        "state": state, "world_model": True, "mirrored": False, "disturbance_mgauss": 7.0, "suspects": (),
        "heading_sigma_rad": seen.pop("sigma_deg", 0.5) * RAD_PER_DEG, "consistency": 0.5,
        "budget_rad": {"tilt": 0.002, "disturbance": seen.pop("bends_deg", 0.0) * RAD_PER_DEG},
        "residual_rms_mgauss": 1.2, "disturbed_probability": np.zeros(4),
    }  # fmt: skip
    fit: Any = SimpleNamespace(**{**values, **seen})
    return judge(data, fit, Limits(2.0))


def of_motion(**seen: Any) -> Told:
    """Judge a motion that fits well, but for what is given."""
    state = np.zeros(17 + COUNT)
    state[GAIN], state[HORIZONTAL] = seen.pop("gains", (1.0, 1.0, 1.0, 0.0, 0.0, 0.0)), 200.0
    state[MOTOR], state[GYRO_SCALE] = seen.pop("motor", (0.0, 0.0, 0.0)), seen.pop("gyro", 0.0)
    own = {"__len__": lambda self: COUNT, "sparse": Sections.sparse}
    sections = type("Sections", (SimpleNamespace,), own)(
        samples=np.full(COUNT, 20.0),
        turned_rad=np.linspace(0.0, 2.0 * math.pi, COUNT),
        step_sigma_rad=np.full(COUNT - 1, seen.pop("step_deg", 0.5) * RAD_PER_DEG),
        gyro_rate_hz=2.5,
        loads=np.repeat([[0.0], [10.0]], COUNT // 2, axis=0),
        middle_s=np.arange(COUNT) * 2.0,
    )
    fit = SimpleNamespace(
        state=state,
        motors_mgauss=state[np.newaxis, MOTOR],
        covariance=np.diag(np.full(state.size, seen.pop("sigma", 0.01)) ** 2),
        headings_rad=np.linspace(0.0, seen.pop("seen_rad", 6.0), COUNT),
        residual_mgauss=np.repeat([[0.0] * 3, [seen.pop("later_mgauss", 0.0), 0.0, 0.0]], COUNT // 2, axis=0),
        sound=np.where(np.arange(COUNT) == 15, seen.pop("sound", 1.0), 1.0),
    )
    recorded = SimpleNamespace(earth=seen.pop("earth", object()), limits=Limits(2.0))
    motion: Any = SimpleNamespace(
        sections=sections,
        fit=fit,
        load_source=seen.pop("load", "current"),
        motors_told=False,
        recorded=recorded,
    )
    rms_rad = seen.pop("rms_deg", 0.5) * RAD_PER_DEG
    honest: Any = SimpleNamespace(
        error=SimpleNamespace(rms_rad=lambda: rms_rad), scatter_rad=seen.pop("scatter_deg", 0.0) * RAD_PER_DEG
    )
    assert not seen
    return findings(motion, honest)


def weak(gain: float) -> tuple[float, ...]:
    return (gain, gain, gain, 0.0, 0.0, 0.0)


FINE, WARNED, REFUSED = None, False, True
LOADED = {f"at_{k}": {"current_a": 2.0 * k} for k in range(1, 5)}
DISTURBED = {"disturbed_probability": np.array([0.3, 0.0, 0.3, 0.0])}
OF_POSITIONS: list[tuple[dict[str, Any], bool | None, str]] = [
    ({}, FINE, ""),
    ({"turned_deg": (0.0, 60.0, 120.0)}, REFUSED, "cover only 120 degrees of the circle"),
    ({"at_2": {"mean_mgauss": np.array([-32700.0, 0.0, 0.0])}}, REFUSED, "saturated"),
    ({"gains": weak(0.65)}, REFUSED, "off by a third: the field that turns with the vehicle is 65 %"),
    ({"gains": weak(1.5)}, REFUSED, "off by 50 %"),
    ({"gains": weak(1.5), "world_model": False}, FINE, ""),
    ({"mgauss": 10.0, "world_model": False}, REFUSED, "10 mG; the Earth's is nowhere so weak"),
    ({"mgauss": 900.0, "world_model": False}, REFUSED, "nowhere so strong"),
    ({"mirrored": True, "gains": weak(0.5)}, REFUSED, "upside down"),
    ({"gains": (1.0, 1.0, 1.0, 0.0, 0.3, -0.3)}, REFUSED, "on its side"),
    ({"at_2": {"unsteady_mgauss": 9.0}}, REFUSED, "At position 2 the field changed by 9 mG"),
    ({"consistency": 1e-9}, WARNED, "fit worse than their noise explains; the uncertainty is widened"),
    ({"consistency": 1e-9, "sigma_deg": 3.0}, REFUSED, "do not fit one rigid compass: they disagree by 1 mG"),
    ({**DISTURBED, "suspects": (2,)}, WARNED, "at position 3 is off by about 7 mG (2.0 degrees)"),
    ({**DISTURBED, "suspects": (2,)}, WARNED, "the others agree and were believed"),
    ({**DISTURBED, "suspects": (0, 2)}, WARNED, "at position 1 or 3 is off"),
    ({**DISTURBED, "suspects": (3, 0, 2), "sigma_deg": 3.0}, REFUSED, "position 1, 3 or 4 is off"),
    ({**DISTURBED, "sigma_deg": 3.0}, REFUSED, "one of the positions is off by about 7 mG (2.0 degrees)"),
    (LOADED, FINE, ""),
    ({"bends_deg": 0.4, **LOADED}, WARNED, "differed by 6.0 A"),
    ({"bends_deg": 1.5, **LOADED}, REFUSED, "switch them off"),
    ({"sigma_deg": 2.5}, REFUSED, "uncertain by 2.5 degrees (limit 2), most of it from tilt"),
]  # fmt: skip
LOUD = (0.0, 3.0, 0.0)
OF_MOTIONS: list[tuple[dict[str, Any], bool | None, str]] = [
    ({}, FINE, ""),
    ({"gyro": 0.06}, WARNED, "The gyro reads 6 % more than the vehicle turned"),
    ({"gyro": -0.06, "sigma": 0.03}, FINE, ""),
    ({"step_deg": 6.0, "rms_deg": 1.5}, REFUSED, "2.5 times a second, so that a turn is known to 6 degrees"),
    ({"step_deg": 6.0}, FINE, ""),
    ({"seen_rad": 2.0}, REFUSED, "only 115 degrees of the circle"),
    ({"gains": (-0.3, 1.0, 1.0, 0.0, 0.0, 0.0)}, REFUSED, "does not turn as the vehicle does"),
    ({"gains": (1.0, 1.0, 1.0, 0.0, 0.0, -0.5)}, REFUSED, "does not turn as the vehicle does"),
    ({"gains": weak(0.7)}, WARNED, "reads 70 % of the Earth's field at this place, alike on every axis"),
    ({"gains": weak(0.65), "sigma": 0.2}, REFUSED, "off by a third"),
    ({"gains": weak(0.5)}, REFUSED, "off by 50 %"),
    ({"gains": weak(0.5), "earth": None}, FINE, ""),
    ({"gains": (0.65, 0.7, 0.9, 0.0, 0.0, 0.0)}, WARNED, "not alike on its axes"),
    ({"scatter_deg": 1.5}, WARNED, "still scatters by 1.5 degrees: something magnetic near"),
    ({"scatter_deg": 2.5, "later_mgauss": 30.0}, REFUSED, "the iron changed by 30 mG"),
    ({"scatter_deg": 1.5, "motor": LOUD}, WARNED, "swung by 10 A and moves the field by 3.0 mG/A"),
    ({"scatter_deg": 1.5, "motor": LOUD, "load": "throttle"}, WARNED, "throttle moves the field by 30 mG"),
    ({"motor": (0.0, 0.0, 15.0)}, REFUSED, "150 mG is 75 % of the Earth's"),
    ({"motor": (0.0, 0.0, 15.0), "load": "none"}, FINE, ""),
    ({"sound": 0.2}, WARNED, "1 of 24 stretches were kept out"),
]  # fmt: skip


@pytest.mark.parametrize(
    ("judged", "seen", "verdict", "says"),
    [*((of_positions, *row) for row in OF_POSITIONS), *((of_motion, *row) for row in OF_MOTIONS)],
)
def test_what_is_wrong_is_told_or_refused(
    judged: Any, seen: dict[str, Any], verdict: bool | None, says: str
) -> None:
    reasons, warnings = judged(**seen)
    assert (bool(reasons), bool(warnings)) == (verdict is REFUSED, verdict is WARNED), (reasons, warnings)
    assert not says or any(says in words for words in (*reasons, *warnings)), (reasons, warnings)
