"""One turn without a stop: the story, who can, what the proof stands on, and who steps in."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest
from bent_vehicles import calibrated

from mavcompass import messages as mav
from mavcompass.errors import LinkLost, PoorCalibration, Refused
from mavcompass.procedure.positions import DwellSettings, Mover, Rest, Window, stood_since
from mavcompass.procedure.script import Context, Machine, Script, Tick
from mavcompass.procedure.settings import CalibrateSettings
from mavcompass.procedure.turning import GyroAngle, strategies_for
from mavcompass.simulation.heading_error import heading_error_rms_deg
from mavcompass.simulation.vehicle import SimulatedAutopilot

CONTINUOUS = CalibrateSettings(writing="yes", continuous=True)
# Simulated, with the proof, from the first dwell on; stopping at each takes 24 to 34 s.
WITHIN_S = {"rover": 15.5, "copter": 16.5, "boat": 22.0, "sub": 21.0, "px4-copter": 18.0}


@pytest.mark.parametrize("kind", WITHIN_S)
def test_one_turn_calibrates_and_proves_in_half_the_time(kind: str, tmp_path: Path) -> None:
    vehicle, shown = SimulatedAutopilot(kind, seed=7), list[str]()
    report = calibrated(vehicle, tmp_path, CONTINUOUS, shown=shown)
    assert shown.count("Turning by 360 deg without a stop.") == 1
    assert not [text for text in shown if text.startswith("Turning to position")]
    assert report.written and report.proof is not None and report.proof.passed
    # The proof is a further turn, and after the write.
    assert report.proof.compasses[0].gyro_turned_deg == pytest.approx(45.0, abs=9.0)
    first, turn = report.windows
    assert first.rested and not turn.rested
    assert math.degrees(turn.turned_rad - first.turned_rad) == pytest.approx(360.0, abs=15.0)
    assert report.on_vehicle_s is not None and report.on_vehicle_s < WITHIN_S[kind]
    for result in report.results:
        assert result.method == "world-field"
        off_deg = heading_error_rms_deg(vehicle, result.instance)
        assert off_deg < max(2.0 * result.heading_sigma_deg, 0.5)
    # The others are compared while it turns: to a degree, though it stood at one heading only.
    assert [w for w in report.results[0].evidence if w.sigma_deg < 1.5]


def test_whoever_turns_it_by_hand_is_asked_to_stop(tmp_path: Path) -> None:
    vehicle, shown = SimulatedAutopilot("rover", seed=3), list[str]()
    vehicle.disarm()
    settings = replace(CONTINUOUS, motion="hand", writing="never")
    with pytest.raises(PoorCalibration, match="not turned to a new position"):
        calibrated(vehicle, tmp_path, settings, shown=shown)
    assert [text for text in shown if text.startswith("Turning to position 2 of 4")]


def test_what_drives_arcs_is_told_to_stop_at_each_position(tmp_path: Path) -> None:
    with pytest.raises(Refused, match="all the way round without a stop") as caught:
        calibrated(SimulatedAutopilot("ackermann-rover", seed=1), tmp_path, CONTINUOUS)
    assert "--continuous" in caught.value.remedy
    assert strategies_for("rover", "ardupilot", ackermann=True, continuous=True) == ()


@pytest.mark.parametrize("event", ["stick", "mode", "stopped", "silent 15 s"])
def test_whoever_steps_in_ends_the_turn_as_any_other(interrupted: Callable[..., Any], event: str) -> None:
    for seed in (3000, 3001):
        outcome = interrupted("round", "rover", event, seed)
        assert not outcome.wrong, (str(outcome.cell), outcome.told)


def stand(rates_deg_s: list[float], until_s: float = 8.0) -> Window:
    """Return the stand after a turn that ended at 0 s and goes on at these rates, one each 0.1 s."""
    rest, gyro = Rest(), GyroAngle()

    def script(context: Context) -> Script[Window]:
        context.listeners += [rest.hear, gyro.hear]
        while not gyro.samples:
            yield context.now + 0.1
        turn = Window(-9.0, rest.time_s, 0.0, rested=False)
        return (yield from stood_since(context, Mover(gyro, rest), turn, DwellSettings()))

    machine = Machine(script)
    machine.step(Tick(10.0))
    for k in range(round(until_s / 0.1)):
        time_s = 10.1 + 0.1 * k
        if k < len(rates_deg_s):
            rate = round(1000.0 * math.radians(rates_deg_s[k]))
            message = mav.RawImu(time_usec=round(time_s * 1e6), zacc=-1000, zgyro=rate, xmag=200, zmag=400)
            machine.step(mav.Incoming(time_s, 1, 1, message))
        machine.step(Tick(time_s + 0.05))
    if machine.error is not None:
        raise machine.error
    assert machine.result is not None
    return machine.result


def test_the_stand_begins_once_it_has_come_to_rest() -> None:
    at_once, coasting = stand([0.0] * 30), stand([40.0, 30.0, 20.0, 10.0] + [0.0] * 30)
    assert at_once.end_s - at_once.start_s == pytest.approx(0.5, abs=0.11)
    assert coasting.start_s - at_once.start_s == pytest.approx(0.4, abs=0.11)
    assert coasting.rested and math.degrees(coasting.turned_rad) > 5.0


def test_what_swings_on_is_taken_as_it_is_and_what_falls_silent_is_not() -> None:
    swinging = stand([12.0, -12.0] * 40)
    assert 2.5 < swinging.end_s - 10.1 < 4.5
    with pytest.raises(LinkLost):
        stand([0.0, 0.0], until_s=12.0)
