"""A simulator's recording beside a vehicle's: what each lacks, what was promised, what was achieved."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from click.testing import CliRunner

from mavcompass.cli.gap import command
from mavcompass.frames import FloatArray, quaternion_to_matrix
from mavcompass.gap.comparison import SCHEMA, compare
from mavcompass.gap.diagnose import Replayed, diagnose_gap
from mavcompass.gap.trial.vehicles.cases import make_case
from mavcompass.report.compare import compare_summary
from mavcompass.track import Track

IRON = np.array([60.0, -35.0, 10.0])


def flown_with(track: Track, iron_mgauss: FloatArray) -> Track:
    """Fly the same simulator with more iron: its compass reports so much more."""
    compass = track.compasses[1]
    mag = replace(compass.reported, values=compass.reported.values + iron_mgauss)
    return replace(track, compasses={**track.compasses, 1: replace(compass, reported=mag)})


@pytest.fixture(scope="module")
def simulator_and_vehicle() -> tuple[Track, Track]:
    """Another generator's vehicle whose calibration is right: its baseline is the simulator's flight."""
    case = make_case(2, "none", True)
    assert case.baseline is not None
    return case.baseline, case.track


def test_what_the_vehicle_has_more_the_simulator_lacks_and_flown_again_it_does_not(
    simulator_and_vehicle: tuple[Track, Track],
) -> None:
    simulator, healthy = simulator_and_vehicle
    comparison = compare(simulator, flown_with(healthy, IRON), [flown_with(simulator, IRON), simulator])
    (difference,) = comparison.differences
    assert (difference.cause.effect, difference.lacks) == ("hard_iron", "simulator")
    found = [difference.cause.parameters[axis] for axis in "xyz"]
    assert difference.cause.removes_mgauss == pytest.approx(np.sqrt(np.mean(np.square(found))), rel=0.1)
    assert difference.cause.removes_deg > 5.0
    again, unchanged = comparison.achieved
    assert again.shrink > 0.95 and again.ci95[0] > 0.9 and again.heading_shrink > 0.95
    assert abs(again.shrink - comparison.told.field.shrink) < 0.05
    assert abs(unchanged.shrink) < 0.05, "flown again as it was, nothing is achieved"
    said = compare_summary(comparison)
    assert "less than promised" in said[0] and "the simulator lacks hard_iron" in said[2]


def test_two_that_do_not_differ(simulator_and_vehicle: tuple[Track, Track]) -> None:
    comparison = compare(*simulator_and_vehicle)
    assert comparison.told.verdict == "no_gap" and not comparison.differences
    assert compare_summary(comparison)[0].startswith("No difference found")


@pytest.mark.parametrize("lacks", ["simulator", "vehicle"])
def test_a_lag_of_real_firmware_is_found_on_the_side_that_has_it(
    shared_data: Path, tmp_path: Path, lacks: str
) -> None:
    folder = shared_data / "gap-firmware" / "r_lag"
    plain, late = folder / "baseline.tlog", folder / "flight.tlog"
    logs = [plain, late] if lacks == "simulator" else [late, plain]
    out, page = tmp_path / "c.json", tmp_path / "c.html"
    run = CliRunner().invoke(command, ["compare", *map(str, logs), "--json", str(out), "--report", str(page)])
    assert run.exit_code == 0, run.output
    document = json.loads(out.read_text())
    assert document["schema"] == SCHEMA and document["achieved"] is None
    (difference,) = document["differences"]
    assert (difference["effect"], difference["lacks"]) == ("transport_lag", lacks)
    labels = json.loads((folder.parent / "labels.json").read_text())["r_lag"]
    (delay_ms,) = [v for k, v in labels["parameters"].items() if k.endswith("DELAY")]
    # Boots of the firmware differ by up to 70 ms.
    assert difference["parameters"]["lag_s"] == pytest.approx(delay_ms / 1000.0, abs=0.07)
    assert document["promised"]["shrink"] > 0.95
    assert f"the {lacks} lacks transport_lag" in run.output
    assert ("gap export" in run.output) == (lacks == "simulator")
    assert "Simulator and vehicle" in page.read_text() and "<svg" in page.read_text()


def test_the_recordings_that_the_reader_cannot_use_are_refused(tmp_path: Path) -> None:
    empty = tmp_path / "empty.tlog"
    empty.write_bytes(b"")
    run = CliRunner().invoke(command, ["compare", str(empty), str(empty)])
    assert run.exit_code != 0 and "Traceback" not in run.output


def over_iron_in_the_ground(track: Track, ned_mgauss: FloatArray, depth_m: float = 10.0) -> Track:
    """Let the ground's field, which falls with height, act on a copter of the other generator."""
    compass = track.compasses[1]
    time_s = compass.time_s
    assert track.truth_q is not None and track.position_ned_m is not None
    height = -track.position_ned_m.at(time_s)[:, 2]
    turn = quaternion_to_matrix(track.truth_q.at(time_s))
    field = (depth_m / (depth_m + height))[:, None] ** 3 * ned_mgauss
    seen = np.einsum("nji,nj->ni", turn, field)
    mag = replace(compass.reported, values=compass.reported.values + seen)
    return replace(track, compasses={**track.compasses, 1: replace(compass, reported=mag)})


def test_what_goes_with_height_is_judged_by_what_the_simulator_has_of_it() -> None:
    case = make_case(8, "none", True)
    assert case.baseline is not None
    anomaly = np.array([300.0, -150.0, 500.0])
    vehicle = over_iron_in_the_ground(case.track, anomaly)
    again = over_iron_in_the_ground(case.baseline, 0.95 * anomaly)
    comparison = compare(case.baseline, vehicle, [again])
    assert [d.cause.effect for d in comparison.differences] == ["height_anomaly"]
    (nearly,) = comparison.achieved
    assert nearly.shrink == pytest.approx(comparison.told.field.shrink, abs=0.05)


def test_a_recording_is_replayed_once_whichever_side_it_is_on() -> None:
    """What a comparison gives its simulator must be there when the two change places."""
    case = make_case(23, "none")
    replayed: Replayed = {}
    assert case.baseline is not None
    diagnose_gap(case.track, case.baseline, replayed=replayed)
    first = {id(track): kept for track, kept in replayed.values()}
    diagnose_gap(case.baseline, case.track, replayed=replayed)
    assert all(kept.averaged > 1 and kept.late_s > 0.0 for kept in first.values())
    assert len(replayed) == 2 and all(first[id(track)] is kept for track, kept in replayed.values())
