"""What a four-position fit starts from, and what it is told to be unsure of: against closed forms."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest
from calibration_worlds import FIELD, Iron, four_positions

from mavcompass.calibration.methods.four_positions import calibrate_positions
from mavcompass.calibration.model import GAIN, HEADINGS, OFFSET, gain_parameters
from mavcompass.calibration.observation import FourPositionData
from mavcompass.calibration.positions import PositionProblem
from mavcompass.calibration.rigid import DEFAULT_PRIOR, weigh_cross_terms
from mavcompass.correction import IDENTITY
from mavcompass.frames import wrap_pi

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
