"""What only PX4 does: whole-number parameters bit for bit, sensors as noisy as its own simulator's."""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
import pytest
from bent_vehicles import bent_vehicle, calibrated, untouched

from mavcompass.frames import wrap_pi
from mavcompass.procedure.motion import Permissions
from mavcompass.procedure.report import CalibrationReport
from mavcompass.procedure.settings import CalibrateSettings
from mavcompass.simulation.heading_error import heading_error_rms_deg
from mavcompass.simulation.physics.signals import Reading, Signals
from mavcompass.simulation.vehicle import SimulatedAutopilot
from mavcompass.vehicle.links.simulated import SimulatedLink


@dataclass
class SimulatorNoise:
    """Shake the sensors as PX4's own simulator (SIH) does by default, as telemetry shows it; or rest."""

    groups: frozenset[str] = field(default=frozenset({"mag", "acc", "gyro"}))
    shaking: bool = True

    def run(self, signals: Signals, rng: np.random.Generator) -> Signals:
        if not self.shaking:
            return signals
        reading = signals.reading
        shape = reading.mag_mgauss.shape
        shaken = Reading(
            reading.mag_mgauss + rng.normal(0.0, (28.0, 28.0, 42.0), shape),
            reading.acc_mps2 + rng.normal(0.0, (0.35, 1.2, 0.95), shape),
            reading.gyro_radps + rng.normal(0.0, (0.107, 0.05, 0.021), shape),
        )
        return Signals(signals.stimulus, shaken)


class Pilot(list[str]):
    """Read what is shown, and land when asked to."""

    def __init__(self, vehicle: SimulatedAutopilot) -> None:
        super().__init__()
        self.vehicle = vehicle

    def append(self, text: str) -> None:
        super().append(text)
        if text.startswith("Land and disarm"):
            self.vehicle.firmware.modes.enter("LAND")


@pytest.fixture(scope="module")
def landed(tmp_path_factory: pytest.TempPathFactory) -> tuple[Pilot, CalibrationReport]:
    """A calibrated copter whose pilot has landed it; its parameters remember a sensor that is not there."""
    vehicle = bent_vehicle("px4-copter", seed=7)
    vehicle.firmware.store.set("CAL_MAG3_ID", 99.0)
    pilot = Pilot(vehicle)
    settings = CalibrateSettings(instances=(), writing="yes")
    return pilot, calibrated(vehicle, tmp_path_factory.mktemp("undo"), settings, shown=pilot)


def test_on_the_ground_it_loads_the_calibration_that_disarming_has_overwritten(
    landed: tuple[Pilot, CalibrationReport],
) -> None:
    (pilot, report), vehicle = landed, landed[0].vehicle
    assert not vehicle.firmware.status.armed
    assert any("had put other values in place" in text for text in pilot)
    assert sum(text.startswith("Land and disarm") for text in pilot) == 1
    assert report.outcome is not None and report.heading is not None
    held = vehicle.firmware.store.values
    assert all(math.isclose(held[n], v, abs_tol=1e-6) for n, v in report.outcome.values.items())
    in_force = vehicle.firmware.compasses.correction(1)
    assert heading_error_rms_deg(vehicle, 1, in_force) < 1.0
    assert not report.steers_off and abs(report.heading.error_after_deg) < 2.0
    assert report.heading.by.startswith("PX4's own reset")


class SlowComputer(SimulatedLink):
    """Solve for so long that what comes meanwhile is lost; the vehicle turns by itself then."""

    def append(self, text: str) -> None:
        if text.startswith("Compass 1"):
            self.autopilot.advance(self.now() + 2.0)
            self._heard.clear()
            self._now_s = self.autopilot.time_s
            self.autopilot.body.yaw_rad += 1.0  # type: ignore[attr-defined]


def test_what_it_turned_unheard_is_no_part_of_the_proof(tmp_path: Path) -> None:
    link = SlowComputer(bent_vehicle("px4-copter", seed=3))
    report = calibrated(link.autopilot, tmp_path, link=link, shown=link)  # type: ignore[arg-type]
    assert report.proof is not None and report.written
    turn = report.proof.compasses[0]
    assert abs(turn.gyro_turned_deg) > 30.0 and abs(turn.difference_deg) < 2.0 and turn.tolerance_deg < 5.0


def test_a_sensor_that_only_its_parameters_remember_is_left_as_it_is(
    landed: tuple[Pilot, CalibrationReport],
) -> None:
    pilot, report = landed
    assert report.written and [r.instance for r in report.results] == [1, 2]
    assert "No readings of compass 4 came: its parameters stay as they are." in report.messages
    assert pilot.vehicle.firmware.store.values["CAL_MAG3_ID"] == 99.0


def test_one_that_flies_on_is_calibrated_and_told_to_fly_by_the_old_calibration(tmp_path: Path) -> None:
    # CAL_MAG0_ROT of an inner sensor, which lies along the vehicle's axes: minus one is minus one.
    made = (bent_vehicle("px4-copter", seed) for seed in range(20))
    vehicle = next(v for v in made if v.firmware.store.values["CAL_MAG0_ROT"] == 0.0)
    held = vehicle.firmware.store.values
    held["CAL_MAG0_ROT"] = -1.0
    before, in_force = untouched(vehicle), vehicle.firmware.compasses.correction(1)
    assert heading_error_rms_deg(vehicle) > 30.0
    report = calibrated(vehicle, tmp_path)
    assert report.written and report.steers_off and held["CAL_MAG0_ROT"] == -1.0
    assert report.proof is not None and report.proof.passed
    assert heading_error_rms_deg(vehicle) <= 0.5 and untouched(vehicle) == before
    assert vehicle.firmware.compasses.correction(1) == in_force
    assert report.heading is not None
    assert "still flies by the old calibration, " in report.heading.summary()
    # What hovers is levelled by its receiver's velocity.
    assert (velocity := report.track.gps_velocity_mps) is not None
    assert np.diff(velocity.time_s).max() < 0.5 and np.ptp(velocity.time_s) > 20.0


def test_one_that_may_land_lands_and_flew_by_the_old_calibration_for_the_last_time(tmp_path: Path) -> None:
    vehicle = bent_vehicle("px4-copter", seed=3)
    shown: list[str] = []
    settings = CalibrateSettings(writing="yes", permissions=Permissions(land=True))
    report = calibrated(vehicle, tmp_path, settings, shown=shown)
    assert "Landing." in shown and vehicle.body.landed and not vehicle.firmware.status.armed
    assert report.written and not report.steers_off and report.heading is not None
    assert abs(report.heading.error_before_deg) > 30.0 and abs(report.heading.error_after_deg) < 1.5
    assert abs(math.degrees(wrap_pi(vehicle.filter.yaw_rad - vehicle.body.yaw_rad))) < 1.5
    # What disarming has put in the place of the new values has been put right, and is in force.
    assert report.outcome is not None
    held = vehicle.firmware.store.values
    assert all(math.isclose(held[n], v, abs_tol=1e-6) for n, v in report.outcome.values.items())
    assert vehicle.firmware.compasses.correction(1) == vehicle.firmware.compasses.held(1)


def test_where_its_yaw_wanders_on_the_ground_nothing_is_promised(tmp_path: Path) -> None:
    vehicle = bent_vehicle("px4-copter", seed=3)
    correct = vehicle.filter.correct

    def wandering(dt_s: float, compass_yaw_rad: float | None) -> None:
        correct(dt_s, compass_yaw_rad)
        if not vehicle.firmware.status.armed:
            vehicle.filter.yaw_rad += math.radians(1.6) * 0.7 * math.cos(0.7 * vehicle.time_s) * dt_s

    vehicle.filter.correct = wandering  # type: ignore[method-assign]
    settings = CalibrateSettings(writing="yes", permissions=Permissions(land=True))
    report = calibrated(vehicle, tmp_path, settings)
    assert report.written and report.steers_off and report.heading is not None
    assert abs(report.heading.error_after_deg) < 2.0 and 0.8 < report.heading.wander_deg < 1.5
    assert "but may wander by" in report.heading.summary()
    # Waiting does not help, and is not done: no longer than it takes to load a few times and look on.
    assert report.heading.seconds < 100.0


def test_with_the_noise_of_px4s_own_simulator_it_takes_off_is_calibrated_with_a_wider_sigma_and_lands(
    tmp_path: Path,
) -> None:
    noise, shown = SimulatorNoise(), list[str]()
    vehicle = SimulatedAutopilot(
        "px4-copter", seed=5, armed=False, ready_s=2.0, calibration="old", effects=[noise]
    )
    vehicle.advance(5.0)
    before, before_deg = vehicle.firmware.reports.heartbeat(), heading_error_rms_deg(vehicle)
    permissions = Permissions(set_mode=True, arm=True, takeoff_m=5.0)
    settings = CalibrateSettings(writing="yes", permissions=permissions)
    report = calibrated(vehicle, tmp_path, settings, shown=shown)
    assert report.written and before_deg > 5.0 and 0.2 < report.results[0].heading_sigma_deg < 1.0
    dwells_s = [window.end_s - window.start_s for window in report.windows]
    assert max(dwells_s) < 6.5
    assert shown.count("Waiting until it stands still: it still rocks.") == 0
    # On the ground again it has loaded what was written, and its own heading is judged by what is seen.
    assert vehicle.body.landed and vehicle.firmware.reports.heartbeat() == before
    assert report.heading is not None and report.heading.seconds < 120.0
    off_deg = abs(math.degrees(wrap_pi(vehicle.filter.yaw_rad - vehicle.body.yaw_rad)))
    assert not report.steers_off and off_deg < 2.0
    assert report.heading.worst_deg <= 2.0 and 0.0 < report.heading.wander_deg < 1.0
    noise.shaking = False
    assert heading_error_rms_deg(vehicle, 1, vehicle.firmware.compasses.correction(1)) <= 0.75
