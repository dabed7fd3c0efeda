"""The four-position fit: exact where the data are, close where they are noisy, honest always."""

from __future__ import annotations

import math
import sys
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from calibration_worlds import FIELD, Iron, four_positions, heading_errors, iron_of, rms
from hypothesis import given, settings
from hypothesis import strategies as st

from mavcompass.calibration import solve_four_positions
from mavcompass.calibration.cross_terms import weigh_cross_terms
from mavcompass.calibration.methods.four_positions import calibrate_positions
from mavcompass.calibration.model import GAIN, HEADINGS, OFFSET, gain_parameters, heading_gradient
from mavcompass.calibration.observation import FourPositionData
from mavcompass.calibration.observation.wire import unquantise
from mavcompass.calibration.positions import PositionProblem
from mavcompass.calibration.rigid import DEFAULT_PRIOR, assembled
from mavcompass.correction import IDENTITY, FieldCorrection
from mavcompass.errors import PoorCalibration
from mavcompass.frames import FloatArray, wrap_pi

STRONG = FieldCorrection((120.0, -80.0, 40.0), (1.1, 0.9, 1.0))
SEVERE = FieldCorrection((250.0, -150.0, 100.0), (1.15, 0.88, 1.05), (0.04, -0.03, 0.05))


def test_exact_data_give_the_exact_cure() -> None:
    fit = solve_four_positions(four_positions(iron_of(STRONG)), earth=FIELD)
    assert np.allclose(fit.correction.offsets_mgauss[:2], (120.0, -80.0), atol=0.3)
    assert fit.correction.diagonals[0] / fit.correction.diagonals[1] == pytest.approx(1.1 / 0.9, rel=1e-3)
    assert rms(heading_errors(fit.correction, iron_of(STRONG))) < 0.02


def test_no_cross_terms_are_invented() -> None:
    fit = solve_four_positions(
        four_positions(iron_of(STRONG), np.random.default_rng(3), noise=2.0), earth=FIELD
    )
    assert np.abs(fit.correction.off_diagonals).max() < 0.01


@pytest.mark.parametrize("roll, pitch", [(15.0, 0.0), (-15.0, 0.0), (0.0, 15.0), (0.0, -15.0)])
def test_the_severe_case_stays_good_when_the_vehicle_leans(roll: float, pitch: float) -> None:
    fit = solve_four_positions(
        four_positions(iron_of(SEVERE), np.random.default_rng(5), noise=2.0), earth=FIELD
    )
    errors = heading_errors(fit.correction, iron_of(SEVERE), math.radians(roll), math.radians(pitch))
    assert rms(errors) < 1.5


def test_three_positions_suffice() -> None:
    data = four_positions(iron_of(STRONG), turns=np.radians([120.0, 120.0]))
    fit = solve_four_positions(data, earth=FIELD)
    assert rms(heading_errors(fit.correction, iron_of(STRONG))) < 0.05


@given(
    first=st.floats(0.0, 6.28),
    steps=st.lists(st.floats(60.0, 120.0), min_size=3, max_size=6),
    sense=st.sampled_from([-1.0, 1.0]),
    offset=st.tuples(*(3 * [st.floats(-200.0, 200.0)])),
)
@settings(max_examples=60, deadline=None)
def test_any_start_any_steps_either_direction(
    first: float, steps: list[float], sense: float, offset: tuple[float, float, float]
) -> None:
    iron = Iron(offset, np.diag([1.1, 0.95, 1.0]))
    data = four_positions(iron, first=first, turns=sense * np.radians(steps))
    fit = solve_four_positions(data, earth=FIELD)
    assert rms(heading_errors(fit.correction, iron)) < 0.1


@pytest.mark.parametrize("share", [0.25, 0.5])
def test_steps_closed_on_the_bad_compass_do_no_harm(share: float) -> None:
    """The autopilot turns until the bent heading has changed by 90 degrees; the gyro sees what it did."""
    h = FIELD.horizontal_mgauss
    errors = []
    rng = np.random.default_rng(11)
    for _ in range(30):
        angle = rng.uniform(0, 2 * math.pi)
        iron = Iron((share * h * math.cos(angle), share * h * math.sin(angle), 0.0))
        first = rng.uniform(0, 2 * math.pi)
        psi = [_true_heading(iron, first + k * math.pi / 2) for k in range(4)]
        turns = np.mod(np.diff(psi), 2 * math.pi)
        data = four_positions(iron, rng, first=psi[0], turns=turns, noise=0.5, gyro_sigma=math.radians(0.3))
        errors.append(heading_errors(solve_four_positions(data, earth=FIELD).correction, iron))
    assert rms(np.array(errors)) <= 0.15


def _true_heading(iron: Iron, wanted: float) -> float:
    """Find the true heading at which the uncorrected compass shows `wanted`."""
    from calibration_worlds import body_field

    from mavcompass.frames import wrap_pi
    from mavcompass.heading import level_heading

    circle = np.linspace(0, 2 * math.pi, 14401)
    shown = level_heading(iron.raw(body_field(circle)))
    return float(circle[np.argmin(np.abs(wrap_pi(shown - wanted)))])


def test_wrong_steps_are_seen_by_the_gyro() -> None:
    """Step errors 3 degrees rms, gyro 0.3 degrees per step, noise 3 mG: the textbook leaves 1.1 degrees."""
    rng = np.random.default_rng(7)
    iron = Iron((60.0, -40.0, 0.0), np.diag([1.05, 0.97, 1.0]))
    errors = []
    for _ in range(60):
        turns = math.pi / 2 + rng.normal(0, math.radians(3.0), 3)
        data = four_positions(
            iron, rng, first=rng.uniform(0, 6.28), turns=turns, noise=3.0, gyro_sigma=math.radians(0.3)
        )
        errors.append(heading_errors(solve_four_positions(data, earth=FIELD).correction, iron))
    assert rms(np.array(errors)) <= 0.25


def test_the_claimed_sigma_covers() -> None:
    rng = np.random.default_rng(23)
    inside, inside_two, count = 0, 0, 200
    for _ in range(count):
        iron = Iron(tuple(rng.normal(0, 80, 3)), np.diag(1.0 + rng.normal(0, 0.08, 3)))
        turns = math.pi / 2 + rng.normal(0, math.radians(8.0), 3)
        data = four_positions(
            iron, rng, first=rng.uniform(0, 6.28), turns=turns, noise=3.0, gyro_sigma=math.radians(0.3)
        )
        fit = solve_four_positions(data, earth=FIELD)
        psi = rng.integers(72)
        error = heading_errors(fit.correction, iron)[psi]
        sigma = math.degrees(fit.heading_error.sigma_rad(psi * 2 * math.pi / 72)[0])
        inside += abs(error) < sigma
        inside_two += abs(error) < 1.96 * sigma
    assert 0.60 < inside / count < 0.76
    assert 0.92 < inside_two / count < 0.985


def test_the_budget_adds_up() -> None:
    data = four_positions(iron_of(STRONG), np.random.default_rng(2), noise=3.0, gyro_sigma=math.radians(0.3))
    fit = solve_four_positions(data, earth=FIELD)
    total = math.sqrt(sum(v**2 for v in fit.budget_rad.values()))
    assert total == pytest.approx(fit.heading_sigma_rad, rel=1e-6)
    assert {"noise", "step_angle", "tilt", "world_model", "quantisation", "disturbance"} <= set(
        fit.budget_rad
    )


def test_the_jacobian_is_the_derivative() -> None:
    data = four_positions(
        iron_of(SEVERE), np.random.default_rng(4), noise=1.0, gyro_sigma=0.01, tilt=math.radians(4.0)
    )
    problem = PositionProblem.of(data, IDENTITY, FIELD, DEFAULT_PRIOR)
    x = problem.start + 0.01

    def at(state: FloatArray) -> tuple[FloatArray, FloatArray]:
        return assembled(problem.readings, state, problem.whiten, problem.rules)

    residual, jacobian = at(x)
    for column in range(x.size):
        step = np.zeros(x.size)
        step[column] = 1e-6
        numeric = (at(x + step)[0] - at(x - step)[0]) / 2e-6
        assert np.allclose(jacobian[:, column], numeric, rtol=1e-4, atol=1e-4 * np.abs(numeric).max() + 1e-6)
    assert residual.shape == (len(jacobian),)


def test_the_heading_gradient_is_the_derivative() -> None:
    fit = solve_four_positions(four_positions(iron_of(SEVERE)), earth=FIELD)
    truth = iron_of(fit.correction)
    psi = np.arange(72) * (2 * math.pi / 72)
    gradient = heading_gradient(fit.state, psi)
    shift = np.array([2.0, -1.5, 0.0])
    moved = FieldCorrection.from_matrix(
        np.asarray(fit.correction.offsets_mgauss) - shift, fit.correction.matrix
    )
    # The estimate's offset is too large by `shift`, so its offsets are too small by it.
    predicted = np.degrees(gradient[:, :3] @ shift)
    assert np.allclose(heading_errors(moved, truth), predicted, atol=0.02)


def test_without_a_place_scale_and_z_are_left_alone() -> None:
    in_force = FieldCorrection((5.0, 13.0, -18.0), (1.0, 1.0, 1.05))
    fit = solve_four_positions(four_positions(iron_of(STRONG)), in_force)
    assert fit.correction.offsets_mgauss[2] == -18.0
    assert fit.correction.diagonals[2] == pytest.approx(1.05)
    assert sum(fit.correction.diagonals[:2]) == pytest.approx(2.0)
    assert rms(heading_errors(fit.correction, iron_of(STRONG))) < 0.05


def test_an_upside_down_compass_is_noticed() -> None:
    iron = Iron((20.0, 10.0, 0.0), np.diag([1.0, -1.0, -1.0]))
    assert solve_four_positions(four_positions(iron), earth=FIELD).mirrored


def test_a_disturbed_dwell_is_named_where_five_positions_allow_it() -> None:
    data = four_positions(
        iron_of(STRONG), np.random.default_rng(1), turns=np.radians([72.0] * 4), noise=1.0, gyro_sigma=0.004
    )
    dwells = list(data.dwells)
    bent = dwells[2]
    dwells[2] = type(bent)(
        **{name: getattr(bent, name) for name in bent.__slots__ if name != "mean_mgauss"},
        mean_mgauss=bent.mean_mgauss + np.array([25.0, -15.0, 5.0]),
    )
    spoiled = type(data)(tuple(dwells), data.steps, data.gyro_scale_sigma, data.gyro_bias_sigma_radps)
    fit = solve_four_positions(spoiled, earth=FIELD)
    assert fit.suspects == (2,)
    assert fit.disturbed_probability[2] > 0.99
    assert fit.disturbance_mgauss == pytest.approx(math.hypot(25.0, 15.0, 5.0), rel=0.3)
    assert rms(heading_errors(fit.correction, iron_of(STRONG))) < 0.5


@pytest.mark.parametrize("turns", [[], [90.0], [2.0, 3.0, 2.0]])
def test_too_little_turning_is_refused(turns: list[float]) -> None:
    data = four_positions(iron_of(STRONG), turns=np.radians(turns))
    with pytest.raises(PoorCalibration):
        solve_four_positions(data)


def test_a_vehicle_that_waits_for_its_solution_does_not_wait_for_a_library(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """Loading scipy takes half a second on a fast computer, and several on a small one."""
    for name in ("scipy", "scipy.special"):
        monkeypatch.setitem(sys.modules, name, None)
    assert solve_four_positions(four_positions(Iron((30.0, -20.0, 5.0)), noise=1.0)).heading_sigma_rad < 0.02
    unquantise([120.0, -3.0, 0.2], [0.7, 0.7, 0.7], 1.0, True)


def leaning(data: FourPositionData, roll_rad: float, pitch_rad: float) -> FourPositionData:
    """Let the accelerometer be wrong by the same tilt at every position."""
    wrong = [
        replace(d, roll_rad=d.roll_rad + roll_rad, pitch_rad=d.pitch_rad + pitch_rad) for d in data.dwells
    ]
    return replace(data, dwells=tuple(wrong), tilt_bias_sigma_rad=0.001)


def test_the_accelerometers_own_error_is_claimed_as_the_dip_makes_it() -> None:
    data = four_positions(iron_of(STRONG), np.random.default_rng(7), noise=1.0)
    without, fit = (solve_four_positions(d, earth=FIELD) for d in (data, leaning(data, 0.0, 0.0)))
    # On the level an error of 1 mg is one of the offset by Z / 1000: sigma Z / H of heading, rms.
    expected = 0.001 * abs(FIELD.ned_mgauss[2]) / FIELD.horizontal_mgauss
    assert fit.budget_rad["accelerometer"] == pytest.approx(expected, rel=0.05)
    assert fit.heading_sigma_rad == pytest.approx(math.hypot(without.heading_sigma_rad, expected), rel=0.05)
    assert np.allclose(fit.state, without.state, atol=1e-3)


@pytest.mark.parametrize("roll, pitch", [(0.003, 0.0), (0.0, 0.003), (-0.002, 0.002)])
def test_what_an_accelerometers_error_does_is_what_is_claimed_of_it(roll: float, pitch: float) -> None:
    data = four_positions(iron_of(STRONG), np.random.default_rng(7), noise=1.0)
    right, wrong = (solve_four_positions(d, earth=FIELD) for d in (data, leaning(data, roll, pitch)))
    circle = np.radians(np.arange(0.0, 360.0, 30.0))
    moved = heading_gradient(right.state, circle) @ (wrong.state - right.state)[:9]
    assert rms(moved) == pytest.approx(
        math.hypot(roll, pitch) / 0.001 * wrong.budget_rad["accelerometer"] / math.sqrt(2.0), rel=0.1
    )


def test_a_field_that_hardly_turns_is_a_dead_compass() -> None:
    with pytest.raises(PoorCalibration, match="hardly changes while the vehicle turns"):
        solve_four_positions(four_positions(Iron((60.0, -40.0, 25.0), 1e-3 * np.eye(3))))


# --- What a four-position fit starts from, and what it is told to be unsure of: against closed forms


GAIN_XY = np.array([[1.1, 0.03, 0.0], [0.03, 0.95, 0.0], [0.0, 0.0, 1.025]])
IRON = Iron((60.0, -40.0, 25.0), GAIN_XY)


def problem_of(
    data: FourPositionData | None = None, earth: Any = FIELD, in_force: Any = IDENTITY
) -> PositionProblem:
    return PositionProblem.of(data or four_positions(IRON), in_force, earth, DEFAULT_PRIOR)


def held(problem: PositionProblem) -> dict[int, tuple[float, float]]:
    """Return the prior's mean and sigma of each number of the state that has one."""
    rules = problem.rules
    sigma = [1.0 / rules.rows[row, place] for row, place in enumerate(rules.places)]
    return {
        p: (float(w * s), float(s)) for p, w, s in zip(rules.places, rules.wanted[:-1], sigma, strict=True)
    }


@pytest.mark.parametrize("first", [0.0, 0.4, 2.0, 3.5, 5.5])
def test_exact_readings_start_at_the_truth(first: float) -> None:
    """But for what the prior holds against 1 mG of each reading, far less than it is sure of."""
    data = four_positions(IRON, first=first)
    problem = problem_of(data)
    state = problem.start
    assert state[OFFSET] == pytest.approx(IRON.offset, abs=0.5)
    assert state[GAIN] == pytest.approx(gain_parameters(GAIN_XY), abs=2e-3)
    assert wrap_pi(state[HEADINGS:] - first - data.turned_rad) == pytest.approx(np.zeros(4), abs=1e-3)
    assert np.abs(problem.readings.field(state)[0]).max() < 0.1 and not problem.mirrored


def test_a_compass_that_leans_from_dwell_to_dwell_is_not_mirrored() -> None:
    """A hand turns it about other axes than the vertical: the body's x and y alone would not tell."""
    rng = np.random.default_rng(8)
    assert not any(problem_of(four_positions(IRON, rng, tilt=lean)).mirrored for lean in (0.3, 0.6, 1.2))


def test_cross_terms_are_blended_by_their_odds() -> None:
    """Savage and Dickey, in one dimension: the density of 0 within `narrow`, after over before."""
    state, covariance = np.zeros(20), np.eye(20) * 1e-6
    sigma, own, wide = 0.01, DEFAULT_PRIOR.own_cross_sigma, DEFAULT_PRIOR.cross_sigma
    narrow2 = 1.0 / (own**-2.0 - wide**-2.0)
    both2 = sigma**2 + narrow2
    for value in (0.0, 0.02, 0.05):
        state[6], covariance[6, 6], covariance[0, 6], covariance[6, 0] = value, sigma**2, 0.02, 0.02
        covariance[0, 0] = 9.0
        after = math.exp(-0.5 * value**2 / both2) / math.sqrt(both2)
        odds = after * math.sqrt(wide**2 + narrow2) * 3.0
        share = odds / (1.0 + odds)
        blended, known, _ = weigh_cross_terms(state, covariance, DEFAULT_PRIOR, np.zeros((20, 0)))
        held = share * sigma**2 / both2
        assert blended[6] == pytest.approx((1.0 - held) * value, abs=1e-12)
        assert blended[0] == pytest.approx(-share * 0.02 / both2 * value, abs=1e-9)
        spread = share * (1.0 - share) * (sigma**2 / both2 * value) ** 2
        assert known[6, 6] == pytest.approx((1.0 - held) * sigma**2 + spread, rel=1e-6)


def test_a_lean_that_all_readings_share_is_not_told_by_cross_terms() -> None:
    """With axes taken for exactly square the blend knew the lean: 0.02 claimed where 0.2 are true."""
    state, covariance = np.zeros(20), np.eye(20) * 1e-6
    vertical, lean, cross = 530.0, 0.0016, 0.0002
    # A lean shows as a cross term and as twice its field in the offset: on the level, as its field.
    shared = np.zeros((20, 1))
    shared[1], shared[8] = 2.0 * vertical * lean, -lean
    covariance[8, 8], covariance[1, 8] = cross**2 + lean**2, -2.0 * vertical * lean**2
    covariance[8, 1], covariance[1, 1] = covariance[1, 8], (2.0 * vertical * lean) ** 2 + 0.04
    _, _, left = weigh_cross_terms(state, covariance, DEFAULT_PRIOR, shared)
    level = left[1, 0] + vertical * left[8, 0]
    assert level == pytest.approx(vertical * lean, rel=0.2)


def test_a_result_tells_how_z_is_known_and_what_the_field_is() -> None:
    data = four_positions(IRON, np.random.default_rng(5), noise=2.0, gyro_sigma=0.003)
    by_world, alone = calibrate_positions(data, earth=FIELD), calibrate_positions(data)
    assert by_world.instance == 1 and calibrate_positions(data, instance=3).instance == 3
    sigma = math.sqrt(float(by_world.covariance[2, 2]))
    assert f"taken from the magnetic model (±{sigma:.0f} mG)" in by_world.warnings[-1] and 5.0 < sigma < 60.0
    assert "Z offset left as it was" in alone.warnings[-1]
    assert by_world.horizontal_mgauss == pytest.approx(FIELD.horizontal_mgauss, rel=0.03)
    # Without a world the field is that of a correction whose horizontal diagonals average 1.
    field = alone.correction.apply(np.array([d.mean_mgauss for d in data.dwells]))
    assert alone.horizontal_mgauss == pytest.approx(
        float(np.hypot(field[:, 0], field[:, 1]).mean()), rel=0.01
    )
    assert [p.turned_deg for p in by_world.positions] == pytest.approx([0.0, 90.0, 180.0, 270.0], abs=1.0)
    assert by_world.heading_change_max_deg > by_world.heading_change_deg > 5.0  # as bent as it was
    assert by_world.heading_sigma_deg == pytest.approx(
        math.hypot(*by_world.heading_budget_deg.values()), rel=0.01
    )
