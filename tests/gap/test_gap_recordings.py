"""The diagnosis on recordings that our simulator never made."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from mavcompass.gap import diagnose_gap
from mavcompass.gap.export import ardupilot_sitl, preset, settings_of
from mavcompass.gap.floor import from_recording
from mavcompass.gap.hypothesis import make_term
from mavcompass.gap.model import Problem
from mavcompass.gap.replay import replay
from mavcompass.logs import read_track
from mavcompass.simulation.effects import read_preset


def test_firmware_recording_gives_back_the_simulators_parameters(shared_data: Path) -> None:
    track = read_track(shared_data / "ardupilot-4.6.3" / "rover_dist_use2.tlog")
    diagnosis = diagnose_gap(track)
    assert diagnosis.effects == {"hard_iron", "axis_scale"}
    assert diagnosis.reference == "gyro"
    assert diagnosis.field.after < diagnosis.field.floor
    exported = ardupilot_sitl(settings_of(diagnosis.causes)).parameters
    for axis, offset, diagonal in (("X", 120.0, 1.1), ("Y", -80.0, 0.9), ("Z", 40.0, 1.0)):
        assert exported[f"SIM_MAG1_OFS_{axis}"] == pytest.approx(offset, rel=0.02)
        assert exported[f"SIM_MAG1_DIA_{axis}"] == pytest.approx(diagonal, rel=0.02)


def test_offsets_of_an_untouched_firmware_simulator_are_found(shared_data: Path) -> None:
    """The firmware's simulator comes with offsets (5, 13, -18) that its calibration undoes."""
    diagnosis = diagnose_gap(read_track(shared_data / "ardupilot-4.6.3" / "rover_plain.tlog"))
    assert diagnosis.effects == {"hard_iron"}
    cause = diagnosis.causes[0]
    for axis, true in zip("xyz", (-5.0, -13.0, 18.0), strict=True):
        low, high = cause.ci95[axis]
        assert low < true < high and high - low < 8.0
        assert cause.parameters[axis] == pytest.approx(true, abs=2.0)


def test_preset_in_our_simulator_closes_the_recorded_gap_as_claimed(
    shared_data: Path, tmp_path: Path
) -> None:
    """The simulator runs the recorded motion with the exported preset; only its nuisances are solved for."""
    track = read_track(shared_data / "ardupilot-4.6.3" / "rover_dist_use2.tlog")
    diagnosis = diagnose_gap(track)
    path = tmp_path / "found.json"
    path.write_text(preset(settings_of(diagnosis.causes), "rover"), encoding="utf-8")
    found = read_preset(path)
    replayed = replay(track)
    floor = from_recording(replayed)
    problem = Problem(replayed, floor.noise, replayed.valid, floor.nuisances)
    terms = [
        replace(t, free=np.zeros_like(t.free)) for t in (make_term(s.effect, replayed.signals) for s in found)
    ]
    fit = problem.fit(terms, [s.theta for s in found], [n.mean for n in problem.nuisances])
    measured = replayed.measured.mag_mgauss
    left, before = (
        float(np.mean((measured - problem.predict(fit, on).mag_mgauss)[replayed.valid] ** 2))
        for on in (True, False)
    )
    assert 1.0 - left / before == pytest.approx(diagnosis.field.shrink, abs=0.01)
    assert left**0.5 < diagnosis.field.floor
