"""A vehicle that drives beside the service: what of its bends is blamed on a compass, and what is learnt."""

from __future__ import annotations

import math

import pytest

from mavcompass import messages as mav
from mavcompass.enums import MavCmd
from mavcompass.messages import Incoming
from mavcompass.procedure.vehicle_state import VehicleIdentity
from mavcompass.service.config import LearningConfig, WatchConfig
from mavcompass.service.view import VehicleView
from mavcompass.service.watch import CompassWatch
from mavcompass.service.work.learning import Learning
from mavcompass.service.work.worker import learn
from mavcompass.simulation.heading_error import heading_error_rms_deg
from mavcompass.simulation.physics.motion import Drive
from mavcompass.simulation.vehicle import SimulatedAutopilot

RATES_HZ = {mav.RawImu: 20, mav.ScaledImu2: 10, mav.Attitude: 10, mav.GpsRawInt: 5, mav.GlobalPositionInt: 2}
SECONDS, LOOK_S = 100.0, 0.1


class Driven:
    """The station's thread without its threads: message by message, look by look."""

    def __init__(self, vehicle: SimulatedAutopilot, kind: str, monkeypatch: pytest.MonkeyPatch) -> None:
        self.vehicle, self.turned = vehicle, 0.0
        self.view = VehicleView(VehicleIdentity(1, 1, "ardupilot", kind), kind, 2026.0)
        self.view.set_parameters(vehicle.firmware.store.values)
        self.watch, self.learning = CompassWatch(WatchConfig()), Learning(LearningConfig())
        monkeypatch.setattr(self.learning._worker, "call", lambda _, *arguments: learn(*arguments))
        steered = type(vehicle.firmware.steering)
        monkeypatch.setattr(steered, "control", lambda _, dt_s: self.drive(dt_s))
        for kind_of, hz in RATES_HZ.items():
            ask = mav.CommandLong(
                1, 1, MavCmd.SET_MESSAGE_INTERVAL, 0, float(mav.message_id(kind_of)), 1e6 / hz
            )
            vehicle.receive(ask, 255, 190)
        self.told: set[str] = set()

    def drive(self, dt_s: float) -> Drive:
        """Weave at 3 m/s by 20 degrees a second, and round once a minute, as issues tell of rovers."""
        t = self.vehicle.board.now_us * 1e-6
        weaving = math.radians(20.0) * (1.0 if t // 4.0 % 2.0 == 0.0 else -1.0)
        return Drive(math.radians(20.0) if t % 40.0 > 22.0 else weaving, 3.0, motors_on=True)

    def go(self) -> None:
        start_s = self.vehicle.time_s
        for look in range(1, round(SECONDS / LOOK_S)):
            for out in self.vehicle.advance(start_s + look * LOOK_S):
                heard = Incoming(out.time_s, 1, 1, out.message)
                self.view.hear(heard)
                self.learning.hear(self.view, heard)
            self.told |= {
                f"{f.id}{f.instance}" for f in self.watch.update(self.view.glance(self.vehicle.time_s))
            }
        self.learning.tend(self.view)
        if self.learning._thread is not None:
            self.learning._thread.join()
        self.learning.tend(self.view)


@pytest.mark.parametrize("kind", ["rover", "ackermann-rover", "boat"])
def test_sound_compasses_of_what_drives_are_not_blamed_and_stay_what_they_are(
    kind: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    vehicle = SimulatedAutopilot(kind, seed=5, calibration="exact")
    driven = Driven(vehicle, kind, monkeypatch)
    driven.go()
    assert driven.told == set() and driven.learning.findings == ()
    for lesson in driven.learning.lessons.values():
        result = lesson.result
        assert math.isfinite(result.heading_sigma_deg), result.reasons
        assert result.heading_change_deg < max(3.0 * result.heading_sigma_deg, 0.3)
        # What a level motion does not show stays what it was.
        assert result.correction.offsets_mgauss[2] == pytest.approx(
            result.in_force.offsets_mgauss[2], abs=3.0
        )
        assert result.correction.motor_source == result.in_force.motor_source


def test_a_bent_compass_of_what_drives_is_found_and_the_others_are_not(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    vehicle = SimulatedAutopilot("rover", seed=5, effects=["hard_iron:x=60,y=-40,z=20"])
    assert heading_error_rms_deg(vehicle) > 8.0
    driven = Driven(vehicle, "rover", monkeypatch)
    driven.go()
    assert driven.told and {name[-1] for name in driven.told} == {"1"}
    lesson = driven.learning.lessons[1]
    assert lesson.result.heading_change_deg > 8.0
    x, y, _ = vehicle.board.compass_setups[0].model.iron.offsets_mgauss
    found = lesson.result
    off = max(3.0 * found.heading_sigma_deg, 0.5)  # a degree is some four milligauss
    assert found.correction.offsets_mgauss[:2] == pytest.approx((x - 60.0, y + 40.0), abs=4.0 * off)
