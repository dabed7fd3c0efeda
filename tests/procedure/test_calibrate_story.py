"""A calibration and a check as they are told: phases, progress, what is asked for; when one is enough."""

from __future__ import annotations

import math
import re
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest
from bent_vehicles import bent_vehicle

from mavcompass import messages as mav
from mavcompass.calibration.result import Mounting
from mavcompass.errors import PoorCalibration, Refused
from mavcompass.messages import Message
from mavcompass.procedure.calibrate import CalibrateSettings, _Calibration
from mavcompass.procedure.check import CheckSettings, check
from mavcompass.procedure.check.preflight import _Checker
from mavcompass.procedure.desk import Desk
from mavcompass.procedure.positions import HandMover, VehicleMover
from mavcompass.procedure.script import Context, Machine, Show
from mavcompass.procedure.turning import GyroAngle
from mavcompass.procedure.vehicle_state import VehicleIdentity
from mavcompass.track import Track
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


def test_the_story_of_a_calibration(tmp_path: Path) -> None:
    shown: list[Show] = []
    vehicle, settings = bent_vehicle("rover", 2), CalibrateSettings(writing="yes")
    report = calibrate_on(
        SimulatedLink(vehicle), "sim:test", settings, on_show=shown.append, undo_directory=tmp_path
    )
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
        ("write", None, "Writing 9 parameters; to undo"),
        ("written", 0.9, "Written and read back."),
        ("heading", None, "The autopilot was # deg off; it now uses the new heading."),
        ("prove", None, "Turning once more to check the new values."),
        ("prove", 0.95, "Checked by a turn"),
    ]
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


def identity(kind: Any, autopilot: str) -> VehicleIdentity:
    return VehicleIdentity(1, 1, autopilot, kind)


def desk_of(kind: str, autopilot: str = "ardupilot", instances: tuple[int, ...] = (1,)) -> Any:
    desk = SimpleNamespace(identity=identity(kind, autopilot), instances=instances, context=Context())
    desk.imu_rates = lambda wanted, rate_hz: Desk.imu_rates(desk, wanted, rate_hz)  # type: ignore[arg-type]
    return desk


def calibration(desk: Any, instances: tuple[int, ...] = (1,), **settings: Any) -> _Calibration:
    return _Calibration(
        desk,
        SimpleNamespace(),
        CalibrateSettings(**settings),
        instances,
        SimpleNamespace(),
        SimpleNamespace(),
    )  # type: ignore[arg-type]


SLOW = {mav.GlobalPositionInt: 4.0, mav.RcChannels: 4.0, mav.SysStatus: 4.0, mav.Heartbeat: 4.0}
ESTIMATOR, CLOCK = {mav.EkfStatusReport: 2.0}, {mav.SystemTime: 2.0}
RECEIVER = {mav.GpsRawInt: 2.0}


@pytest.mark.parametrize(
    ("kind", "autopilot", "rate_hz", "wanted"),
    [
        (
            "rover",
            "ardupilot",
            25.0,
            {mav.RawImu: 25.0, mav.Attitude: 10.0} | SLOW | ESTIMATOR | CLOCK | RECEIVER,
        ),
        (
            "boat",
            "ardupilot",
            5.0,
            {mav.RawImu: 5.0, mav.Attitude: 5.0} | SLOW | ESTIMATOR | CLOCK | RECEIVER,
        ),
        (
            "copter",
            "ardupilot",
            25.0,
            {mav.RawImu: 50.0, mav.Attitude: 10.0, mav.GpsRawInt: 5.0} | SLOW | ESTIMATOR | CLOCK,
        ),
        (
            "copter",
            "px4",
            25.0,
            {mav.ScaledImu: 100.0, mav.Attitude: 10.0, mav.GpsRawInt: 5.0, mav.LocalPositionNed: 4.0}
            | SLOW
            | CLOCK,
        ),
    ],
)
def test_what_a_calibration_asks_to_hear(
    kind: str, autopilot: str, rate_hz: float, wanted: dict[type[Message], float]
) -> None:
    assert calibration(desk_of(kind, autopilot), rate_hz=rate_hz).wanted_rates() == wanted
    both = calibration(desk_of(kind, autopilot), (2,), rate_hz=rate_hz).wanted_rates()
    assert both == wanted | {mav.ScaledImu2: rate_hz}


@pytest.mark.parametrize("autopilot", ["ardupilot", "px4"])
def test_what_a_check_asks_to_hear(autopilot: str) -> None:
    imu = mav.RawImu if autopilot == "ardupilot" else mav.ScaledImu
    wanted = {imu: 20.0, mav.ScaledImu2: 20.0, mav.Attitude: 10.0, mav.GlobalPositionInt: 4.0}
    wanted |= {mav.SysStatus: 4.0, mav.SystemTime: 2.0}
    if autopilot == "ardupilot":
        wanted |= {mav.EkfStatusReport: 2.0, mav.RcChannels: 4.0}
    else:
        wanted |= {mav.EstimatorStatus: 2.0}
    found = _Checker(desk_of("rover", autopilot, (1, 2)), CheckSettings(rate_hz=20.0)).wanted_rates()
    assert found == wanted


@pytest.mark.parametrize(
    ("positions", "repeatable_deg", "by_hand", "more"),
    [(4, 0.31, False, True), (7, 0.31, False, True), (8, 0.31, False, False), (4, 0.3, False, False),
     (4, 9.0, True, False)],
)  # fmt: skip
def test_more_positions_are_visited_while_they_help(
    positions: int, repeatable_deg: float, by_hand: bool, more: bool
) -> None:
    desk = desk_of("rover")
    sigmas = ((0.1, 0.5), (repeatable_deg, 1.25))
    results = [SimpleNamespace(repeatable_sigma_deg=r, mounting=Mounting()) for r, _ in sigmas]
    report: Any = SimpleNamespace(windows=range(positions), results=results)
    mover = HandMover(GyroAngle(), SimpleNamespace()) if by_hand else VehicleMover(GyroAngle(), ())  # type: ignore[arg-type]
    assert calibration(desk).wants_more(report, mover) is more
    said = [action.text for action in desk.context.outbox]
    assert said == ([f"Heading within {repeatable_deg:.1f} deg so far: one more position."] if more else [])


def test_a_stretch_that_was_not_recorded_is_not_sure() -> None:
    desk = desk_of("rover")
    desk.builder = SimpleNamespace(build=Track)
    assert calibration(desk).sureness_deg(0.0, 1.0) == math.inf


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
    with pytest.raises(PoorCalibration, match="accelerometer shows 557 m/s2"):
        calibrate_on(SimulatedLink(vehicle), "sim:test", settings, undo_directory=tmp_path)
    assert [vehicle.firmware.compasses.correction(i) for i in (1, 2, 3)] == before
