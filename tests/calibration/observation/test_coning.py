"""A vehicle that leans round and round turns its nose without any rate about the vertical."""

from __future__ import annotations

import math

import numpy as np
import pytest

from mavcompass.calibration.observation import turn_record
from mavcompass.simulation.physics.motion import rotation_matrix
from mavcompass.track import MagSeries, Series, Track

LEAN_RAD, PERIOD_S, ROUNDS = math.radians(15.0), 4.0, 3
TIME = np.arange(0.0, ROUNDS * PERIOD_S + 1e-9, 0.01)


def circling(yaw_radps: float) -> Track:
    """A copter that leans 15 degrees to every side in turn while its nose turns at a rate."""
    phase = 2.0 * math.pi * TIME / PERIOD_S
    roll, pitch, yaw = LEAN_RAD * np.cos(phase), LEAN_RAD * np.sin(phase), yaw_radps * TIME
    angles = zip(roll, pitch, yaw, strict=True)
    rotation = np.array([rotation_matrix(*angle) for angle in angles]).reshape(-1, 3, 3)
    turn = np.swapaxes(rotation[:-1], 1, 2) @ rotation[1:]
    between = np.stack([turn[:, 2, 1], turn[:, 0, 2], turn[:, 1, 0]], axis=1) / 0.01
    rate = np.concatenate([between[:1], 0.5 * (between[1:] + between[:-1]), between[-1:]])
    field = Series.of(TIME[::10], np.tile([200.0, 0.0, -500.0], (TIME[::10].size, 1)))
    return Track(
        autopilot="ardupilot",
        vehicle="copter",
        compasses={1: MagSeries(1, field)},
        gyro_radps=Series.of(TIME, rate),
        attitude_rad=Series.of(TIME, np.column_stack([roll, pitch, yaw])),
    )


@pytest.mark.parametrize("yaw_radps", [0.0, 0.3, -0.5])
def test_the_angle_is_the_noses_whatever_the_vehicle_leans(yaw_radps: float) -> None:
    record = turn_record(circling(yaw_radps))
    assert record is not None
    turned = record.angle_rad[-1] - record.angle_rad[0] + record.bias_radps * (TIME[-1] - TIME[0])
    assert turned == pytest.approx(yaw_radps * TIME[-1], abs=math.radians(0.2))
    # Twelve degrees a round: the area that the lean goes round.
    about_the_vertical = float(np.trapezoid(record.rate_radps + record.bias_radps, TIME))
    assert abs(about_the_vertical - turned) == pytest.approx(ROUNDS * math.pi * LEAN_RAD**2, rel=0.05)
