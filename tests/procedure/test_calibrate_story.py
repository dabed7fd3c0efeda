"""A calibration and a check as they are told: phases, progress, what is asked for."""

from __future__ import annotations

import re
from dataclasses import replace
from pathlib import Path

import pytest
from bent_vehicles import bent_vehicle, overheard

from mavcompass import messages as mav
from mavcompass.enums import MavCmd
from mavcompass.errors import PoorCalibration, Refused
from mavcompass.procedure.check import CheckSettings, check
from mavcompass.procedure.script import Machine, Show
from mavcompass.procedure.settings import CalibrateSettings
from mavcompass.vehicle.calibrating import calibrate_on
from mavcompass.vehicle.dialects import make_dialect
from mavcompass.vehicle.driver import run
from mavcompass.vehicle.links.simulated import SimulatedLink
from mavcompass.vehicle.stopping import StopRequest


def told(shown: list[Show]) -> list[tuple[str, float | None, str]]:
    """Return phases, progress and words, without what was measured."""
    words = [re.sub(r"-?\d+\.\d+", "#", show.text.partition(":")[0]) for show in shown]
    return [
        (show.step, None if show.fraction is None else round(show.fraction, 2), text)
        for show, text in zip(shown, words, strict=True)
    ]


def rates_asked_of(heard: list[mav.Message]) -> dict[int, list[float]]:
    """Return the intervals, microseconds, that were asked for of each message."""
    asked: dict[int, list[float]] = {}
    for message in heard:
        if isinstance(message, mav.CommandLong) and message.command == MavCmd.SET_MESSAGE_INTERVAL:
            asked.setdefault(int(message.param1), []).append(message.param2)
    return asked


def test_the_story_of_a_calibration(tmp_path: Path) -> None:
    shown: list[Show] = []
    vehicle, settings = bent_vehicle("rover", 2), CalibrateSettings(writing="yes")
    heard = overheard(vehicle)
    report = calibrate_on(
        SimulatedLink(vehicle), "sim:test", settings, on_show=shown.append, undo_directory=tmp_path
    )
    back = "The autopilot's estimator gets its own settings back; the calibration is not touched."
    follows = "has followed and is watched, # deg off now (at most {} s more; you may stop here)."
    assert told(shown) == [
        ("connect", 0.0, "Waiting for the vehicle's heartbeat."),
        ("connect", None, "Found ArduPilot rover, system 1."),
        ("dwell", 0.0, "Position 1 of 4"),
        ("turn", 0.1, "Turning to position 2 of 4."),
        ("dwell", 0.2, "Position 2 of 4"),
        ("turn", 0.3, "Turning to position 3 of 4."),
        ("dwell", 0.4, "Position 3 of 4"),
        ("turn", 0.5, "Turning to position 4 of 4."),
        ("dwell", 0.6, "Position 4 of 4"),
        ("solve", 0.8, "Compass 1"),
        ("write", None, "Setting EK3_YAW_M_NSE and EK3_GBIAS_P_NSE for a while; if they stay"),
        ("write", None, "Writing 9 parameters; to undo"),
        ("written", 0.9, "Written and read back."),
        ("heading", None, "The autopilot was # deg off; it now uses the new heading."),
        ("prove", None, "Turning once more to check the new values."),
        ("prove", 0.95, "Checked by a turn"),
        ("undo", None, f"{back} Putting EK3_YAW_M_NSE and EK3_GBIAS_P_NSE back."),
        ("undo", None, "EK3_YAW_M_NSE and EK3_GBIAS_P_NSE read back as before."),
        *[
            ("heading", None, f"All is written; the autopilot {follows.format(left_s)}")
            for left_s in (115, 114, 113)
        ],
    ]
    # What it wants to hear, where it was not as fast already; at the end each is as it was.
    wanted = {mav.RawImu: 25.0, mav.Attitude: 10.0, mav.EkfStatusReport: 2.0, mav.SystemTime: 2.0}
    asked = rates_asked_of(heard)
    first = {number: intervals[0] for number, intervals in asked.items()}
    assert set(first) & {mav.message_id(kind) for kind in wanted}
    for kind, hz in wanted.items():
        assert first.get(mav.message_id(kind), 1e6 / hz) == pytest.approx(1e6 / hz, abs=1.0)
    assert all(intervals[-1] != intervals[0] for intervals in asked.values())
    positions = [dict(show.data) for show in shown if show.step == "dwell"]
    assert [data["position"] for data in positions] == [1.0, 2.0, 3.0, 4.0]
    assert [data["turned_deg"] for data in positions] == pytest.approx([0.0, 90.0, 180.0, 270.0], abs=12.0)
    # From the first position to the end of the proof, by the vehicle's clock; half a step proves it.
    assert report.proof is not None and report.on_vehicle_s is not None
    assert report.proof.compasses[0].gyro_turned_deg == pytest.approx(45.0, abs=8.0)
    assert 15.0 < report.on_vehicle_s < report.duration_s


@pytest.mark.parametrize(
    ("at", "says"), [("turn", "Nothing written."), ("written", "The old values are back on the vehicle.")]
)
def test_who_stops_it_is_told_what_stands(at: str, says: str, tmp_path: Path) -> None:
    stop, vehicle = StopRequest(), bent_vehicle("rover", 2)
    before = dict(vehicle.firmware.store.values)

    def on_show(show: Show) -> None:
        if show.step == at:
            stop.reason = "Stopped by Ctrl-C."

    settings = CalibrateSettings(writing="yes")
    with pytest.raises(Refused) as caught:
        calibrate_on(
            SimulatedLink(vehicle), "sim:test", settings, on_show=on_show, stop=stop, undo_directory=tmp_path
        )
    assert caught.value.what == f"Stopped by Ctrl-C. It no longer turns; it is armed. {says}"
    assert abs(vehicle.truth.yaw_rate_radps) < 0.05, "what is said is true"
    now = vehicle.firmware.store.values
    assert all(now[name] == old for name, old in before.items() if name.startswith("COMPASS_OFS"))


def test_the_story_of_a_check() -> None:
    shown: list[Show] = []
    settings = CheckSettings(turn="vehicle")
    machine = Machine(lambda context: check(context, make_dialect, settings))
    report = run(machine, SimulatedLink(bent_vehicle("rover", 1)), on_show=shown.append)
    assert told(shown)[2:] == [
        ("dwell", 0.3, "Looking at the compasses at rest."),
        ("turn", 0.6, "Turning by 90 deg."),
        ("dwell", 0.8, "Standing still after the turn."),
    ]
    assert report.turned and report.duration_s == report.to_json()["duration_s"] > 5.0


def test_with_a_dead_accelerometer_nothing_is_written_and_it_is_named(tmp_path: Path) -> None:
    vehicle = bent_vehicle("rover", 2)
    builders = vehicle.firmware.reports.builders
    before = [vehicle.firmware.compasses.correction(i) for i in (1, 2, 3)]
    sound = builders[mav.RawImu]

    def at_its_end(time_us: int, share: float) -> mav.Message | None:
        reading = sound(time_us, share)
        assert isinstance(reading, mav.RawImu)
        return replace(reading, xacc=-32768, yacc=-32768, zacc=-32768)

    builders[mav.RawImu] = at_its_end
    settings = CalibrateSettings(writing="yes")
    with pytest.raises(PoorCalibration, match="accelerometer's numbers are beyond any sensor's"):
        calibrate_on(SimulatedLink(vehicle), "sim:test", settings, undo_directory=tmp_path)
    assert [vehicle.firmware.compasses.correction(i) for i in (1, 2, 3)] == before
