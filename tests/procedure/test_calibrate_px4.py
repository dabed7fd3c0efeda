"""What only PX4 does: whole-number parameters bit for bit, sensors as noisy as its own simulator's."""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
import pytest
from bent_vehicles import bent_vehicle, calibrated

from mavcompass.errors import Refused
from mavcompass.procedure.calibrate import CalibrateSettings
from mavcompass.simulation.heading_error import heading_error_rms_deg
from mavcompass.simulation.physics.signals import Reading, Stimulus
from mavcompass.simulation.vehicle import SimulatedAutopilot


@dataclass
class SimulatorNoise:
    """Shake the sensors as PX4's own simulator (SIH) does by default, as telemetry shows it; or rest."""

    groups: frozenset[str] = field(default=frozenset({"mag", "acc", "gyro"}))
    shaking: bool = True

    def apply(self, stimulus: Stimulus, reading: Reading, rng: np.random.Generator) -> Reading:
        if not self.shaking:
            return reading
        shape = reading.mag_mgauss.shape
        return Reading(
            reading.mag_mgauss + rng.normal(0.0, (28.0, 28.0, 42.0), shape),
            reading.acc_mps2 + rng.normal(0.0, (0.35, 1.2, 0.95), shape),
            reading.gyro_radps + rng.normal(0.0, (0.107, 0.05, 0.021), shape),
        )


def test_a_copter_with_the_noise_of_px4s_own_simulator_is_calibrated_with_a_wider_sigma(
    tmp_path: Path,
) -> None:
    noise = SimulatorNoise()
    vehicle = SimulatedAutopilot("px4-copter", seed=4, calibration="old", effects=[noise])
    before_deg = heading_error_rms_deg(vehicle)
    shown: list[str] = []
    report = calibrated(vehicle, tmp_path, CalibrateSettings(writing="yes"), shown=shown)
    assert report.written and before_deg > 5.0
    noise.shaking = False
    assert heading_error_rms_deg(vehicle, 1, report.results[0].correction) <= 0.75
    assert 0.2 < report.results[0].heading_sigma_deg < 1.0
    dwells_s = [window.end_s - window.start_s for window in report.windows]
    assert np.mean(dwells_s) > 2.0 and max(dwells_s) < 6.5
    assert shown.count("Waiting until it stands still: it still rocks.") == 0


def test_minus_one_is_minus_one(tmp_path: Path) -> None:
    # CAL_MAG0_ROT of an inner sensor, and what PX4's whole numbers look like as floats.
    vehicle = bent_vehicle("px4-copter", seed=3)
    vehicle.firmware.store.values["CAL_MAG0_ROT"] = -1.0
    report = calibrated(vehicle, tmp_path)
    assert report.written and vehicle.firmware.store.values["CAL_MAG0_ROT"] == -1.0


def test_a_mounting_that_nobody_can_tell_is_refused_before_anything_moves(tmp_path: Path) -> None:
    vehicle = bent_vehicle("px4-copter", seed=3)
    vehicle.firmware.store.values["CAL_MAG0_ROT"] = 100.0
    yaw_rad = vehicle.body.yaw_rad
    with pytest.raises(Refused, match="custom angle"):
        calibrated(vehicle, tmp_path)
    assert abs(math.degrees(vehicle.body.yaw_rad - yaw_rad)) < 3.0
