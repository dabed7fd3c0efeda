"""The transaction on the simulated flight controller, driven as in life, over a link that dies."""

from __future__ import annotations

import os
import random
from pathlib import Path

import pytest
from written_vehicle import read, restore, write

from mavcompass.correction import FieldCorrection
from mavcompass.errors import LinkError, MavCompassError, Refused, WriteFailed
from mavcompass.procedure.dialect import ParameterPlan
from mavcompass.simulation.vehicle import SimulatedAutopilot
from mavcompass.vehicle.links.faults import Faults
from mavcompass.vehicle.session import HeldParameters

NEW = FieldCorrection((120.0, -80.0, 40.0), (1.1, 0.9, 1.0), (0.02, -0.01, 0.005), 1.02)


@pytest.fixture(autouse=True)
def unflushed(monkeypatch: pytest.MonkeyPatch) -> None:
    """Do not wait for the disk, hundreds of times over."""
    monkeypatch.setattr(os, "fsync", lambda descriptor: None)


def new_plan(held: HeldParameters) -> ParameterPlan:
    return held.dialect.plan(held.values, {1: NEW})


@pytest.mark.parametrize("vehicle", ["rover", "px4-copter"])
def test_a_cut_link_never_leaves_a_torn_set_without_the_way_back(vehicle: str, tmp_path: Path) -> None:
    chance = random.Random(5)
    autopilot = SimulatedAutopilot(vehicle, seed=3)
    before = read(autopilot)
    torn = finished = 0
    for number in range(40):
        start_s = autopilot.time_s
        faults = Faults(
            loss=chance.choice([0.0, 0.2]),
            latency_s=chance.choice([0.005, 0.05]),
            cut_at_s=start_s + chance.uniform(0.0, 2.0),
            cut_is_final=chance.random() < 0.3,
        )
        error: MavCompassError | None = None
        try:
            write(autopilot, before, new_plan(before), tmp_path, faults, number)
        except MavCompassError as raised:
            error = raised
        now = read(autopilot)
        changed = now.values != before.values
        if changed and error is not None:
            assert isinstance(error, WriteFailed), f"cut {number}: {error!r}"
            assert error.undo_file is not None and error.restore_command in str(error)
            torn += 1
            restore(autopilot, error.undo_file, tmp_path)
        elif changed:
            assert now.dialect.correction(now.values, 1).offsets_mgauss == pytest.approx(NEW.offsets_mgauss)
            finished += 1
            restore(autopilot, max(tmp_path.glob("*.json")), tmp_path)
        else:
            assert isinstance(error, WriteFailed | LinkError | Refused)
        assert read(autopilot).values == before.values, f"cut {number}"
    assert torn >= 5 and finished >= 2, (torn, finished)


@pytest.mark.parametrize("seed", range(3))
def test_a_bad_link_reads_and_writes_the_same(seed: int, tmp_path: Path) -> None:
    autopilot = SimulatedAutopilot("rover", seed=seed)
    clean = read(autopilot)
    faults = Faults(loss=0.3, duplicate=0.05, reorder=0.2, latency_s=0.3)
    assert read(autopilot, faults, seed).values == clean.values
    report = write(autopilot, clean, new_plan(clean), tmp_path, faults, seed)
    assert report.outcome is not None and report.outcome.verified
    wanted = {change.name: change.new for change in report.plan.changes}
    assert read(autopilot).values == clean.values | wanted
