"""Nothing is written or moved without the token, from another origin, or beside another procedure."""

from __future__ import annotations

import stat
from pathlib import Path

import httpx
import pytest
from running_service import RunningService, StartService, wait_for
from websockets.exceptions import InvalidStatus
from websockets.sync.client import connect

from mavcompass.errors import UsageError
from mavcompass.service.config import HttpConfig
from mavcompass.service.web.app import Api, operations_of
from mavcompass.service.web.security import load_token

WRITING = [operation.path for operation in operations_of(Api) if operation.method == "post"]


def test_every_request_that_is_not_reading_needs_the_token(quiet: RunningService) -> None:
    for path in WRITING:
        refused = quiet.stranger.post(path, json={})
        assert (refused.status_code, refused.headers.get("www-authenticate")) == (401, "Bearer"), path
        wrong = {"authorization": "Bearer " + "x" * len(quiet.service.token)}
        assert quiet.stranger.post(path, json={}, headers=wrong).status_code == 401, path
        basic = {"authorization": f"Basic {quiet.service.token}"}
        assert quiet.stranger.post(path, json={}, headers=basic).status_code == 401, path
        query = quiet.stranger.post(f"{path}?token={quiet.service.token}", json={})
        assert query.status_code == 401, path
    for method in ("PUT", "PATCH", "DELETE"):
        assert quiet.stranger.request(method, "/api/state").status_code == 401
    assert quiet.service.station.desk.current is None


TAKEN, THERE = "202 409 503", "200 404"
OWN_ANSWERS = {
    "get /api/task": THERE, "get /api/gap": THERE, "get /api/history/{entry}": THERE,
    "get /api/history/{entry}/report": THERE, "get /api/history/{entry}/recording": THERE,
    "get /api/parameters": "200 503", "get /api/heading": "200 503", "post /api/parameters/diff": "200 503",
    "post /api/calibration": TAKEN, "post /api/check": TAKEN, "post /api/undo": f"{TAKEN} 404",
    "post /api/gap": f"{TAKEN} 404", "post /api/task/answer": "200 409", "post /api/task/stop": "200 409",
    "get /healthz": "200 503", "get /readyz": "200 503",
}  # fmt: skip


def test_every_writing_request_is_described_as_needing_the_token_and_with_its_refusals(
    quiet: RunningService,
) -> None:
    described = quiet.stranger.get("/openapi.json").json()["paths"]
    for path, operations in described.items():
        for method, operation in operations.items():
            assert ("security" in operation) == (method == "post"), (method, path)
            refusals = {"400", "401", "403", "413", "415", "421", "422"} if method == "post" else {"421"}
            refusals |= {"422"} if "parameters" in operation else set()
            own = set(OWN_ANSWERS.get(f"{method} {path}", "200").split())
            assert set(operation["responses"]) == own | refusals, (method, path)


@pytest.mark.parametrize(
    "headers",
    [
        {"origin": "http://evil.example"},
        {"origin": "null"},
        {"origin": "http://evil.example:8808"},
        {"sec-fetch-site": "cross-site"},
        {"sec-fetch-site": "cross-site", "origin": "http://evil.example"},
    ],
)
def test_another_site_is_refused_even_with_the_token(quiet: RunningService, headers: dict[str, str]) -> None:
    answer = quiet.client.post("/api/check", json={}, headers=headers)
    assert answer.status_code == 403
    assert "access-control-allow-origin" not in answer.headers
    assert quiet.service.station.desk.current is None


def test_the_page_itself_and_allowed_origins_are_accepted(start_service: StartService) -> None:
    http = HttpConfig(listen="127.0.0.1:0", allowed_origins=("http://console.example",))
    running = start_service(http=http)
    own = running.service.url.rstrip("/")
    for origin in (own, "http://console.example"):
        answer = running.client.post("/api/task/stop", json={}, headers={"origin": origin})
        assert answer.status_code == 409, answer.text  # nothing is under way


@pytest.mark.parametrize("host", ["evil.example", "evil.example:8808", "127.0.0.1.evil.example", "", "a b"])
def test_a_foreign_name_for_our_address_is_refused(quiet: RunningService, host: str) -> None:
    assert quiet.stranger.get("/api/state", headers={"host": host}).status_code == 421


@pytest.mark.parametrize("host", ["localhost", "localhost:1", "127.0.0.1", "[::1]:8808", "192.168.2.2:8808"])
def test_our_names_and_addresses_are_accepted(quiet: RunningService, host: str) -> None:
    assert quiet.stranger.get("/api/state", headers={"host": host}).status_code == 200


def test_the_stream_is_not_given_to_other_sites(quiet: RunningService) -> None:
    url = quiet.service.url.replace("http", "ws") + "api/stream"
    with pytest.raises(InvalidStatus) as caught:
        connect(url, origin="http://evil.example")  # type: ignore[arg-type]
    assert caught.value.response.status_code == 403
    with connect(url, origin=quiet.service.url.rstrip("/")) as socket:  # type: ignore[arg-type]
        assert "now" in socket.recv(timeout=300.0)


def test_one_motion_at_a_time_whoever_asks(start_service: StartService) -> None:
    running = start_service(speed=2.0)
    first = running.client.post("/api/calibration", json={"writing": "never"})
    assert first.status_code == 202
    for path, body in (("calibration", {}), ("check", {"turn": "vehicle"})):
        second = running.client.post(f"/api/{path}", json=body)
        assert second.status_code == 409
        assert "under way" in second.json()["error"]
    assert running.client.post("/api/task/answer", json={"yes": True}).status_code == 409
    assert running.client.post("/api/task/stop", json={}).status_code == 200
    ended = running.finish(first.json())
    assert ended["state"] == "failed"
    assert "Stopped from the page" in ended["error"]
    assert running.link is not None
    wait_for(lambda: abs(running.link.autopilot.truth.yaw_rate_radps) < 0.05)  # type: ignore


@pytest.mark.parametrize(
    ("content", "kind", "status"),
    [
        (b"{", "application/json", 400),
        (b"[" * 20000, "application/json", 400),
        (b"{}", "text/plain", 415),
        (b"[]", "application/json", 422),
        (b'{"motion":"fast"}', "application/json", 422),
        (b'{"positions":2}', "application/json", 422),
        (b'{"positions":true}', "application/json", 422),
        (b'{"compasses":[1,1]}', "application/json", 422),
        (b'{"dwell_s":1e999}', "application/json", 422),
        (b'{"dwell_s":NaN}', "application/json", 422),
        (b'{"unheard":1}', "application/json", 422),
        (b'{"motion":"' + b"x" * 70000 + b'"}', "application/json", 413),
        (b"\xff\xfe", "application/json", 400),
    ],
)
def test_a_bad_body_is_refused_with_the_right_status(
    quiet: RunningService, content: bytes, kind: str, status: int
) -> None:
    answer = quiet.client.post("/api/calibration", content=content, headers={"content-type": kind})
    assert answer.status_code == status, answer.text
    assert answer.json()["error"]
    assert quiet.service.station.desk.current is None


def test_a_body_longer_than_it_claims_is_cut_off(quiet: RunningService) -> None:
    def pieces() -> list[bytes]:
        return [b"x" * 10_000] * 20

    answer = quiet.client.post("/api/check", content=iter(pieces()))
    assert answer.status_code == 413


def test_pages_are_served_with_careful_headers(quiet: RunningService) -> None:
    page = quiet.stranger.get("/")
    assert "script-src 'self'" in page.headers["content-security-policy"]
    for path in ("/", "/api/state", "/web/app.js"):
        headers = quiet.stranger.get(path).headers
        assert headers["x-content-type-options"] == "nosniff"
        assert headers["x-frame-options"] == "DENY"


def test_a_named_page_may_frame_it_and_is_handed_the_token_on_this_machine(
    start_service: StartService, monkeypatch: pytest.MonkeyPatch
) -> None:
    http = HttpConfig(listen="127.0.0.1:0", framed_by=("http://{host}", "http://boat.example"))
    running = start_service(http=http)
    route = running.stranger.get("/register_service").json()["route"]
    page = running.stranger.get(route.removeprefix("/extension/mavcompass"), headers={"host": "[::1]:8808"})
    assert route.endswith(running.service.token) and page.text == running.stranger.get("/").text
    policy = page.headers["content-security-policy"]
    assert policy.endswith("frame-ancestors http://[::1] http://boat.example")
    assert "x-frame-options" not in page.headers
    monkeypatch.setattr("ipaddress.IPv4Address.is_loopback", False)
    assert "route" not in running.stranger.get("/register_service").json(), "asked from another machine"


@pytest.mark.parametrize("path", ["/web/../app.py", "/web/%2e%2e/app.py", "/web/..%2fapp.py"])
def test_only_the_page_s_files_are_served(quiet: RunningService, path: str) -> None:
    with httpx.Client() as client:
        answer = client.get(quiet.service.url.rstrip("/") + path)
    assert answer.status_code == 404


def test_the_token_is_made_once_and_is_for_its_owner_only(tmp_path: Path) -> None:
    path = tmp_path / "deep" / "token"
    token = load_token(path)
    assert len(token) >= 32
    assert stat.S_IMODE(path.stat().st_mode) == 0o600
    assert load_token(path) == token
    path.write_text("short")
    with pytest.raises(UsageError, match="shorter"):
        load_token(path)
    with pytest.raises(UsageError, match="cannot be used"):
        load_token(path / "below")
