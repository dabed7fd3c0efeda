"""The proof: one more turn, and the solution with the position that it adds."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from bent_vehicles import bent_vehicle, calibrated

from mavcompass.calibration import calibrate_track
from mavcompass.calibration.result import CalibrationResult
from mavcompass.correction import FieldCorrection
from mavcompass.procedure.positions import Proof, prove
from mavcompass.procedure.positions.proof import CompassProof
from mavcompass.procedure.report import CalibrationReport
from mavcompass.procedure.settings import CalibrateSettings
from mavcompass.simulation.heading_error import heading_error_rms_deg


@pytest.fixture(scope="module")
def report(tmp_path_factory: pytest.TempPathFactory) -> CalibrationReport:
    """Return a calibration of five positions: the fifth serves as the proof's."""
    settings = CalibrateSettings(writing="never", positions=5)
    return calibrated(bent_vehicle("rover", 3), tmp_path_factory.mktemp("proof"), settings)


Solved = tuple[CalibrationReport, CalibrationResult, CalibrationResult]


@pytest.fixture(scope="module")
def solved(report: CalibrationReport) -> Solved:
    """Return it with what the first four positions gave, and all five."""
    spans = [(window.start_s, window.end_s) for window in report.windows]
    return report, *(calibrate_track(report.track, windows=spans[:count]) for count in (4, 5))


def proof_of(solved: Solved, doubts: tuple[str, ...] = (), off_mgauss: float = 0.0) -> Proof:
    """Prove what the first four positions gave, its offset to the right wrong by `off_mgauss`."""
    report, four, five = solved
    x, y, z = four.correction.offsets_mgauss
    four = replace(four, correction=replace(four.correction, offsets_mgauss=(x, y + off_mgauss, z)))
    five = replace(five, reasons=doubts)
    return prove(report.track, report.windows[3], report.windows[4], [four], [five])


def test_a_right_calibration_is_proven(solved: Solved) -> None:
    proof = proof_of(solved)
    assert proof.passed and proof.summary().startswith("Checked by a turn: compass 1 ")
    assert proof.compasses[0].change_deg < 0.3 and proof.compasses[0].tolerance_deg < 5.0


def test_after_three_turns_that_prove_nothing_the_old_values_are_put_back(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    proofs = [Proof((CompassProof(1, 6.7, 6.9, tolerance_deg=1.5),))] * 9
    monkeypatch.setattr("mavcompass.procedure.calibrate.prove", lambda *_: proofs.pop())
    vehicle = bent_vehicle("rover", 3)
    before = heading_error_rms_deg(vehicle)
    report = calibrated(vehicle, tmp_path)
    assert report.undone and not report.written and len(proofs) == 6
    assert heading_error_rms_deg(vehicle) == pytest.approx(before, abs=0.1)


def test_a_bend_that_the_turn_does_not_show_is_seen_by_solving_anew(solved: Solved) -> None:
    proofs = [proof_of(solved, off_mgauss=off) for off in (-8.0, 8.0)]
    # The bend of an offset is steep at some headings and flat at others.
    assert min(abs(p.compasses[0].difference_deg) for p in proofs) < 2.5
    for proof in proofs:
        assert not proof.passed
        assert "the heading of compass 1 would be" in proof.summary()


def test_a_position_that_contradicts_the_others_proves_nothing(solved: Solved) -> None:
    proof = proof_of(solved, doubts=("The positions do not fit one rigid compass.",))
    assert not proof.passed
    assert proof.summary().startswith("The turn does not confirm the new values: ")
    assert proof.summary().endswith("The positions do not fit one rigid compass.")


def test_the_old_values_of_px4_are_judged_by_what_was_in_force(tmp_path: Path) -> None:
    vehicle = bent_vehicle("px4-copter", 3)
    before_deg = heading_error_rms_deg(vehicle)
    settings = CalibrateSettings(writing="never", positions=4, most_positions=4)
    result = calibrated(vehicle, tmp_path, settings).results[0]
    in_force = vehicle.firmware.compasses.correction(1)
    assert isinstance(in_force, FieldCorrection)
    assert result.in_force.offsets_mgauss == pytest.approx(in_force.offsets_mgauss, abs=0.1)
    assert np.allclose(result.in_force.matrix, in_force.matrix, atol=1e-3)
    assert result.heading_change_deg == pytest.approx(before_deg, abs=1.0)
