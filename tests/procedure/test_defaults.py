"""What holds where a person says nothing: each is a promise of the documentation."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest

from mavcompass.calibration.observation import Dwell, FourPositionData, Step
from mavcompass.calibration.result import DEFAULT_LIMITS
from mavcompass.calibration.rigid import DEFAULT_PRIOR
from mavcompass.procedure.check import CheckSettings
from mavcompass.procedure.motion import Permissions
from mavcompass.procedure.positions import DwellSettings
from mavcompass.procedure.script import Context
from mavcompass.procedure.settings import CalibrateSettings
from mavcompass.procedure.turning import GyroAngle
from mavcompass.service.work.tasks import CalibrationRequest

DEG = math.radians(1.0)
DWELL = {
    "dwell_s": 1.7, "shortest_s": 0.92, "enough_deg": 0.15, "longest_s": 6.0, "settle_s": 0.1,
    "patience_s": 3.0, "tilting_patience_s": 10.0,
}  # fmt: skip
MAY = {"set_mode": False, "arm": False, "takeoff_m": 0.0}
CALIBRATE = {
    "instances": (1,), "motion": "auto", "turn_by": "auto", "permissions": Permissions(), "positions": 4,
    "step_rad": 90.0 * DEG, "enough_deg": 0.3, "most_positions": 8, "writing": "ask", "system": None,
    "rate_hz": 25.0, "year": 2026.0, "reboot": False, "orientation": False,
    "rewrite": False, "dwell": DwellSettings(),
}  # fmt: skip
ASKED = {
    "compasses": (), "motion": "auto", "writing": "ask", "max_error_deg": 2.0, "positions": 4,
    "set_mode": False, "arm": False, "takeoff_m": None, "land": False, "orientation": False, "rewrite": False,
}  # fmt: skip
PRIOR = {
    "gain_sigma": 0.25, "vertical_gain_sigma": 0.05, "cross_sigma": 0.04, "site_sigma_mgauss": 5.0,
    "motor_sigma_mgauss_per_a": 0.5, "vertical_offset_sigma_mgauss": 100.0,
}  # fmt: skip
DWELT = {
    "roll_rad": 0.0, "pitch_rad": 0.0, "tilt_sigma_rad": 0.02 * DEG, "samples": 1, "turned_sigma_rad": 0.0,
    "unsteady_mgauss": 0.0,
}  # fmt: skip


@pytest.mark.parametrize(
    ("settings", "promised"),
    [
        (DwellSettings(), DWELL),
        (Permissions(), MAY),
        (CalibrateSettings(), CALIBRATE),
        (CalibrationRequest(), ASKED),
        (CheckSettings(), {"turn": "none", "system": None, "rate_hz": 25.0, "year": 2026.0}),
        (DEFAULT_PRIOR, PRIOR),
        (DEFAULT_LIMITS, {"heading_deg": 2.0}),
        (Dwell(0.0, 1.0, np.zeros(3), np.eye(3)), DWELT),
        (Step(1.0, 0.1), {"duration_s": 0.0}),
        (FourPositionData((), ()), {"gyro_bias_sigma_radps": 0.0, "tilt_bias_sigma_rad": 0.0, "source": ""}),
        (Context(), {"now": 0.0, "system": 0, "component": 0, "silent_until_s": -math.inf}),
    ],
)
def test_what_holds_where_nothing_is_said(settings: Any, promised: dict[str, Any]) -> None:
    assert {name: getattr(settings, name) for name in promised} == promised


def test_a_gyros_angle_begins_at_nothing_and_upright() -> None:
    gyro = GyroAngle()
    begun = (gyro.angle_rad, gyro.rate_radps, gyro.bias_radps, gyro.samples, gyro.broken_s, gyro.latest_s)
    assert begun == (0.0, 0.0, 0.0, 0, -math.inf, -math.inf) and gyro._down == (0.0, 0.0, 1.0)
