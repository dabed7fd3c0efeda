"""The transaction on the simulated flight controller, driven as in life, over a link that dies."""

from __future__ import annotations

import os
import random
from pathlib import Path

import pytest

from mavcompass.correction import FieldCorrection
from mavcompass.errors import LinkError, MavCompassError, Refused, WriteFailed
from mavcompass.procedure.script import Context, Machine, Script
from mavcompass.simulation.vehicle import SimulatedAutopilot
from mavcompass.vehicle.driver import run
from mavcompass.vehicle.link import ONBOARD_COMPUTER
from mavcompass.vehicle.links.faults import Faults, FaultyLink
from mavcompass.vehicle.links.simulated import SimulatedLink
from mavcompass.vehicle.parameters.undo import load_record, undo_saver
from mavcompass.vehicle.session import HeldParameters, WriteReport, read_vehicle, write_values

SOURCE = "udpin:0.0.0.0:14550"
NEW = FieldCorrection((120.0, -80.0, 40.0), (1.1, 0.9, 1.0), (0.02, -0.01, 0.005), 1.02)


@pytest.fixture(autouse=True)
def unflushed(monkeypatch: pytest.MonkeyPatch) -> None:
    """Do not wait for the disk, hundreds of times over."""
    monkeypatch.setattr(os, "fsync", lambda descriptor: None)


def read(autopilot: SimulatedAutopilot, faults: Faults | None = None, seed: int = 0) -> HeldParameters:
    return run(Machine(lambda context: read_vehicle(context, SOURCE)), link(autopilot, faults, seed))


def link(autopilot: SimulatedAutopilot, faults: Faults | None, seed: int) -> FaultyLink:
    return FaultyLink(SimulatedLink(autopilot, SOURCE, ONBOARD_COMPUTER), faults or Faults(), seed)


def write(
    autopilot: SimulatedAutopilot, held: HeldParameters, folder: Path, faults: Faults, seed: int
) -> WriteReport:
    plan = held.dialect.plan(held.values, {1: NEW})
    assert plan.changes and not plan.refusals

    def script(context: Context) -> Script[WriteReport]:
        context.system, context.component = held.system, 1
        saver = undo_saver(SOURCE, folder)
        outcome = yield from held.dialect.write(context, plan, saver)
        return WriteReport(held, plan, outcome)

    return run(Machine(script), link(autopilot, faults, seed))


def restore(autopilot: SimulatedAutopilot, undo_file: Path, folder: Path) -> None:
    def script(context: Context) -> Script[WriteReport]:
        return write_values(
            context,
            SOURCE,
            lambda held, vehicle: load_record(undo_file).before,
            undo_saver(SOURCE, folder),
            checked=False,
            consent=lambda held, plan: "",
        )

    run(Machine(script), link(autopilot, None, 0))


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
            write(autopilot, before, tmp_path, faults, number)
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
    report = write(autopilot, clean, tmp_path, faults, seed)
    assert report.outcome is not None and report.outcome.verified
    wanted = {change.name: change.new for change in report.plan.changes}
    assert read(autopilot).values == clean.values | wanted
