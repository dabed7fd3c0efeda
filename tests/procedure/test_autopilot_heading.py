"""After a calibration the autopilot itself steers by it, or the person is told that it does not."""

from __future__ import annotations

import json
import math
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
from bent_vehicles import bent_vehicle, calibrated

from mavcompass.calibration.result import CalibrationResult
from mavcompass.cli.calibration import say_outcome
from mavcompass.cli.options import Output
from mavcompass.correction import IDENTITY
from mavcompass.earth_field import EarthField
from mavcompass.errors import PoorCalibration
from mavcompass.frames import wrap_pi
from mavcompass.procedure.autopilot_heading import OwnHeading
from mavcompass.procedure.motion import Permissions
from mavcompass.procedure.positions.proof import CompassProof, Proof
from mavcompass.procedure.report import AutopilotHeading, yaw_error_rad
from mavcompass.procedure.script import Context, Machine, Tick, nothing
from mavcompass.procedure.settings import CalibrateSettings
from mavcompass.report.document import live_document
from mavcompass.simulation.ardupilot import ArduPilot
from mavcompass.simulation.vehicle import SimulatedAutopilot
from mavcompass.track import Track

# As many readings a second as a compass has.
WRITE = CalibrateSettings(writing="yes", rate_hz=10.0)
ARMS_ANYWAY = {"ARMING_CHECK": 0.0}
# A second set of sources in earnest: which of them is in use nobody can tell from outside.
NO_SWITCH = {"EK3_SRC2_POSXY": 6.0}


def steers_off_deg(vehicle: SimulatedAutopilot) -> float:
    return abs(math.degrees(float(wrap_pi(vehicle.filter.yaw_rad - vehicle.body.yaw_rad))))


def test_a_minute_after_the_end_it_steers_by_the_new_heading(tmp_path: Path) -> None:
    vehicle = bent_vehicle("rover", 3)
    vehicle.advance(vehicle.time_s + 20.0)
    assert steers_off_deg(vehicle) > 5.0
    report = calibrated(vehicle, tmp_path, WRITE)
    heading = report.heading
    assert heading is not None and not report.steers_off
    assert abs(heading.error_after_deg) < 1.0 and heading.seconds < 13.0
    for _ in range(60):  # nor does it drift away: its gyro's bias is unlearned
        vehicle.advance(vehicle.time_s + 1.0)
        assert steers_off_deg(vehicle) < 1.0
    told = json.loads(json.dumps(live_document("sim:test", report, "four-positions")))["autopilot_heading"]
    assert told["by"] == heading.by
    assert told["by"] == "switching its source of yaw off and on, believing its compass for some seconds"
    assert told["right"] is True and abs(told["error_after_deg"]) < 1.0
    held = [vehicle.firmware.store[name] for name in ("EK3_YAW_M_NSE", "EK3_GBIAS_P_NSE")]
    assert held == pytest.approx([0.5, 0.001])  # as before


def test_where_it_cannot_be_switched_its_own_noises_bring_it_there(tmp_path: Path) -> None:
    vehicle = SimulatedAutopilot("rover", seed=3, parameters=NO_SWITCH)
    report = calibrated(vehicle, tmp_path, WRITE)
    assert report.heading is not None and report.heading.by == "believing its compass for some seconds"
    assert steers_off_deg(vehicle) < 1.0


class Knocked(list[str]):
    """Push the estimator of a rover off when it has its settings back, so many times."""

    def __init__(self, times: int) -> None:
        super().__init__()
        self.vehicle, self.times = SimulatedAutopilot("rover", seed=3), times

    def append(self, text: str) -> None:
        super().append(text)
        if text.endswith("read back as before.") and self.times:
            self.times -= 1
            self.vehicle.filter.yaw_rad += math.radians(9.0)


@pytest.mark.parametrize(("times", "helped", "off_deg"), [(1, 2, 1.0), (99, 5, 2.0)])
def test_what_is_knocked_off_is_put_right_again_but_not_for_ever(
    times: int, helped: int, off_deg: float, tmp_path: Path
) -> None:
    report = calibrated((knocked := Knocked(times)).vehicle, tmp_path, WRITE, shown=knocked)
    assert sum(text.endswith("it now uses the new heading.") for text in knocked) == helped
    assert report.heading is not None and report.heading.seconds < 100.0
    assert not report.steers_off and steers_off_deg(knocked.vehicle) < off_deg
    assert abs(report.heading.error_after_deg) < off_deg


def test_it_is_measured_where_nothing_can_be_done(tmp_path: Path) -> None:
    vehicle = SimulatedAutopilot("rover", seed=3, parameters={"AHRS_EKF_TYPE": 2.0})
    report = calibrated(vehicle, tmp_path, WRITE)
    assert report.heading is not None and report.heading.by == "its own filter"
    assert math.isclose(abs(report.heading.error_after_deg), steers_off_deg(vehicle), abs_tol=0.7)


def test_what_does_not_rest_is_not_waited_for_in_silence(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(OwnHeading, "_look", lambda own: None)
    shown: list[str] = []
    report = calibrated(SimulatedAutopilot("rover", seed=3), tmp_path, WRITE, shown=shown)
    assert report.heading is not None and report.heading.seconds < 70.0
    assert any("own heading is measured once it rests" in text for text in shown)


def with_its_compasses_aside() -> SimulatedAutopilot:
    """A rover that steers by its gyro alone, and wrongly, until it is restarted."""
    vehicle = SimulatedAutopilot("rover", seed=3, parameters=ARMS_ANYWAY, armed=False)
    vehicle.advance(10.0)
    firmware = vehicle.firmware
    assert isinstance(firmware, ArduPilot)
    firmware.emergency_yaw_reset()
    vehicle.filter.yaw_rad += math.radians(20.0)
    return vehicle


def test_a_restart_that_was_allowed_brings_it_there(tmp_path: Path) -> None:
    vehicle = with_its_compasses_aside()
    settings = replace(WRITE, permissions=Permissions(set_mode=True, arm=True), reboot=True)
    shown: list[str] = []
    report = calibrated(vehicle, tmp_path, settings, shown=shown)
    assert vehicle.board.boots == 1, shown
    assert report.heading is not None and report.heading.by.startswith("a restart")
    assert not report.steers_off and steers_off_deg(vehicle) < 2.0
    assert report.outcome is not None
    held = vehicle.firmware.store.values
    assert all(math.isclose(held[n], v, abs_tol=1e-3) for n, v in report.outcome.values.items())


def test_without_the_permission_the_last_line_says_what_to_do(tmp_path: Path) -> None:
    vehicle = with_its_compasses_aside()
    settings = replace(WRITE, permissions=Permissions(set_mode=True, arm=True))
    report = calibrated(vehicle, tmp_path, settings)
    assert vehicle.board.boots == 0
    assert report.steers_off and report.written
    assert report.heading is not None
    last_line = report.heading.summary()
    assert "has set its compasses aside" in last_line
    assert last_line.endswith("Reboot it before driving.")


def test_a_compass_that_stood_turned_is_held_against_the_autopilot_as_it_is_mounted(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    vehicle = SimulatedAutopilot(
        "rover", seed=3, calibration="exact", parameters={"COMPASS_USE": 0.0, "COMPASS_EXTERNAL": 1.0}
    )
    vehicle.firmware.store.set("COMPASS_ORIENT", 4.0)
    vehicle.firmware.compasses.parameters_changed()
    vehicle.advance(2.0)
    report = calibrated(vehicle, tmp_path, CalibrateSettings(writing="yes", rate_hz=10.0, orientation=True))
    # Another compass steers it, and well: nothing of the half turn is the autopilot's.
    assert report.written and report.heading is not None
    assert abs(report.heading.error_before_deg) < 1.0 and abs(report.heading.error_after_deg) < 1.0
    say_outcome(Output(None), report)
    assert "COMPASS_ORIENT 4 -> 0" in capsys.readouterr().out


def test_an_autopilot_that_tells_no_attitude_is_held_against_nothing() -> None:
    result = CalibrationResult(1, "four-positions", True, (), IDENTITY)
    with pytest.raises(PoorCalibration, match="did not tell its attitude"):
        yaw_error_rad(Track(), result, EarthField((200.0, 0.0, 400.0)), 0.0, 1.0)


def test_the_gyro_alone_proves_nothing_where_the_vehicle_ends_where_it_began() -> None:
    told = CompassProof(1, field_turned_deg=6.7, gyro_turned_deg=6.9, tolerance_deg=1.5)
    round_and_on = CompassProof(1, field_turned_deg=366.7, gyro_turned_deg=366.9, tolerance_deg=1.5)
    assert not Proof((told,)).passed and not Proof((round_and_on,)).passed
    assert "too small a turn to prove anything" in Proof((told,)).summary()
    assert CompassProof(1, 45.2, 45.0, 1.5).passed


def heading(before: float = -8.0, after: float = 1.0, worst: float = 1.5, **more: float) -> AutopilotHeading:
    return AutopilotHeading(before, after, "a switch", 30.0, worst, **more)  # type: ignore[arg-type]


@pytest.mark.parametrize(
    ("told", "off", "says"),
    [
        (heading(), False, "own heading: 8.0 deg off before, 1.0 deg now (a switch)."),
        (heading(worst=2.0), False, "1.0 deg now"),
        (heading(after=2.0, worst=5.0, wander_deg=1.5), True, "2.0 deg off now, but may wander by 1.5 deg"),
        (heading(after=-2.0, worst=5.0), True, "is still 2.0 deg off. Reboot it before driving."),
        (heading(after=-2.0, worst=5.0, flying=True, flies=True), True, "off. Land, disarm and reboot be"),
        (heading(after=-2.0, worst=5.0, flies=True), True, "2.0 deg off. Reboot it before flying."),
        (heading(after=24.0, written=False), True, "24.0 deg off. Compare it with a landmark before"),
        (heading(after=0.4, written=False), False, "The autopilot's own heading is 0.4 deg off."),
        (heading(after=-1.9, worst=2.1), True, "is still 1.9 deg off. Reboot"),
        (heading(after=-1.9, worst=math.nan), False, "1.9 deg now"),
        (heading(after=-2.1, worst=math.nan), True, "is still 2.1 deg off."),
        (heading(after=3.0, worst=9.0, set_aside=True), True, "off and has set its compasses aside. Reboot"),
        (heading(worst=4.0, wander_deg=1.5), True, "1.0 deg off now, but may wander by 1.5 deg while"),
        (heading(worst=math.nan, wander_deg=math.nan), True, "1.0 deg off now, but does not stay there"),
        (heading(after=math.nan, worst=math.nan, wander_deg=math.nan), False, "could not be measured"),
        (heading(after=2.5, worst=5.5, wander_deg=1.5), True, "is still 2.5 deg off"),
        (heading(after=math.nan, worst=math.nan), False, "could not be measured"),
        (heading(after=17.0, not_loaded=True), True, "by the old calibration, 17.0 deg off"),
    ],
)
def test_what_a_person_is_told_of_it(told: AutopilotHeading, off: bool, says: str) -> None:
    assert told.is_off is off and says in told.summary()
    assert told.known is math.isfinite(told.error_after_deg)


def watched(
    rng: np.random.Generator, off_deg: float, wander_deg: float, noise_deg: float, sees: float = 1.0
) -> OwnHeading:
    """Watch for 20 s a yaw that is off by so much, goes to and fro in 10 s, and is seen with this noise."""
    desk = SimpleNamespace(dialect=SimpleNamespace(loads_disarmed=True))
    own = OwnHeading(desk, 2026.0, overrides=None)  # type: ignore[arg-type]
    phase = rng.uniform(0.0, 2.0 * np.pi)
    for time_s in np.arange(0.0, 20.0, 1.2):
        swing = np.sqrt(2.0) * wander_deg * np.sin(0.2 * np.pi * time_s + phase)
        off = float(off_deg + swing + sees * rng.normal(0.0, noise_deg))
        own.note(float(time_s), off, noise_deg, float(179.9 + swing))
    return own


@pytest.mark.parametrize(
    ("kind", "armed", "bent_deg", "loads_disarmed", "told"),
    [
        ("rover", True, 0.0, False, True), ("rover", True, 9.0, True, False),
        ("copter", True, 0.7, False, False), ("copter", True, -0.8, False, True),
        ("copter", False, 0.7, False, True),
    ],
)  # fmt: skip
def test_an_estimator_is_told_to_follow_its_compass_and_one_that_flies_where_it_is_worth_it(
    kind: str, armed: bool, bent_deg: float, loads_disarmed: bool, told: bool
) -> None:
    dialect = SimpleNamespace(
        loads_disarmed=loads_disarmed, prompt_estimator=lambda *_: {"EK3_YAW_M_NSE": 0.05}
    )
    vehicle = SimpleNamespace(identity=SimpleNamespace(kind=kind), state=SimpleNamespace(armed=armed))
    desk = SimpleNamespace(dialect=dialect, parameters={}, context=Context(), **vars(vehicle))
    held = list[object]()
    overrides = SimpleNamespace(hold=lambda context, values: nothing(held.append(values) is None))
    own = OwnHeading(desk, 2026.0, overrides)  # type: ignore[arg-type]
    own.note(1.0, bent_deg, 0.1, 90.0)
    own.found([CalibrationResult(1, "four-positions", True, (), IDENTITY)], ())
    assert own.before_deg == bent_deg
    Machine(lambda _: own.expect()).step(Tick(0.0))
    assert bool(held) is told


@pytest.mark.parametrize(
    ("off_deg", "wander_deg", "waits"),
    [(4.0, 0.02, True), (4.0, 1.5, False), (0.1, 1.5, False)],
)
def test_a_heading_that_goes_to_and_fro_and_that_nothing_helps_is_not_waited_for(
    off_deg: float, wander_deg: float, waits: bool
) -> None:
    """This autopilot takes a new yaw over only where it is disarmed."""
    own = watched(np.random.default_rng(3), off_deg, wander_deg, 0.05)
    own.before_deg = off_deg
    vars(own.desk).update(
        context=Context(),
        identity=SimpleNamespace(kind="rover"),
        state=SimpleNamespace(armed=True, ekf=None),
        rest=SimpleNamespace(
            time_s=20.0, for_s=lambda: 0.0, detector=SimpleNamespace(averaging_s=lambda *_: 0.0)
        ),
    )
    machine = Machine(lambda _: own.settle())
    machine.step(Tick(0.0))
    assert machine.done is not waits


@pytest.mark.parametrize("noise_deg", [0.1, 0.9])
@pytest.mark.parametrize("wander_deg", [0.3, 1.0, 3.0])
def test_how_far_it_wanders_is_told_whatever_the_noise(wander_deg: float, noise_deg: float) -> None:
    rng = np.random.default_rng(7)
    seen = [watched(rng, 0.5, wander_deg, noise_deg) for _ in range(60)]
    told2 = np.mean([own.wander_deg**2 for own in seen])
    assert np.sqrt(told2) == pytest.approx(wander_deg, rel=0.25, abs=0.15)
    # The swing's ends are one and a half sigmas off: what is to be expected at the worst covers them.
    worst = 0.5 + np.sqrt(2.0) * wander_deg
    assert np.mean([own.worst_deg > 0.9 * worst for own in seen]) > (
        0.95 if noise_deg < 0.5 * wander_deg else 0.6
    )


def test_noise_alone_keeps_no_autopilot_from_being_right() -> None:
    """One that stands half a degree off is not told to be off because the compass shakes (limit: 1.8)."""
    rng = np.random.default_rng(8)
    for sees in (1.0, 1.4):  # a level that errs by more than it knows is no yaw that goes to and fro, either
        worst = [watched(rng, 0.5, 0.0, 0.9, sees).worst_deg for _ in range(100)]
        assert np.mean(np.less(worst, 1.8)) > 0.9


@pytest.mark.parametrize(
    ("wander_deg", "noise_deg", "rms_deg"), [(0.0, 0.9, 0.3), (3.0, 0.9, 0.9), (3.0, 3.0, 2.4)]
)
def test_what_it_is_off_now_is_told_better_than_by_the_latest_sample_or_their_mean(
    wander_deg: float, noise_deg: float, rms_deg: float
) -> None:
    rng = np.random.default_rng(9)
    seen = [watched(rng, 0.5, wander_deg, noise_deg) for _ in range(100)]
    wrong_deg = [own.error_deg - 0.5 - (own.samples[-1][3] - 179.9) for own in seen]
    assert np.sqrt(np.mean(np.square(wrong_deg))) < rms_deg
