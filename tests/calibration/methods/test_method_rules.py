"""The rules between the fits and a result: which method is chosen, what is claimed, what is refused."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import replace
from types import ModuleType, SimpleNamespace
from typing import Any

import numpy as np
import pytest
from calibration_worlds import FIELD, Iron, turning_track

from mavcompass.calibration import calibrate_track, methods
from mavcompass.calibration.methods import auto
from mavcompass.calibration.model import HeadingError
from mavcompass.calibration.motion.sections import reference_turn
from mavcompass.calibration.recorded import Recorded
from mavcompass.calibration.result import DEFAULT_LIMITS, CalibrationResult
from mavcompass.correction import FieldCorrection
from mavcompass.errors import PoorCalibration, UsageError
from mavcompass.procedure.positions.proof import CompassProof, Proof
from mavcompass.track import MagSeries, Series, Track

H = 200.0


def result(
    method: str = "four-positions", sigma_deg: float = 0.5, off_deg: float = 0.0, **more: Any
) -> CalibrationResult:
    """Make an accepted result whose headings differ from another's by so much, rms over the circle."""
    offset = off_deg * math.pi / 180.0 * H * math.sqrt(2.0)
    values: dict[str, Any] = {
        "instance": 1,
        "method": method,
        "accepted": True,
        "reasons": (),
        "correction": FieldCorrection((0.0, -offset, 0.0)),
        "in_force": FieldCorrection(),
        "heading_sigma_deg": sigma_deg,
        "horizontal_mgauss": H,
        "vertical_mgauss": 400.0,
        **more,
    }
    return CalibrationResult(**values)


@pytest.mark.parametrize(
    ("apart_deg", "sigma_deg", "agree"),
    [(1.9, 0.1, True), (2.1, 0.1, False), (3.8, 0.9, True), (4.0, 0.9, False)],
)
def test_two_methods_that_are_both_sure_have_to_agree(
    apart_deg: float, sigma_deg: float, agree: bool
) -> None:
    """Within two degrees, or three of their common sigmas."""
    both = [result(sigma_deg=sigma_deg), result("world-field", sigma_deg, apart_deg)]
    chosen = auto._chosen(both)
    assert chosen.accepted is agree
    assert agree or f"are both sure and {apart_deg:.1f} degrees apart" in chosen.reasons[-1]


def test_a_change_from_what_is_in_force_is_told_rms_and_at_most() -> None:
    told = result(off_deg=2.0).compared()
    assert told.heading_change_deg == pytest.approx(2.0, rel=0.01)
    assert told.heading_change_max_deg == pytest.approx(2.0 * math.sqrt(2.0), rel=0.01)


@pytest.mark.parametrize(
    ("scatter_deg", "claimed_deg", "accepted"), [(0.4, 0.5, True), (1.3, 1.3, True), (2.1, 2.1, False)]
)
def test_no_less_is_claimed_than_was_seen(scatter_deg: float, claimed_deg: float, accepted: bool) -> None:
    state = np.zeros(11)
    state[3:6], state[9] = 1.0, H
    error = HeadingError(state, 1e-4 * np.eye(9))
    before = result(heading_error=error, heading_budget_deg={"noise": 0.4, "disturbance": 0.3})
    told = before.at_least(math.radians(scatter_deg), DEFAULT_LIMITS)
    assert told.heading_sigma_deg == pytest.approx(claimed_deg) and told.accepted is accepted
    assert math.hypot(*told.heading_budget_deg.values()) == pytest.approx(claimed_deg)
    assert told.heading_error is not None
    assert told.heading_error.rms_rad() == pytest.approx(error.rms_rad() * claimed_deg / 0.5)
    assert bool(told.reasons) is not accepted
    alone = result().at_least(math.radians(1.0), DEFAULT_LIMITS).heading_budget_deg
    assert alone == pytest.approx({"disturbance": math.sqrt(1.0 - 0.5**2)})


# --- positions and turns ---------------------------------------------------------------------------------


def circle(degrees: float) -> Recorded:
    psi = np.radians(np.arange(0.0, degrees, 0.5))
    field = np.stack([60.0 + 220.0 * np.cos(psi), -40.0 - 180.0 * np.sin(psi), 400.0 + 0.0 * psi], axis=1)
    field[3] = np.nan
    return Recorded(Track(compasses={1: MagSeries(1, Series.of(np.arange(psi.size) * 0.1, field))}), 1)


@pytest.mark.parametrize("method", ["min_max", "sensitivity_bias"])
def test_the_extremes_of_a_turn_centre_it(method: str) -> None:
    from mavcompass.calibration.methods import min_max, sensitivity_bias

    iron = Iron((60.0, -40.0, 25.0), np.diag([1.1, 0.9, 1.0]))
    track = turning_track(iron, noise=0.0, turns_deg=(120.0, 120.0, 120.0), dwell_s=1.0)
    solve = {"min_max": min_max, "sensitivity_bias": sensitivity_bias}[method].calibrate
    found = solve(Recorded(track, 1, FIELD))
    assert found.raw_offset_mgauss[:2] == pytest.approx([60.0, -40.0], abs=1.0)
    stretch = found.correction.diagonals[1] / found.correction.diagonals[0]
    assert stretch == pytest.approx(1.1 / 0.9, rel=0.01)


# --- an attitude that owes nothing to a compass ----------------------------------------------------------


def test_a_yaw_by_satellites_is_a_turn_without_tilt() -> None:
    time = np.arange(40.0) * 0.5
    yaw = np.mod(0.4 * time, 2.0 * math.pi)
    yaw[5:8] = np.nan
    found = reference_turn(Track(gps_yaw_rad=Series.of(time, yaw)))
    assert found is not None and found.sigma_rad == math.radians(0.7) and found.record.time_s.size == 37
    assert found.record.angle_rad[-1] == pytest.approx(0.4 * 19.5)
    assert found.levels(Track()).at(np.array([1.0])).tolist() == [[0.0, 0.0, 1.0]]
    yaw[9:] = np.nan
    assert reference_turn(Track(gps_yaw_rad=Series.of(time, yaw))) is None and reference_turn(Track()) is None


# --- the proof ----------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("off_deg", "change_deg", "doubts", "passed"),
    [
        (1.4, 0.75, (), True), (1.6, 0.7, (), False), (-1.6, 0.7, (), False), (0.0, 0.8, (), False),
        (360.5, 0.1, (), True), (0.0, 0.1, ("It slipped.",), False),
    ],
)  # fmt: skip
def test_a_proof_passes_where_the_turns_agree_and_the_solution_stands(
    off_deg: float, change_deg: float, doubts: tuple[str, ...], passed: bool
) -> None:
    one = CompassProof(1, 90.0 + off_deg, 90.0, 1.5, change_deg, 0.75, doubts)
    assert one.passed is passed and Proof((one,)).passed is passed
    said = Proof((one,)).summary()
    assert said.startswith("Checked by a turn" if passed else "The turn does not confirm")
    assert ("would be 0.8 deg another" in said) is (change_deg > 0.75) and said.endswith(
        "." if not doubts else "slipped."
    )
    assert one.difference_deg == pytest.approx(math.remainder(off_deg, 360.0))
    assert not Proof((one, CompassProof(2, 80.0, 90.0, 1.5))).passed


def test_methods_are_held_against_each_other_at_the_load_that_was_flown() -> None:
    """One has a motor field of 20 mG at full throttle and as much less iron at half of it."""
    motion: Any = SimpleNamespace(goes_with=("throttle", 0.65), sections=SimpleNamespace(loads_mean=(0.5,)))
    plain = result(sigma_deg=0.1)
    ofs = plain.correction.offsets_mgauss
    loaded = replace(
        plain.correction,
        offsets_mgauss=(ofs[0] - 10.0, ofs[1], ofs[2]),
        motor_mgauss=(plain.correction.matrix @ [20.0, 0.0, 0.0]).tolist(),
        motor_source="throttle",
    )
    both = [plain, replace(result("world-field", 0.1), correction=loaded)]
    assert not auto._chosen(both).accepted
    assert auto._chosen(both, motion).accepted


@pytest.mark.parametrize(
    ("method", "turns_deg", "lacks"),
    [
        ("min-max", (120.0, 120.0), "did not turn all the way round"),
        ("four-positions-textbook", (50.0,) * 6, "no four positions with steps of about 90"),
        ("four-positions-textbook", (90.0, -90.0, 90.0), "no four positions with steps of about 90"),
    ],
)
def test_what_a_papers_method_needs_and_does_not_get_is_said(
    method: str, turns_deg: tuple[float, ...], lacks: str
) -> None:
    with pytest.raises(PoorCalibration, match=lacks):
        calibrate_track(turning_track(Iron(), turns_deg=turns_deg), method, earth=FIELD)


# --- A new method is one new file: nothing else names it


MIDDLE_OF_THE_TURN = '''
    """The middle of all readings is the hard iron."""

    from mavcompass.calibration.recorded import Recorded
    from mavcompass.calibration.result import CalibrationResult
    from mavcompass.correction import FieldCorrection


    def calibrate(recorded: Recorded) -> CalibrationResult:
        raw = recorded.track.raw_field(recorded.instance)
        middle = 0.5 * (raw.min(axis=0) + raw.max(axis=0))
        return CalibrationResult(
            instance=recorded.instance,
            method="middle-of-the-turn",
            accepted=False,
            reasons=("It knows nothing of its error.",),
            correction=FieldCorrection(offsets_mgauss=tuple((-middle).tolist())),
            in_force=recorded.in_force,
        )
'''


def test_a_file_in_the_folder_is_a_method(add_file: Callable[[ModuleType, str, str], None]) -> None:
    track = turning_track(Iron(offset=(120.0, -45.0, 0.0)), turns_deg=(360.0,), noise=0.0)
    with pytest.raises(UsageError, match="no method 'middle-of-the-turn'"):
        calibrate_track(track, "middle-of-the-turn")
    add_file(methods, "middle_of_the_turn", MIDDLE_OF_THE_TURN)
    assert "middle-of-the-turn" in methods.method_names()
    result = calibrate_track(track, "middle-of-the-turn")
    assert result.raw_offset_mgauss[:2] == pytest.approx([120.0, -45.0], abs=1.0)
    assert result.parameters["COMPASS_OFS_X"] == pytest.approx(-120.0, abs=1.0)


def test_what_methods_share_is_no_method() -> None:
    assert not any("level" in name for name in methods.method_names())
