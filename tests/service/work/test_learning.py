"""What the service learns while the vehicle works, what it offers, and that it writes only with consent."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import replace
from datetime import UTC, datetime, timedelta
from itertools import pairwise

import numpy as np
import pytest
from running_service import RunningService, StartService, wait_for

from mavcompass import messages as mav
from mavcompass.calibration.result import CalibrationResult
from mavcompass.earth_field import EarthField
from mavcompass.messages import Incoming
from mavcompass.procedure.vehicle_state import VehicleIdentity
from mavcompass.service.config import LearningConfig
from mavcompass.service.view import VehicleView
from mavcompass.service.work import learning as room
from mavcompass.service.work.learning import Learning, Lesson
from mavcompass.service.work.worker import learn
from mavcompass.simulation.heading_error import heading_error_rms_deg
from mavcompass.simulation.vehicle import SimulatedAutopilot
from mavcompass.vehicle.links.simulated import SimulatedLink

EARTH = EarthField((240.0, 0.0, -520.0))
IRON = np.array([70.0, -45.0, 20.0])
STEP_S = 0.1


def going_round(count: int) -> Iterator[float]:
    """Yaw rates of legs and bends, a tenth of a second each."""
    for k in range(count):
        yield from (0.0,) * 30
        yield from ((-1.0, 1.0, 1.0)[k % 3] * math.radians(30.0),) * (22 + 5 * (k % 2))


class Drive:
    """A vehicle with iron aboard that speaks RAW_IMU to a Learning, which asks without a process."""

    def __init__(self, monkeypatch: pytest.MonkeyPatch) -> None:
        self.view = VehicleView(VehicleIdentity(1, 1, "ardupilot", "rover"), "rover", 2026.0)
        self.view.world = EARTH
        self.view.set_parameters({"COMPASS_OFS_X": 0.0, "COMPASS_OFS_Y": 0.0, "COMPASS_OFS_Z": 0.0})
        monkeypatch.setattr(self.view.__class__, "instances", lambda self: (1,))
        self.learning = Learning(LearningConfig())
        monkeypatch.setattr(self.learning._worker, "call", lambda _, *arguments: learn(*arguments))
        self.iron, self.yaw, self.time_s = IRON, 0.3, 100.0
        self.rng = np.random.default_rng(4)

    def go(self, rates: Iterator[float], tend: bool = True) -> None:
        for rate in rates:
            self.time_s += STEP_S
            self.yaw += rate * STEP_S
            h = EARTH.horizontal_mgauss
            field = np.array([h * math.cos(self.yaw), -h * math.sin(self.yaw), EARTH.ned_mgauss[2]])
            x, y, z = np.round(field + self.iron + self.rng.normal(0.0, 1.5, 3)).astype(int).tolist()
            spin = round(1000.0 * rate + self.rng.normal(0.0, 1.0))
            imu = mav.RawImu(round(self.time_s * 1e6), 0, 0, -1000, 0, 0, spin, x, y, z)
            heard = Incoming(self.time_s, 1, 1, imu)
            self.view.hear(heard)
            self.learning.hear(self.view, heard)
        if tend:
            self.tend()

    def tend(self) -> None:
        self.learning.tend(self.view)
        if self.learning._thread is not None:
            self.learning._thread.join()
        self.learning.tend(self.view)


@pytest.fixture
def drive(monkeypatch: pytest.MonkeyPatch) -> Drive:
    return Drive(monkeypatch)


def test_a_compass_that_is_off_is_offered_old_against_new(drive: Drive) -> None:
    drive.go(going_round(20))
    (result,) = drive.learning.offers()
    assert np.allclose(result.correction.offsets_mgauss[:2], -IRON[:2], atol=3.0)
    assert result.parameters["COMPASS_OFS_X"] == pytest.approx(-70.0, abs=3.0)
    (finding,) = drive.learning.findings
    assert finding.id == "learnt" and len(finding.short) <= 50
    assert f"{result.heading_change_deg:.1f} degrees off" in finding.text
    assert 10.0 < result.heading_change_deg < 25.0
    drive.go(going_round(30))  # and it goes on learning
    again = drive.learning.lessons[1].result
    assert again.accepted and again is not result


def test_it_looks_at_what_was_kept_each_minute_at_first_and_then_every_five(
    drive: Drive, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(room, "PIECE_S", 1.0)  # of ten seconds
    looked_at = list[int]()
    call = lambda _, pieces, *others: looked_at.append(len(pieces)) or {}  # type: ignore[func-returns-value]  # noqa: E731
    monkeypatch.setattr(drive.learning._worker, "call", call)
    for _ in range(660):
        drive.go((0.5, -0.5))
    assert looked_at == [*range(6, 61, 6), 90, 120]


def test_a_compass_that_is_right_is_not_offered(drive: Drive) -> None:
    drive.iron = np.zeros(3)
    drive.go(going_round(20))
    assert drive.learning.lessons[1].result.accepted
    assert drive.learning.offers() == () and drive.learning.findings == ()


def test_memory_is_bounded_and_standing_is_not_kept(drive: Drive, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(room, "PIECE_S", 2.0)
    monkeypatch.setattr(room, "WINDOW_S", 80.0)
    drive.learning.restart()
    drive.go(going_round(10), tend=False)
    kept = drive.learning._kept
    before = kept.count
    drive.go(iter([0.0] * 600), tend=False)
    assert kept.count <= before + 2
    assert kept.dropped_s == pytest.approx(60.0, abs=5.0)
    drive.go(going_round(40), tend=False)
    assert kept.count > 70 and len(kept.pieces) == 40
    gyros = [piece.gyro_radps for piece in kept.pieces if piece.gyro_radps is not None]
    gaps = [later.time_s[0] - one.time_s[-1] for one, later in pairwise(gyros)]
    assert max(gaps) < 0.3, "what was left out leaves no gap for the gyro to be carried across"


def test_where_only_another_compass_speaks_no_gyro_tells_the_turns(drive: Drive) -> None:
    for time_s in range(100, 200):
        imu = mav.ScaledImu2(1000 * time_s, 0, 0, -1000, 0, 0, 0, 240, 0, -520)
        drive.learning.hear(drive.view, Incoming(float(time_s), 1, 1, imu))
    drive.tend()
    assert not drive.learning._kept.count and not drive.learning.lessons


@pytest.mark.parametrize(
    "rates",
    [[math.radians(0.4)] * 600, [math.radians(2.0), -math.radians(2.0)] * 300],
    ids=["drifts round slowly", "sways to and fro"],
)
def test_what_hardly_moves_is_kept_where_it_does_not_stand(drive: Drive, rates: list[float]) -> None:
    drive.go(iter(4 * rates))
    assert drive.learning._kept.dropped_s == 0.0
    assert drive.learning.lessons[1].result.reasons[0].startswith("The vehicle turned only ")


def test_iron_that_moved_is_dated_by_the_clock(drive: Drive) -> None:
    drive.go(going_round(12), tend=False)
    drive.go(iter([0.0] * 900), tend=False)
    moved_s = drive.time_s
    drive.iron = IRON + np.array([0.0, 60.0, 0.0])
    drive.go(going_round(24))
    lesson = drive.learning.lessons[1]
    assert lesson.changed_at is not None
    ago = timedelta(seconds=drive.time_s - moved_s)
    assert abs(datetime.now(UTC) - ago - lesson.changed_at) < timedelta(seconds=15.0)
    assert {finding.id for finding in drive.learning.findings} == {"learnt", "moved"}


def test_another_calibration_in_force_begins_anew(drive: Drive) -> None:
    drive.go(going_round(20))
    assert drive.learning.lessons
    drive.view.set_parameters({**drive.view.parameters, "COMPASS_OFS_X": -70.0})
    drive.go(going_round(1))
    assert not drive.learning.lessons


# --- consent ------------------------------------------------------------------------------------------


def learnt(service: RunningService) -> CalibrationResult:
    """What an hour of driving would have taught of compass 1: its true correction."""
    assert service.link is not None
    vehicle = service.link.autopilot
    assert isinstance(vehicle, SimulatedAutopilot)
    setup = vehicle.board.compass_setups[0]
    result = CalibrationResult(1, "running", True, (), setup.model.iron, in_force=setup.in_force)
    field = {"horizontal_mgauss": 240.0, "vertical_mgauss": -520.0}
    return replace(result, heading_sigma_deg=0.2, heading_change_deg=20.0, not_seen_deg=(90,), **field)


@pytest.fixture
def disarmed(start_service: StartService) -> RunningService:
    """A service on a disarmed rover, which has learnt of its first compass."""
    vehicle = SimulatedAutopilot("rover", seed=3, armed=False)
    running = start_service(SimulatedLink(vehicle, speed=20.0))
    station = running.service.station
    wait_for(lambda: station.learning._corrections)
    station.learning.lessons = {1: Lesson(learnt(running))}
    return running


def test_what_was_learnt_is_written_with_consent_and_undone(disarmed: RunningService) -> None:
    client, vehicle = disarmed.client, disarmed.link.autopilot  # type: ignore[union-attr]
    assert isinstance(vehicle, SimulatedAutopilot)
    bent_deg = heading_error_rms_deg(vehicle)
    state = client.get("/api/state").json()
    (about,) = state["learning"]
    assert about["offered"] and about["in_force_error_deg"] == 20.0 and about["sigma_deg"] == 0.2
    assert about["not_seen_deg"] == [90] and about["margin_deg"] == 2.0
    assert any(f["id"] == "learnt" and "20.0 degrees off" in f["text"] for f in state["findings"])

    task = client.post("/api/calibration", json={"method": "running"}).json()
    asking = wait_for(lambda: (t := client.get("/api/task").json())["question"] and t)
    assert "COMPASS_OFS_X" in "".join(asking["details"])
    assert heading_error_rms_deg(vehicle) == bent_deg, "nothing is written without consent"
    client.post("/api/task/answer", json={"yes": True})
    done = disarmed.finish(task)
    assert done["ok"] and done["document"]["written"] and done["document"]["verified"], done["error"]
    assert done["document"]["method"] == "running"
    assert heading_error_rms_deg(vehicle) < 0.5
    wait_for(lambda: client.get("/api/state").json()["learning"] == [])

    undone = disarmed.finish(client.post("/api/undo", json={"entry": done["history_entry"]}).json())
    assert undone["ok"]
    assert heading_error_rms_deg(vehicle) == pytest.approx(bent_deg, abs=0.01)


def test_an_armed_vehicle_and_a_stale_lesson_are_refused(running: RunningService) -> None:
    nothing = running.calibrate(method="running")
    assert nothing["state"] == "failed" and "Nothing was learnt yet" in nothing["error"]
    learning = running.service.station.learning
    wait_for(lambda: learning._corrections)
    learning.lessons = {1: Lesson(learnt(running))}
    armed = running.calibrate(method="running", writing="yes")
    assert armed["state"] == "failed" and "is armed" in armed["error"]
