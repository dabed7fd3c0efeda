"""What is made of still positions, number by number, as it was when it was stored."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from calibration_worlds import FIELD, Iron, four_positions

from mavcompass.calibration.methods.four_positions import calibrate_positions
from mavcompass.calibration.observation import FourPositionData
from mavcompass.calibration.positions import next_pose, solve_four_positions
from mavcompass.correction import FieldCorrection

AsStored = Callable[[Any], None]
IN_FORCE = FieldCorrection((-40.0, 20.0, -10.0), (1.05, 0.95, 1.0))
GAIN = np.array([[1.08, 0.03, 0.01], [0.03, 0.95, -0.02], [0.01, -0.02, 1.03]])


def positions(degrees: tuple[float, ...], seed: int, disturbed: int = -1, **more: Any) -> FourPositionData:
    """Made-up positions with all that is not known of real ones; at one of them, steel stands beside."""
    chance = np.random.default_rng(seed)
    data = four_positions(
        Iron((60.0, -40.0, 25.0), GAIN),
        chance,
        turns=np.radians(degrees),
        noise=8.0,
        gyro_sigma=0.004,
        gyro_scale_sigma=0.01,
        tilt=0.04,
    )
    dwells = list(data.dwells)
    for k, dwell in enumerate(dwells):
        dwells[k] = replace(
            dwell,
            quantisation_mgauss2=np.diag([0.1, 0.12, 0.08]),
            tilt_sigma_rad=0.002 + 0.0005 * k,
            current_a=3.0 + chance.normal(),
            swing=np.diag([0.9995 - 0.0002 * k, 0.9995 - 0.0002 * k, 1.0]),
            unsteady_mgauss=1.5 * k,
            turned_sigma_rad=0.001,
        )
    if disturbed >= 0:
        moved = dwells[disturbed].mean_mgauss + np.array([25.0, -15.0, 10.0])
        dwells[disturbed] = replace(dwells[disturbed], mean_mgauss=moved)
    known = {"gyro_bias_sigma_radps": 0.0008, "tilt_bias_sigma_rad": 0.003, **more}
    return replace(data, dwells=tuple(dwells), **known)


MADE = {
    "three": positions((118.0, 123.0), 1),
    "four": positions((88.0, 92.0, 85.0), 2),
    "six": positions((58.0, 62.0, 61.0, 55.0, 60.0), 3),
    "four, one disturbed": positions((91.0, 88.0, 93.0), 4, disturbed=2),
    "eight, one disturbed": positions((45.0, 47.0, 44.0, 46.0, 45.0, 43.0, 45.0), 5, disturbed=5),
    "back and forth": positions((90.0, -180.0, -90.0, 75.0), 6),
}


@pytest.fixture(params=MADE)
def data(request: pytest.FixtureRequest) -> FourPositionData:
    return MADE[request.param]


@pytest.mark.parametrize("world", [True, False])
def test_a_result(data: FourPositionData, world: bool, as_stored: AsStored) -> None:
    earth = FIELD if world else None
    found, result = solve_four_positions(data, IN_FORCE, earth), calibrate_positions(data, IN_FORCE, earth)
    as_stored(
        {
            "budget": found.budget_rad,
            "consistency": found.consistency,
            "suspects": found.suspects,
            "disturbance": found.disturbance_mgauss,
            "sigma": [found.heading_sigma_rad, found.heading_error.rms_rad(0.2, -0.1)],
            "result": {k: v for k, v in result.to_json().items() if k not in ("covariance", "positions")},
        }
    )


def test_what_would_help(data: FourPositionData, as_stored: AsStored) -> None:
    poses = [next_pose(data, IN_FORCE, FIELD, may_tilt=tilt) for tilt in (False, True)]
    as_stored(poses)
