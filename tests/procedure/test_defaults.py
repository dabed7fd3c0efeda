"""What holds where a person says nothing: each is a promise of the documentation."""

from __future__ import annotations

import math
from typing import Any

import pytest

from mavcompass.procedure.check import CheckSettings
from mavcompass.procedure.motion import Permissions
from mavcompass.procedure.settings import CalibrateSettings
from mavcompass.service.config import LearningConfig, MavlinkConfig, VehicleConfig, WatchConfig
from mavcompass.service.work.tasks import CalibrationRequest
from mavcompass.vehicle.link import LinkStatistics
from mavcompass.vehicle.links.faults import Faults

DEG = math.radians(1.0)
MAY = {"set_mode": False, "arm": False, "takeoff_m": 0.0}
CALIBRATE = {
    "instances": (1,), "motion": "auto", "turn_by": "auto", "permissions": Permissions(), "positions": 4,
    "step_rad": 90.0 * DEG, "enough_deg": 0.3, "most_positions": 8, "writing": "ask", "system": None,
    "rate_hz": 25.0, "year": 2026.0, "reboot": False, "orientation": False, "rewrite": False,
    "method": "four-positions", "true_heading": None, "max_heading_error_deg": 2.0, "continuous": False,
}  # fmt: skip
ASKED = {
    "compasses": (), "motion": "auto", "writing": "ask", "max_error_deg": 2.0, "positions": 4, "dwell_s": 2.0,
    "method": "four-positions", "true_heading_deg": None, "true_heading_sigma_deg": pytest.approx(1.0),
    "set_mode": False, "arm": False, "takeoff_m": None, "land": False, "orientation": False, "rewrite": False,
}  # fmt: skip
WATCHED = {
    "field_percent": 8.0, "dip_deg": 4.0, "agreement_deg": 8.0, "gyro_deg": 6.0, "course_deg": 12.0,
    "current_deg": 4.0, "step_deg": 1.5, "age_days": 365.0,
}  # fmt: skip


@pytest.mark.parametrize(
    ("settings", "promised"),
    [
        (VehicleConfig(), {"system": 0, "compasses": (), "rate_hz": 40.0, "speed": 1.0}),
        (MavlinkConfig(), {"accept_commands": True, "heading_hz": 5.0, "statustext": True}),
        (LearningConfig(), {"enabled": True, "margin_deg": 2.0, "limit_deg": 0.5}),
        (WatchConfig(), WATCHED),
        (
            LinkStatistics(),
            dict.fromkeys(("received", "malformed", "unknown", "signed", "refused"), 0),
        ),
        (Faults(), {"loss": 0.0, "duplicate": 0.0, "reorder": 0.0, "latency_s": 0.0}),
        (Permissions(), MAY),
        (CalibrateSettings(), CALIBRATE),
        (CalibrationRequest(), ASKED),
        (CheckSettings(), {"turn": "none", "system": None, "rate_hz": 25.0, "year": 2026.0}),
    ],
)
def test_what_holds_where_nothing_is_said(settings: Any, promised: dict[str, Any]) -> None:
    assert {name: getattr(settings, name) for name in promised} == promised
