"""A compass mounted any way: read right, mended by a plan, and put back as it was."""

from __future__ import annotations

import itertools
import os
from pathlib import Path

import numpy as np
import pytest
from written_vehicle import read, restore, run_on, write

from mavcompass.compass_parameters import mounting_values, sensor_to_body
from mavcompass.correction import FieldCorrection
from mavcompass.frames import FloatArray, euler_to_matrix, rotate_back, sensor_orientation_matrix
from mavcompass.simulation.heading_error import heading_errors_rad
from mavcompass.simulation.physics.sensors import CompassModel, CompassSetup
from mavcompass.simulation.vehicle import SimulatedAutopilot
from mavcompass.vehicle.dialects.taking_over import PX4_HOW

IRON = FieldCorrection((120.0, -80.0, 40.0), (1.1, 0.9, 1.0), (0.02, -0.01, 0.005))
VEHICLES = {"ardupilot": "rover", "px4": "px4-copter"}


@pytest.fixture(autouse=True)
def unflushed(monkeypatch: pytest.MonkeyPatch) -> None:
    """Do not wait for the disk, hundreds of times over."""
    monkeypatch.setattr(os, "fsync", lambda descriptor: None)


def right_angles() -> list[FloatArray]:
    signed = (
        np.eye(3)[list(order)] * np.array(signs)
        for order in itertools.permutations(range(3))
        for signs in itertools.product((1.0, -1.0), repeat=3)
    )
    return [matrix for matrix in signed if np.linalg.det(matrix) > 0.0]


def free_ones(count: int) -> list[FloatArray]:
    drawn = np.random.default_rng(8).standard_normal((count, 3, 3))
    rotations = [np.linalg.qr(matrix)[0] for matrix in drawn]
    return [matrix * np.linalg.det(matrix) for matrix in rotations]


@pytest.mark.parametrize("mounted", [*right_angles()[::4], *free_ones(4)])
@pytest.mark.parametrize("kind", VEHICLES)
def test_a_mounting_is_read_mended_and_put_back(kind: str, mounted: FloatArray, tmp_path: Path) -> None:
    autopilot = mounted_vehicle(kind, mounted)
    assert field_of(autopilot) == pytest.approx(true_field(autopilot), abs=0.05)
    assert sensor_to_body(kind, read(autopilot).values, 1) == pytest.approx(mounted, abs=1e-6)

    turn_wrong(autopilot, kind)
    before = read(autopilot)
    assert np.linalg.norm(field_of(autopilot) - true_field(autopilot)) > 10.0
    turned = mounted @ sensor_to_body(kind, before.values, 1).T
    plan = before.dialect.plan(before.values, {1: IRON}, {1: turned})
    report = write(autopilot, before, plan, tmp_path)
    assert report.outcome is not None and report.outcome.verified and report.outcome.undo_file is not None
    if any("restart" in remark for remark in plan.remarks):
        autopilot.reboot()
        autopilot.advance(autopilot.time_s + 3.0)
    assert field_of(autopilot) == pytest.approx(true_field(autopilot), abs=0.05)
    assert sensor_to_body(kind, read(autopilot).values, 1) == pytest.approx(mounted, abs=1e-6)
    assert np.abs(heading_errors_rad(autopilot, 1, None, 0.3, -0.2)).max() < 1e-4

    restore(autopilot, report.outcome.undo_file, tmp_path)
    assert read(autopilot).values == before.values


def mounted_vehicle(kind: str, mounted: FloatArray) -> SimulatedAutopilot:
    """Build a vehicle, disarmed, whose first compass is mounted so and set so."""
    factory = SimulatedAutopilot(VEHICLES[kind]).firmware.store.values
    right = mounting_values(kind, factory, 1, mounted)
    compasses = [CompassSetup(CompassModel(IRON, noise_mgauss=0.0), IRON)] * 3
    return SimulatedAutopilot(VEHICLES[kind], compasses=compasses, parameters=right, armed=False)


def turn_wrong(autopilot: SimulatedAutopilot, kind: str) -> None:
    """Set another mounting, 135 degrees about the vertical, which no right angle is."""
    store = autopilot.firmware.store
    for name, value in mounting_values(kind, store.values, 1, sensor_orientation_matrix(3)).items():
        store.set(name, value)
    autopilot.firmware.compasses.parameters_changed()


def field_of(autopilot: SimulatedAutopilot) -> FloatArray:
    autopilot.advance(autopilot.time_s + 0.2)
    return np.array(autopilot.firmware.compasses.fields[0])


def true_field(autopilot: SimulatedAutopilot) -> FloatArray:
    body = autopilot.body
    attitude = euler_to_matrix(body.roll_rad, body.pitch_rad, body.yaw_rad)
    return rotate_back(attitude, autopilot.world.field_ned_mgauss)


@pytest.mark.parametrize(("moved_gauss", "how"), [(0.05, PX4_HOW), (0.0, "")])
@pytest.mark.parametrize("mounted", [right_angles()[5], free_ones(1)[0]])
def test_what_px4_flew_with_it_stores_on_landing_and_the_new_mounting_is_loaded_again(
    mounted: FloatArray, moved_gauss: float, how: str, tmp_path: Path
) -> None:
    autopilot = mounted_vehicle("px4", mounted)
    store = autopilot.firmware.store
    store.set("CAL_MAG0_XOFF", store["CAL_MAG0_XOFF"] + moved_gauss)
    turn_wrong(autopilot, "px4")
    autopilot.firmware.status.armed = True
    before = read(autopilot)
    flown = sensor_to_body("px4", before.values, 1)
    plan = before.dialect.plan(before.values, {1: IRON}, {1: mounted @ flown.T})
    report = write(autopilot, before, plan, tmp_path)
    assert report.outcome is not None and np.linalg.norm(field_of(autopilot) - true_field(autopilot)) > 10.0
    autopilot.firmware.arming.disarm()
    assert sensor_to_body("px4", read(autopilot).values, 1) == pytest.approx(flown, abs=1e-6)
    values = report.outcome.values
    assert run_on(autopilot, lambda context: before.dialect.load_written(context, values)) == how
    after = read(autopilot)
    assert {name: after.values[name] for name in values} == values
    assert sensor_to_body("px4", after.values, 1) == pytest.approx(mounted, abs=1e-6)
