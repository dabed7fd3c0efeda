"""The diagnosis on recordings that our simulator never made."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from mavcompass.errors import BadRecording
from mavcompass.frames import FloatArray
from mavcompass.gap import Diagnosis, diagnose_gap
from mavcompass.gap.export.simulators import ardupilot_sitl, preset
from mavcompass.gap.export.vehicle import Found, settings_of, vehicle_settings
from mavcompass.gap.fit.hypothesis import Fit, make_term
from mavcompass.gap.fit.model import Problem
from mavcompass.gap.replay.nominal import replay
from mavcompass.gap.residual.floor import from_recording
from mavcompass.logs import read_track
from mavcompass.simulation.effects import Setting, read_preset
from mavcompass.track import Track


@pytest.fixture(scope="module")
def distorted(shared_data: Path) -> tuple[Track, Diagnosis]:
    """A rover of the firmware with iron in it."""
    track = read_track(shared_data / "ardupilot-4.6.3" / "rover_dist_use2.tlog")
    return track, diagnose_gap(track)


def test_firmware_recording_gives_back_the_simulators_parameters(distorted: tuple[Track, Diagnosis]) -> None:
    _, diagnosis = distorted
    assert diagnosis.effects == {"hard_iron", "axis_scale"}
    assert diagnosis.reference == "fused"
    assert diagnosis.field.after < diagnosis.field.floor
    exported = ardupilot_sitl(Found(vehicle_settings(diagnosis))).parameters
    for axis, offset, diagonal in (("X", 120.0, 1.1), ("Y", -80.0, 0.9), ("Z", 40.0, 1.0)):
        assert exported[f"SIM_MAG1_OFS_{axis}"] == pytest.approx(offset, rel=0.02)
        assert exported[f"SIM_MAG1_DIA_{axis}"] == pytest.approx(diagonal, rel=0.02)


def test_gap_falls_with_each_cause_and_lies_along_what_varied(distorted: tuple[Track, Diagnosis]) -> None:
    """The rover stood level, and warmed by a degree while it turned."""
    _, found = distorted
    squared = [bar.part_mgauss2 for bar in found.waterfall]
    assert [bar.effect for bar in found.waterfall] == ["hard_iron", "axis_scale"] and min(squared) > 0.0
    assert sum(squared) == pytest.approx(found.field.nominal**2 - found.field.after**2)
    assert {place.coordinate for place in found.where} <= {"axis", "heading", "time", "rate", "current"}


def test_gain_of_firmware_acts_on_the_field_and_bends_nothing_else(shared_data: Path) -> None:
    """SIM_MAG1_DIA acts before the offsets; an intensity or an inclination would strain what is known."""
    folder = shared_data / "gap-firmware" / "r_axis"
    found = diagnose_gap(read_track(folder / "flight.tlog"), read_track(folder / "baseline.tlog"))
    (cause,) = found.causes
    assert cause.effect == "axis_scale" and cause.parameters["on_iron"] == 0.0
    assert [cause.parameters[axis] for axis in "xy"] == pytest.approx([-0.1236, 0.0745], abs=0.01)
    # What soft iron makes of it is the same, with more parameters.
    assert [ids for ids, _ in found.ambiguity_set] == [("axis_scale",)]


def test_iron_that_the_calibration_cures_is_known_and_exported(shared_data: Path) -> None:
    """The firmware's simulator comes with offsets (5, 13, -18) that its calibration undoes."""
    diagnosis = diagnose_gap(read_track(shared_data / "ardupilot-4.6.3" / "rover_plain.tlog"))
    assert diagnosis.verdict == "no_gap" and not diagnosis.causes
    assert diagnosis.in_force is not None
    np.testing.assert_allclose(diagnosis.in_force.cures.offset_mgauss, [-5.0, -13.0, 18.0])
    exported = ardupilot_sitl(Found(vehicle_settings(diagnosis))).parameters
    for axis, true in zip("XYZ", (5.0, 13.0, -18.0), strict=True):
        assert exported[f"SIM_MAG1_OFS_{axis}"] == pytest.approx(true, abs=3.0)


def test_preset_in_our_simulator_closes_the_recorded_gap_as_claimed(
    distorted: tuple[Track, Diagnosis], tmp_path: Path
) -> None:
    """The simulator runs the recorded motion with the exported preset; only its nuisances are solved for."""
    track, diagnosis = distorted
    path = tmp_path / "found.json"
    path.write_text(preset(Found(settings_of(diagnosis.causes), "rover")).text, encoding="utf-8")
    problem, fit = with_settings(track, read_preset(path))
    left, before = (float(np.mean(left_of(problem, fit, on) ** 2)) for on in (True, False))
    assert 1.0 - left / before == pytest.approx(diagnosis.field.shrink, abs=0.01)
    assert left**0.5 < diagnosis.field.floor


def test_attached_magnet_is_a_step_with_its_moments(shared_data: Path) -> None:
    """A hand attaches a magnet near 45 s and takes it away near 100 s; each takes it a second."""
    path = shared_data / "real" / "broad" / "34_disturbed_attached_magnet_3cm.csv"
    diagnosis = diagnose_gap(read_track(path).between(25.0, 108.0))
    step = next(c for c in diagnosis.causes if c.effect == "hard_iron_step")
    size = np.linalg.norm([step.parameters[axis] for axis in "xyz"])
    assert size == pytest.approx(137.0, abs=5.0)
    assert step.parameters["on_s"] == pytest.approx(45.1, abs=0.5)
    assert step.parameters["off_s"] == pytest.approx(99.7, abs=0.5)
    # While the hand moves, any moment fits as well.
    assert 1.0 < step.ci95["on_s"][1] - step.ci95["on_s"][0] < 4.0
    assert sum("something changes faster" in note for note in diagnosis.notes) == 2
    assert diagnosis.field.nominal > 40.0
    assert diagnosis.field.after < 6.0


def test_magnet_at_a_fixed_place_is_a_dipole(shared_data: Path) -> None:
    """Its middle half, in which the hand passes the magnet again and again."""
    track = read_track(shared_data / "real" / "broad" / "28_disturbed_stationary_magnet_A.csv")
    diagnosis = diagnose_gap(track.between(46.0, 138.0))
    # What is left beside it has structure: every set that may be the cause has the magnet.
    assert diagnosis.ambiguity_set
    assert all("spatial_dipole" in ids for ids, _ in diagnosis.ambiguity_set)
    assert diagnosis.verdict not in ("no_gap", "not_testable")


def test_what_is_named_in_one_half_shrinks_the_other(shared_data: Path) -> None:
    """The undisturbed trial: a room's iron, a few ms of lag, and axes that are not quite perpendicular."""
    track = read_track(shared_data / "real" / "broad" / "01_undisturbed_slow_rotation_A.csv")
    start, end = track.compasses[1].time_s[[0, -1]].tolist()
    middle = 0.5 * (start + end)
    own, other = track.between(start, middle), track.between(middle, end)
    diagnosis = diagnose_gap(own)
    assert diagnosis.causes
    found = settings_of(diagnosis.causes)
    everything = left_on(other, found)
    assert everything < 0.6 * left_on(other, [])
    for setting in found:
        assert left_on(other, [s for s in found if s is not setting]) > everything


def left_on(track: Track, found: list[Setting]) -> float:
    """Return the rms that settings leave of a recording."""
    return float(np.sqrt(np.mean(left_of(*with_settings(track, found)) ** 2)))


def with_settings(track: Track, found: list[Setting]) -> tuple[Problem, Fit]:
    """Run a recording's motion with settings as they are; only the nuisances are solved for."""
    replayed = replay(track)
    floor = from_recording(replayed)
    problem = Problem(replayed, floor.noise, replayed.valid, floor.prior)
    made = (make_term(s.effect, replayed.signals) for s in found)
    terms = tuple(replace(t, free=np.zeros_like(t.free)) for t in made)
    fit = problem.fit(Fit(terms, tuple(s.theta for s in found), problem.prior.mean))
    return problem, fit


def left_of(problem: Problem, fit: Fit, effects: bool = True) -> FloatArray:
    """Return measured minus simulated field on the rows with a reading, (N, 3)."""
    left = problem.replay.measured.mag_mgauss - problem.predict(fit, effects).mag_mgauss
    return np.asarray(left[problem.replay.valid])


def test_second_compass_of_a_flight_follows_the_motors_current(shared_data: Path) -> None:
    track = read_track(shared_data / "real" / "quad-flight-tlog" / "flight.tlog")
    diagnosis = diagnose_gap(track, instance=2)
    # Each likely set has it, but none of them is all: no more is said than what it looks like.
    assert "motor_current" in {c.effect for c in (*diagnosis.causes, *diagnosis.look_alikes)}
    assert all("motor_current" in ids for ids, _ in diagnosis.ambiguity_set)


@pytest.mark.parametrize("end_s", [30.0, 40.0, 60.0])  # two rows are left, one, none
def test_a_recording_that_breaks_off_all_the_time_is_refused(shared_data: Path, end_s: float) -> None:
    track = read_track(shared_data / "real" / "hmc5883l-hand-rotation" / "full-sphere.csv")
    with pytest.raises(BadRecording, match="breaks between readings"):
        diagnose_gap(track.between(0.0, end_s))
