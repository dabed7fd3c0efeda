"""What the judge of a simulated vehicle's heading holds against a compass, and what not."""

from __future__ import annotations

import math

import numpy as np
import pytest

from mavcompass.correction import IDENTITY, FieldCorrection
from mavcompass.simulation.heading_error import heading_error_rms_deg, heading_errors_rad
from mavcompass.simulation.physics.sensors import CompassModel, CompassSetup
from mavcompass.simulation.vehicle import SimulatedAutopilot


def vehicle(*effects: str) -> SimulatedAutopilot:
    """Make a rover without iron."""
    return SimulatedAutopilot(
        "rover", seed=3, compasses=[CompassSetup(CompassModel(), IDENTITY)] * 3, effects=effects
    )


def test_an_offset_bends_the_heading_by_its_share_of_the_horizontal_field() -> None:
    made, offset_mgauss = vehicle(), 10.0
    correction = FieldCorrection(offsets_mgauss=(0.0, offset_mgauss, 0.0))
    share = offset_mgauss / made.world.horizontal_mgauss
    yaw = np.linspace(-math.pi, math.pi, 72, endpoint=False)
    nose = yaw - made.world.declination_rad
    closed_form = np.arctan2(np.sin(nose) - share, np.cos(nose)) - nose
    np.testing.assert_allclose(
        np.sin(heading_errors_rad(made, 1, correction)), np.sin(closed_form), atol=1e-9
    )


@pytest.mark.parametrize(
    "effect",
    ["declination", "height_anomaly", "spatial_dipole", "platform_tilt", "attitude_reference_error",
     "yaw_step_error"],
)  # fmt: skip
def test_ground_that_leans_and_a_rock_in_it_are_no_errors_of_a_compass(effect: str) -> None:
    assert heading_error_rms_deg(vehicle(effect)) < 1e-6


@pytest.mark.parametrize("effect", ["hard_iron", "soft_iron", "misalignment"])
def test_iron_and_a_board_that_is_turned_are(effect: str) -> None:
    assert heading_error_rms_deg(vehicle(effect)) > 1.0
