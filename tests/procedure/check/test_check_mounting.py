"""A compass that is mounted turned is told from one that is badly calibrated."""

from __future__ import annotations

import math

import numpy as np
import pytest

from mavcompass.correction import FieldCorrection
from mavcompass.frames import SENSOR_ORIENTATIONS_DEG, FloatArray, euler_to_matrix, sensor_orientation_matrix
from mavcompass.procedure.check import check
from mavcompass.procedure.check.items import CheckReport
from mavcompass.procedure.check.mounting import turned_by
from mavcompass.procedure.check.preflight import CheckSettings
from mavcompass.procedure.script import Machine
from mavcompass.simulation.vehicle import SimulatedAutopilot
from mavcompass.vehicle.dialects import make_dialect
from mavcompass.vehicle.driver import run
from mavcompass.vehicle.links.simulated import SimulatedLink

EARTH = np.array([232.0, 52.0, 529.0])
# As a vehicle on the level sees it before and after a turn of 90 degrees.
BOTH = np.stack([EARTH, euler_to_matrix(0.0, 0.0, math.pi / 2).T @ EARTH])
OFFSETS = FieldCorrection((90.0, -60.0, 40.0))
# The closest rotation of the tables, 7 degrees, is less than two sound compasses may differ by.
TELLABLE = [n for n in SENSOR_ORIENTATIONS_DEG if n not in (0, 38, 41)]


def seen(orientation: int, field_mgauss: FloatArray) -> FloatArray:
    """Turn a field into the axes of a sensor mounted so, though the autopilot takes it as not turned."""
    return np.asarray(field_mgauss @ sensor_orientation_matrix(orientation))


@pytest.mark.parametrize("orientation", TELLABLE)
def test_with_a_turn_every_mounting_is_told_by_its_number(orientation: int) -> None:
    told = turned_by(seen(orientation, BOTH), BOTH)
    assert len(told) == 1
    matrix = euler_to_matrix(*np.radians(told[0]))
    assert np.abs(matrix - sensor_orientation_matrix(orientation)).max() < 1e-6


def test_the_offsets_in_force_may_be_those_of_the_right_mounting() -> None:
    turned = OFFSETS.apply(seen(4, OFFSETS.undo(BOTH)))
    assert turned_by(turned, BOTH, OFFSETS) == [(0.0, 0.0, 180.0)]


@pytest.mark.parametrize("size_mgauss", [20.0, 80.0, 150.0, 300.0, 600.0])
def test_iron_is_no_mounting(size_mgauss: float) -> None:
    rng = np.random.default_rng(1)
    directions = rng.normal(size=(300, 3))
    directions /= np.linalg.norm(directions, axis=1, keepdims=True)
    blamed = sum(bool(turned_by(BOTH + size_mgauss * d, BOTH)) for d in directions)
    at_rest = sum(bool(turned_by(EARTH + size_mgauss * d, EARTH)) for d in directions)
    assert blamed == 0 and at_rest <= 15  # of 300: one position alone may be mistaken, and says "may"


def test_a_sound_compass_is_not_turned() -> None:
    assert turned_by(BOTH + np.array([6.0, -9.0, 12.0]), BOTH) == ()


def checked(effect: str, turn: str) -> CheckReport:
    vehicle = SimulatedAutopilot("rover", seed=3, effects=[effect])
    settings = CheckSettings(turn=turn)  # type: ignore[arg-type]
    return run(Machine(lambda context: check(context, make_dialect, settings)), SimulatedLink(vehicle))


@pytest.mark.parametrize(("orientation", "turn"), [(4, "auto"), (8, "auto"), (12, "auto"), (2, "none")])
def test_a_turned_compass_is_sent_to_its_mounting_and_not_to_a_calibration(
    orientation: int, turn: str
) -> None:
    report = checked(f"orientation:orientation={orientation}", turn)
    assert report.verdict == "fail" and not report.calibration_advised
    (item,) = (item for item in report.items if item.name == "agreement")
    assert item.instance == 1 and "COMPASS_ORIENT" in item.remedy
    others = [item for item in report.items if item.verdict == "pass" or item.instance != 1]
    assert others and not any("COMPASS_ORIENT" in item.remedy for item in others)


def test_iron_is_sent_to_a_calibration() -> None:
    report = checked("hard_iron:x=120,y=-80", "auto")
    assert report.calibration_advised
    assert not any("COMPASS_ORIENT" in item.remedy for item in report.items)
