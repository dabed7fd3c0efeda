"""What programs get from the service over HTTP."""

from __future__ import annotations

import asyncio
import json
import re
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import httpx
import pytest
from running_service import RunningService, StartService, configured, wait_for
from websockets.sync.client import connect

from mavcompass.service.config import HeadingConfig
from mavcompass.service.run import Service, link_opener
from mavcompass.service.station import Station
from mavcompass.service.web.app import build_app
from mavcompass.service.web.state import sensible_rate_hz, state_json
from mavcompass.service.work.history import History
from mavcompass.service.work.jobs import Gaps
from mavcompass.simulation.heading_error import heading_error_rms_deg
from mavcompass.vehicle.links.simulated import SimulatedLink


class Asked:
    """A service that was asked for a calibration twice: no was answered, then yes."""

    def __init__(self, running: RunningService) -> None:
        assert running.link is not None
        self.running, self.client, self.vehicle = running, running.client, running.link.autopilot
        self.held, self.off_deg, self.asking, self.tasks = [self.parameters()], [self.error_deg()], [], []
        for yes in (False, True):
            task = self.client.post("/api/calibration", json={"compasses": [1]}).json()
            self.asking.append(wait_for(self.question))
            assert self.client.post("/api/task/answer", json={"yes": yes}).status_code == 200
            self.tasks.append(running.finish(task))
            self.held.append(self.parameters())
            self.off_deg.append(self.error_deg())

    def parameters(self) -> dict[str, float]:
        return dict(wait_for(lambda: self.client.get("/api/parameters").json().get("parameters")))

    def question(self) -> dict[str, Any] | None:
        now: dict[str, Any] = self.client.get("/api/task").json()
        return now if now["state"] == "asking" else None

    def error_deg(self) -> float:
        return heading_error_rms_deg(self.vehicle)  # type: ignore[arg-type]


@pytest.fixture(scope="module")
def asked(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Asked]:
    link = SimulatedLink.of("rover", seed=3, speed=20.0)
    service = Service(configured(tmp_path_factory.mktemp("asked")), lambda: link)
    with RunningService(service, link) as running:
        yield Asked(running)


def test_the_person_is_asked_before_anything_is_written(asked: Asked) -> None:
    assert all("COMPASS_OFS_X" in "".join(asking["details"]) for asking in asked.asking)
    assert [task["document"]["written"] for task in asked.tasks] == [False, True]
    before, refused, written = (held["COMPASS_OFS_X"] for held in asked.held)
    assert before == refused != written


def test_a_calibration_from_request_to_undo(asked: Asked) -> None:
    running, task, (_, before, after) = asked.running, asked.tasks[1], asked.held
    assert (task["state"], task["ok"]) == ("done", True), task["error"]
    document = task["document"]
    assert document["schema"] == "mavcompass.calibration/1"
    assert document["written"] and document["verified"]
    assert asked.off_deg[1] > 10.0 and asked.off_deg[2] < 1.0
    assert task["fraction"] == 1.0
    fractions = [line["fraction"] for line in task["lines"]]
    assert fractions == sorted(fractions)

    entry = running.client.get(f"/api/history/{task['history_entry']}").json()
    assert entry["kind"] == "calibration" and entry["ok"] and entry["has_report"]
    assert entry["document"] == document
    old_and_new = document["old_and_new"][0]
    assert old_and_new["old"]["offsets_mgauss"][0] == pytest.approx(before["COMPASS_OFS_X"], abs=1e-3)
    assert len(old_and_new["deviation"]) == 24
    report = running.stranger.get(f"/api/history/{entry['id']}/report")
    assert report.status_code == 200 and "Compass calibration" in report.text
    recording = running.stranger.get(f"/api/history/{entry['id']}/recording")
    assert len(recording.content) > 10_000

    assert after["COMPASS_OFS_X"] != pytest.approx(before["COMPASS_OFS_X"], abs=0.1)
    y = after["COMPASS_OFS_Y"]
    body = {"parameters": {"COMPASS_OFS_X": before["COMPASS_OFS_X"], "COMPASS_OFS_Y": y, "NO_SUCH": 1.0}}
    differences = running.client.post("/api/parameters/diff", json=body).json()["differences"]
    assert [d["differs"] for d in differences] == [True, False, True]
    assert differences[1]["now"] == y and differences[2]["now"] is None

    undo = running.client.post("/api/undo", json={"entry": entry["id"]})
    assert undo.status_code == 202
    undone = running.finish(undo.json())
    assert undone["ok"], undone["error"]
    for lacking in ("report", "recording"):
        assert running.client.get(f"/api/history/{undone['history_entry']}/{lacking}").status_code == 404
    assert running.client.post("/api/gap", json={"entry": undone["history_entry"]}).status_code == 404
    nothing = running.client.post("/api/undo", json={"entry": asked.tasks[0]["history_entry"]})
    assert nothing.status_code == 404 and "wrote nothing" in nothing.json()["error"]
    restored = asked.parameters()
    for name in document["compasses"][0]["parameters"]:
        assert restored[name] == pytest.approx(before[name], abs=1e-5), name


def test_the_recording_of_a_calibration_is_read_like_any_other(asked: Asked, tmp_path: Path) -> None:
    from mavcompass import api

    running, task = asked.running, asked.tasks[0]
    path = tmp_path / "calibration.tlog"
    path.write_bytes(running.client.get(f"/api/history/{task['history_entry']}/recording").content)
    result = api.calibrate(api.read_track(path))
    found = task["document"]["compasses"][0]["correction"]["offsets_mgauss"]
    assert result.accepted
    assert result.correction.offsets_mgauss[:2] == pytest.approx(found[:2], abs=2.0)

    posted = running.client.post("/api/gap", json={"entry": task["history_entry"]})
    assert posted.status_code == 202
    explained = wait_for(
        lambda: (t := running.client.get("/api/gap").json())["state"] in ("done", "failed") and t
    )
    assert explained["ok"], explained["error"]
    assert explained["document"]["schema"] == "mavcompass.gap/1"
    page = running.stranger.get(f"/api/history/{explained['history_entry']}/report")
    assert page.status_code == 200 and "gap" in page.text
    entry = running.client.get("/api/history?kind=gap").json()["entries"][0]
    assert entry["summary"] and entry["ok"]


def test_one_point_is_asked_for_with_its_heading(running: RunningService) -> None:
    task = running.calibrate(
        method="one-point", true_heading_deg=40.0, max_error_deg=45.0, writing="never", compasses=[1]
    )
    (compass,) = task["document"]["compasses"]
    assert compass["method"] == "one-point"
    assert compass["true_heading"] == {"heading_deg": pytest.approx(40.0), "sigma_deg": pytest.approx(1.0)}


def test_a_calibration_makes_the_check_pass_and_the_heading_surer(running: RunningService) -> None:
    def check() -> dict[str, object]:
        task = running.client.post("/api/check", json={"turn": "vehicle"}).json()
        return dict(running.finish(task)["document"])

    def sigma_deg() -> float:
        return float(running.client.get("/api/heading").json()["headings"][0]["sigma_deg"])

    def state() -> dict[str, Any]:
        return dict(running.client.get("/api/state").json())

    before = sigma_deg()
    first = check()
    assert first["verdict"] == "fail" and first["calibration_advised"] and first["turned"]
    assert running.calibrate(writing="yes")["ok"]
    assert check()["verdict"] == "pass"
    wait_for(lambda: state()["vehicle"]["compasses"][0]["calibration_sigma_deg"] < 1)
    wait_for(lambda: sigma_deg() < 1.5)
    assert before > 4.0
    assert not [f for f in state()["findings"] if f["compass"] == 1]

    assert running.link is not None
    store = running.link.autopilot.firmware.store  # type: ignore[attr-defined]
    store.set("COMPASS_OFS_X", 77.0)
    running.client.post("/api/check", json={})  # after it the parameters are read again
    finding = wait_for(lambda: [f for f in state()["findings"] if f["id"] == "parameters"])[0]
    assert finding["text"].startswith("COMPASS_OFS_X of compass 1 differs from what was calibrated ")
    compass, severity = finding["compass"], finding["severity"]
    told = f'mavcompass_finding{{compass="{compass}",id="parameters",severity="{severity}"}} 1.0'
    assert told in running.client.get("/metrics").text.splitlines()


def test_the_state_is_told_and_that_it_is_ready_and_alive(quiet: RunningService) -> None:
    state = quiet.stranger.get("/api/state").json()
    assert state["vehicle"]["kind"] == "rover" and state["link"]["connected"]
    assert [c["instance"] for c in state["vehicle"]["compasses"]] == [1, 2, 3]
    told = wait_for(lambda: quiet.stranger.get("/api/heading").json()["headings"])
    assert 0.0 <= told[0]["magnetic_deg"] < 360.0
    assert quiet.stranger.get("/readyz").json() == {"ready": True}
    assert quiet.stranger.get("/healthz").json() == {"alive": True}


def test_the_stream_sends_headings_and_progress(running: RunningService) -> None:
    url = running.service.url.replace("http", "ws") + "api/stream?rate_hz=20"
    with connect(url) as socket:
        first = json.loads(socket.recv(timeout=300.0))
        assert first["task"] is None and "findings" in first
        assert first["now"]["headings"][0]["instance"] == 1
        running.client.post("/api/check", json={})
        seen = []
        while not seen or seen[-1]["state"] not in ("done", "failed"):
            message = json.loads(socket.recv(timeout=300.0))
            if message.get("task"):
                seen.append(message["task"])
        assert seen[-1]["ok"] is False
        assert len(seen) >= 2


@pytest.mark.parametrize(
    ("asked_for", "rate_hz"),
    [(None, 10.0), ("", 10.0), ("nan", 10.0), ("many", 10.0), ("-3", 0.1), ("1e9", 20.0), ("2.5", 2.5)],
)
def test_any_rate_that_a_listener_asks_for_is_made_sensible(asked_for: str | None, rate_hz: float) -> None:
    assert sensible_rate_hz(asked_for) == rate_hz


def test_no_answer_waits_for_an_acknowledgement(quiet: RunningService) -> None:
    """Head and body go out at once; with Nagle's algorithm each answer takes 40 ms after the first few."""
    seconds = [quiet.stranger.get("/healthz").elapsed.total_seconds() for _ in range(40)]
    assert min(seconds[20:]) < 0.03


def test_metrics_are_gathered_when_they_are_asked_for(quiet: RunningService) -> None:
    def headings() -> float:
        (line,) = re.findall(r"^mavcompass_headings_total (.*)$", quiet.stranger.get("/metrics").text, re.M)
        return float(line)

    before = headings()
    wait_for(lambda: headings() > before)
    told = quiet.stranger.get("/metrics").text.splitlines()
    assert {f"mavcompass_{name}_total 0.0" for name in ("reconnects", "reboots", "tasks")} <= set(told)


def test_what_is_not_there_is_told(quiet: RunningService) -> None:
    most = 2**53  # what is beyond it no reader of JSON knows exactly
    numbers = ("/api/history/1", f"/api/history/{most}", f"/api/history/{most}/report")
    for path in (*numbers, "/api/task", "/api/gap", "/web/nothing"):
        answer = quiet.client.get(path)
        assert answer.status_code == 404 and answer.json()["error"], path
    for what in (
        "/x",
        "/0",
        f"/{most + 1}",
        "?limit=0",
        "?limit=201",
        "?kind=x",
        "?device=-1",
        f"?device={most + 1}",
    ):
        assert quiet.client.get(f"/api/history{what}").status_code == 422, what
    for device in (0, most):
        assert quiet.client.get(f"/api/history?device={device}").status_code == 200
    for path in ("/api/undo", "/api/gap"):
        assert quiet.client.post(path, json={"entry": 99}).status_code == 404
    assert quiet.client.post("/api/state").status_code == 405


def test_a_service_that_hears_no_vehicle_and_is_stuck_says_so(tmp_path: Path) -> None:
    config, history = configured(tmp_path), History(tmp_path / "history.db")
    station = Station(config, history, link_opener(config))
    door = httpx.ASGITransport(build_app(config, station, history, Gaps(config, history), "", lambda: False))

    async def answers() -> list[tuple[int, str]]:
        async with httpx.AsyncClient(transport=door, base_url="http://localhost") as client:
            told = [await client.get(path) for path in ("/readyz", "/api/heading", "/healthz")]
        return [(answer.status_code, answer.json()["error"]) for answer in told]

    for reason, said in (("", "The vehicle is not heard."), ("It is unplugged.", "It is unplugged.")):
        station.link_error = reason
        assert asyncio.run(answers()) == [(503, said), (503, said), (503, "The station is stuck.")]
    assert {name for name, value in state_json(station)["link"].items() if value} == {"source", "error"}
    history.close()


def test_every_heading_goes_out_as_a_datagram(start_service: StartService) -> None:
    import socket

    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as listener:
        listener.bind(("127.0.0.1", 0))
        listener.settimeout(10.0)
        start_service(heading=HeadingConfig(publish=f"udp:127.0.0.1:{listener.getsockname()[1]}"))
        heading = json.loads(listener.recv(1000))
    assert heading["compass"] in (1, 2, 3)
    assert 0.0 <= heading["magnetic_deg"] < 360.0
    assert heading["sigma_deg"] > 0.0
