"""What a four-position fit starts from, and what it is told to be unsure of: against closed forms."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from calibration_worlds import FIELD, Iron, four_positions

from mavcompass.calibration.methods.four_positions import calibrate_positions
from mavcompass.calibration.model import (
    GAIN,
    GYRO_BIAS,
    GYRO_SCALE,
    HEADINGS,
    HORIZONTAL,
    LAG,
    MOTOR,
    OFFSET,
    VERTICAL,
    by_tilt,
    gain_parameters,
)
from mavcompass.calibration.observation import FourPositionData
from mavcompass.calibration.positions import PositionProblem, next_pose, solve_four_positions
from mavcompass.calibration.positions.problem import fit_positions
from mavcompass.calibration.rigid import DEFAULT_PRIOR, assembled, weigh_cross_terms
from mavcompass.correction import IDENTITY, FieldCorrection
from mavcompass.errors import PoorCalibration
from mavcompass.frames import level_to_body, wrap_pi

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


def true_state(data: FourPositionData, first: float = 0.4) -> Any:
    state = np.zeros(HEADINGS + len(data.dwells))
    state[OFFSET], state[GAIN] = IRON.offset, gain_parameters(GAIN_XY)
    state[HORIZONTAL], state[VERTICAL] = FIELD.horizontal_mgauss, FIELD.ned_mgauss[2]
    state[HEADINGS:] = first + data.turned_rad
    return state


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


def test_a_field_that_turns_the_wrong_way_is_mirrored() -> None:
    assert problem_of(four_positions(Iron((20.0, 10.0, 0.0), np.diag([1.0, -1.0, -1.0])))).mirrored


def test_a_compass_that_leans_from_dwell_to_dwell_is_not_mirrored() -> None:
    """A hand turns it about other axes than the vertical: the body's x and y alone would not tell."""
    rng = np.random.default_rng(8)
    assert not any(problem_of(four_positions(IRON, rng, tilt=lean)).mirrored for lean in (0.3, 0.6, 1.2))


def test_without_a_world_the_fields_own_size_is_taken() -> None:
    in_force = FieldCorrection((-60.0, 40.0, -25.0))
    problem = problem_of(four_positions(IRON), None, in_force)
    assert problem.start[HORIZONTAL] == pytest.approx(
        FIELD.horizontal_mgauss * math.sqrt(1.1 * 0.95 - 0.03**2), rel=5e-3
    )
    vertical = 1.025 * FIELD.ned_mgauss[2]
    assert problem.start[VERTICAL] == pytest.approx(vertical, rel=5e-3)
    known = held(problem)
    assert known[2] == pytest.approx((25.0, 100.0))
    assert HORIZONTAL not in known  # the gains' mean is one by convention
    assert (problem.rules.rows[-4, 3:5] * 0.01) == pytest.approx([0.5, 0.5])
    assert known[VERTICAL] == pytest.approx((vertical, 0.5 * abs(vertical)))
    weak = replace(FIELD, ned_mgauss=(232.0, 52.7, 60.0))
    assert held(problem_of(four_positions(Iron(), earth=weak), None))[VERTICAL][1] == pytest.approx(50.0)


def test_before_the_data_everything_has_its_sigma() -> None:
    data = replace(four_positions(IRON), gyro_scale_sigma=0.02, gyro_bias_sigma_radps=0.003)
    problem = problem_of(data)
    known = held(problem)
    north, east, down = FIELD.sigma_mgauss
    d = FIELD.declination_rad
    along = math.hypot(north * math.cos(d), east * math.sin(d))
    expected = {3: (1.0, 0.25), 4: (1.0, 0.25), 6: (0.0, 0.04), 7: (0.0, 0.04), 8: (0.0, 0.04)}
    expected |= {GYRO_SCALE: (0.0, 0.02), GYRO_BIAS: (0.0, 0.003), LAG: (0.0, 0.03)}
    expected |= {place: (0.0, 0.5) for place in range(MOTOR.start, MOTOR.stop)}
    expected[HORIZONTAL] = (FIELD.horizontal_mgauss, math.hypot(along, 5.0))
    expected[VERTICAL] = (FIELD.ned_mgauss[2], math.hypot(down, 5.0))
    assert sorted(known) == sorted(expected)
    assert all(known[place] == pytest.approx(expected[place]) for place in expected)
    # The vertical gain is known by the horizontal ones.
    assert (problem.rules.rows[-1, GAIN] * 0.05)[:3] == pytest.approx([-0.5, -0.5, 1.0])
    none = held(problem_of(replace(data, gyro_scale_sigma=0.0, gyro_bias_sigma_radps=0.0)))
    assert none[GYRO_SCALE][1] == none[GYRO_BIAS][1] == pytest.approx(1e-9)


def test_the_field_changes_with_roll_and_pitch_as_a_turn_of_the_vehicle_does() -> None:
    data = four_positions(IRON, np.random.default_rng(3), tilt=0.2)
    state, h = true_state(data), 1e-6
    tilts = level_to_body([d.roll_rad for d in data.dwells], [d.pitch_rad for d in data.dwells])
    by = by_tilt(tilts, state, state[HEADINGS:])
    psi = state[HEADINGS:]
    level = np.stack([FIELD.horizontal_mgauss * np.cos(psi), -FIELD.horizontal_mgauss * np.sin(psi),
                      np.full(4, FIELD.ned_mgauss[2])], axis=1)  # fmt: skip
    for axis in range(2):
        turn = level_to_body(*(h * np.eye(2)[axis]))
        moved = np.einsum("ij,kjl,kl->ki", turn, tilts, level) - np.einsum("kjl,kl->kj", tilts, level)
        assert by[:, :, axis] == pytest.approx(moved @ GAIN_XY / h, abs=0.01)


def test_readings_are_weighed_by_noise_steps_and_tilt() -> None:
    data = four_positions(IRON)
    dwells = tuple(
        replace(
            d, covariance_mgauss2=np.eye(3) * 4.0, quantisation_mgauss2=np.eye(3) * 0.5, tilt_sigma_rad=0.01
        )
        for d in data.dwells
    )
    problem = problem_of(replace(data, dwells=dwells, tilt_bias_sigma_rad=0.002))
    by = by_tilt(problem.readings.mapping, problem.start, problem.start[HEADINGS:])
    for k in range(4):
        covariance = np.eye(3) * (4.0 + 0.01**2 + 0.5) + by[k] @ by[k].T * 0.01**2
        assert problem.whiten[k] @ covariance @ problem.whiten[k].T == pytest.approx(np.eye(3))
    assert problem.leaning == pytest.approx(0.002 * by)
    loose = problem.loosened(2, 30.0)
    assert loose.whiten[1] == pytest.approx(problem.whiten[1])
    inverse = np.linalg.inv(loose.whiten[2])
    assert inverse @ inverse.T == pytest.approx(covariance_of(problem, 2) + 900.0 * np.eye(3))


def covariance_of(problem: PositionProblem, k: int) -> Any:
    return np.asarray(sum(part[k] for part in problem.parts.values()))


@pytest.mark.parametrize(
    ("currents", "counted"),
    [((1.0, 2.0, 3.0, 6.0), (-2.0, -1.0, 0.0, 3.0)), ((1.0, 2.0, math.nan, 6.0), (0.0,) * 4)],
)
def test_a_current_counts_where_it_is_known_everywhere(
    currents: tuple[float, ...], counted: tuple[float, ...]
) -> None:
    data = four_positions(IRON)
    dwells = tuple(replace(d, current_a=a) for d, a in zip(data.dwells, currents, strict=True))
    assert problem_of(replace(data, dwells=dwells)).readings.load.tolist() == list(counted)


@pytest.mark.parametrize(("degrees", "enough"), [((40.0, 40.0, 40.0), True), ((20.0, 20.0, 20.0), False)])
def test_positions_have_to_cover_the_circle(degrees: tuple[float, ...], enough: bool) -> None:
    data = four_positions(IRON, turns=np.radians(degrees))
    if enough:
        assert problem_of(data).start[OFFSET][:2] == pytest.approx([60.0, -40.0], abs=0.2)
    else:
        with pytest.raises(PoorCalibration, match="too little of the circle: 60 degrees"):
            problem_of(data)
    with pytest.raises(PoorCalibration, match="Only 2 still positions"):
        problem_of(four_positions(IRON, turns=np.radians([120.0])))


def test_the_next_pose_lowers_what_is_not_known_and_says_how() -> None:
    data = four_positions(IRON, np.random.default_rng(5), noise=2.0, gyro_sigma=0.003)
    now = solve_four_positions(data, earth=FIELD)
    level = next_pose(data, earth=FIELD, may_tilt=False)
    assert (level.roll_rad, level.pitch_rad) == (0.0, 0.0) and "One more level position" in level.words
    tilted = next_pose(data, earth=FIELD)
    assert tilted.sigma_tilted_rad <= level.sigma_tilted_rad
    assert abs(tilted.roll_rad) + abs(tilted.pitch_rad) == pytest.approx(math.radians(15.0))
    assert "by 15 degrees" in tilted.words and level.sigma_level_rad < 1.5 * now.heading_sigma_rad


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


def test_a_fit_may_begin_at_one_that_is_nearly_the_same() -> None:
    data = four_positions(IRON, np.random.default_rng(5), noise=2.0, gyro_sigma=0.003)
    problem = problem_of(data)
    fit = fit_positions(problem)
    again = fit_positions(problem, fit)
    assert again.state == pytest.approx(fit.state, abs=1e-6) and again.cost == pytest.approx(fit.cost)
    assert fit.freedom == 15 - round(
        float(np.trace(fit.jacobian[:15] @ fit.covariance @ fit.jacobian[:15].T))
    )
    values, _ = assembled(problem.readings, fit.state, problem.whiten, problem.rules)
    assert fit.chi_square == pytest.approx(float((values[:15] ** 2).sum()))
    many = four_positions(
        IRON, np.random.default_rng(6), turns=np.radians([60.0] * 6), noise=1.0, gyro_sigma=0.003
    )
    dwells = list(many.dwells)
    dwells[3] = replace(dwells[3], mean_mgauss=dwells[3].mean_mgauss + np.array([40.0, 0.0, 0.0]))
    robust = fit_positions(problem_of(replace(many, dwells=tuple(dwells))))
    assert robust.sound[3] < 0.1 and np.delete(robust.sound, 3).min() > 0.5


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
