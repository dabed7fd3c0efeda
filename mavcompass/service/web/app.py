"""The HTTP interface and the web page."""

from __future__ import annotations

import ipaddress
import json
import mimetypes
from collections.abc import Callable
from dataclasses import replace
from functools import cache, partial
from pathlib import Path
from typing import Any

from starlette.applications import Starlette
from starlette.concurrency import run_in_threadpool
from starlette.exceptions import HTTPException
from starlette.middleware import Middleware
from starlette.requests import Request
from starlette.responses import FileResponse, JSONResponse, Response
from starlette.routing import BaseRoute, Route, WebSocketRoute

from mavcompass import __version__
from mavcompass.errors import MavCompassError
from mavcompass.report.svg import PLOT_PARTS, POLICY
from mavcompass.service.config import ServiceConfig
from mavcompass.service.models import Model
from mavcompass.service.station import Station
from mavcompass.service.web.bodies import (
    Answer,
    BadRequest,
    Comparing,
    EntryPath,
    Explaining,
    HistoryQuery,
    Nothing,
    Undoing,
    parse_address,
    parse_body,
)
from mavcompass.service.web.connections import MOST_HELD_BYTES
from mavcompass.service.web.metrics import CONTENT_TYPE, metrics_text
from mavcompass.service.web.openapi import Operation, get, openapi, operations_of, post
from mavcompass.service.web.security import MOST_BODY_BYTES, Guard, page_policy
from mavcompass.service.web.state import moment_json, state_json, stream
from mavcompass.service.work.clock import utc_now
from mavcompass.service.work.history import Entry, History
from mavcompass.service.work.jobs import Gaps
from mavcompass.service.work.results import recording_path
from mavcompass.service.work.tasks import Busy, CalibrationRequest, CheckRequest, Task, UndoRequest
from mavcompass.service.work.tasks import Request as TaskRequest

PAGE = Path(__file__).with_name("page")


def build_app(
    config: ServiceConfig,
    station: Station,
    history: History,
    gaps: Gaps,
    token: str,
    is_alive: Callable[[], bool],
) -> Starlette:
    """Put the interface together."""
    api = Api(config, station, history, gaps, is_alive)
    framed_by = config.http.framed_by

    async def page(request: Request) -> Response:
        policy = page_policy(framed_by, request.headers.get("host", ""))
        text = _parts()["index.html"]
        return Response(text, media_type="text/html", headers={"content-security-policy": policy})

    async def register(request: Request) -> Response:
        here = request.client is not None and ipaddress.ip_address(request.client.host).is_loopback
        return JSONResponse(registration(token if framed_by and here else None))

    routes: list[BaseRoute] = [
        Route("/", page),
        Route(f"{ENTER}{{token}}", page),
        Route("/register_service", register),
        Route("/openapi.json", _describe),
        *(_route(operation, api) for operation in operations_of(Api)),
        WebSocketRoute("/api/stream", partial(stream, station)),
        Route("/web/{name}", _part),
    ]
    guard = Middleware(
        Guard,
        token=token,
        allowed_origins=config.http.allowed_origins,
        allowed_hosts=config.http.allowed_hosts,
        framed_by=framed_by,
    )
    handlers: Any = {HTTPException: _http_error, BadRequest: _bad_request, MavCompassError: _our_error}
    return Starlette(routes=routes, middleware=[guard], exception_handlers=handlers)


# Behind it stands the token, which the page keeps and takes out of its address.
ENTER = "/enter/"


def registration(token: str | None) -> dict[str, str]:
    """Tell BlueOS, which asks every port of its host, what is served here.

    Its menu's link leads to `route`, and what stands behind our name in it is what it opens in its frame. So
    the token goes to those who may use BlueOS; to whom it is None, nothing is handed.
    """
    there = {} if token is None else {"route": f"/extension/mavcompass{ENTER}{token}"}
    return {
        "name": "mavcompass",
        "description": "Compass calibration in four turns, heading with sigma, a watch over the compass.",
        "icon": "mdi-compass-outline",
        "company": "mavcompass",
        "version": __version__,
        "webpage": "https://github.com/mavcompass/mavcompass",
        "api": "/openapi.json",
        **there,
    }


async def _part(request: Request) -> Response:
    name = request.path_params["name"]
    if name not in _parts():
        raise HTTPException(404)
    return Response(_parts()[name], media_type=mimetypes.guess_type(name)[0])


@cache
def _parts() -> dict[str, bytes]:
    """Hold the page's files, some forty kilobytes, in memory: no thread reads them for each who asks."""
    return {path.name: path.read_bytes() for path in (*PAGE.iterdir(), *PLOT_PARTS)}


async def _describe(request: Request) -> Response:
    return Response(_description(), media_type="application/json")


@cache
def _description() -> bytes:
    return json.dumps(openapi(operations_of(Api))).encode()


def _route(operation: Operation, api: Api) -> Route:
    """Make the route of an operation, whose handler is given what it takes, checked."""

    async def answer(request: Request) -> Response:
        if operation.takes is None:
            return await operation.handler(api)
        if operation.where == "body":
            return await operation.handler(api, await _body(request, operation.takes))
        given = request.path_params if operation.where == "path" else request.query_params
        return await operation.handler(api, parse_address(given, operation.takes))

    return Route(operation.path, answer, methods=[operation.method])


async def _http_error(request: Request, error: Exception) -> Response:
    assert isinstance(error, HTTPException)
    return JSONResponse({"error": error.detail}, error.status_code, error.headers)


async def _bad_request(request: Request, error: Exception) -> Response:
    assert isinstance(error, BadRequest)
    return JSONResponse({"error": error.what}, error.status)


async def _our_error(request: Request, error: Exception) -> Response:
    assert isinstance(error, MavCompassError)
    status = 409 if isinstance(error, Busy) else 503
    return JSONResponse({"error": error.what, "remedy": error.remedy}, status)


async def _body(request: Request, model: type[Model]) -> Model:
    """Read and check a body, however long it claims not to be."""
    data = bytearray()
    async for piece in request.stream():
        data += piece
        if len(data) > MOST_BODY_BYTES:
            raise BadRequest(413, f"A request's body may have {MOST_BODY_BYTES} bytes.")
    return parse_body(bytes(data), request.headers.get("content-type", ""), model)


class _File(FileResponse):
    """Send a file in pieces that a connection may hold."""

    chunk_size = MOST_HELD_BYTES


_BUSY = "Another procedure is under way: one motion at a time."
_TAKEN = {202: "Taken; see its task.", 409: _BUSY, 503: "The service is stopping."}
_NOT_THERE = {404: "There is none of this number."}
_NOT_READ = {503: "They were not read yet."}


class Api:
    """Answer each operation."""

    def __init__(
        self,
        config: ServiceConfig,
        station: Station,
        history: History,
        gaps: Gaps,
        is_alive: Callable[[], bool],
    ) -> None:
        self._config = config
        self._station = station
        self._history = history
        self._gaps = gaps
        self._is_alive = is_alive

    # --- reading ------------------------------------------------------------------------------------

    @get("/metrics", "Metrics for Prometheus.", {200: "Metrics."}, "text/plain")
    async def metrics(self) -> Response:
        return Response(metrics_text(self._station), headers={"content-type": CONTENT_TYPE})

    @get("/healthz", "Tell whether the service lives.", {200: "It does.", 503: "It is stuck."})
    async def health(self) -> Response:
        alive = self._is_alive()
        return JSONResponse(
            {"alive": alive} if alive else {"error": "The station is stuck."}, 200 if alive else 503
        )

    @get("/readyz", "Tell whether the vehicle is heard.", {200: "It is.", 503: "It is not heard."})
    async def ready(self) -> Response:
        if self._station.connected:
            return JSONResponse({"ready": True})
        return JSONResponse({"error": self._station.link_error or "The vehicle is not heard."}, 503)

    @get("/api/state", "Tell everything: link, vehicle, headings, findings, task.", {200: "State."})
    async def state(self) -> Response:
        return JSONResponse(state_json(self._station))

    @get(
        "/api/heading",
        "Tell the latest heading of every compass.",
        {200: "Headings.", 503: "The vehicle is not heard."},
    )
    async def heading(self) -> Response:
        if not self._station.connected:
            return JSONResponse({"error": self._station.link_error or "The vehicle is not heard."}, 503)
        return JSONResponse(moment_json(self._station))

    @get("/api/task", "Tell how the latest request is getting on.", {200: "Task.", **_NOT_THERE})
    async def task(self) -> Response:
        return _show(self._station.desk.current)

    @get("/api/history", "List what was done, newest first.", {200: "Entries."})
    async def history(self, query: HistoryQuery) -> Response:
        entries = await run_in_threadpool(
            self._history.entries, query.kind, query.device, query.before, query.limit
        )
        return JSONResponse({"entries": [entry.head() for entry in entries]})

    @get("/api/history/{entry}", "Tell one entry with its document.", {200: "Entry.", **_NOT_THERE})
    async def entry(self, asked: EntryPath) -> Response:
        entry = await self._entry(asked.entry)
        return JSONResponse(entry.head() | {"document": dict(entry.document)})

    async def _entry(self, number: int) -> Entry:
        entry = await run_in_threadpool(self._history.entry, number)
        if entry is None:
            raise HTTPException(404, f"The history has no entry {number}.")
        return entry

    @get(
        "/api/history/{entry}/report",
        "Show the HTML report of an entry.",
        {200: "Report.", **_NOT_THERE},
        "text/html",
    )
    async def report(self, asked: EntryPath) -> Response:
        entry = await self._entry(asked.entry)
        if entry.report is None or not Path(entry.report).is_file():
            raise HTTPException(404, f"Entry {entry.id} has no report.")
        headers = {"content-security-policy": f"{POLICY}; frame-ancestors 'none'"}
        return _File(entry.report, media_type="text/html", headers=headers)

    @get(
        "/api/history/{entry}/recording",
        "Get the recording of a calibration (.tlog).",
        {200: "Recording.", **_NOT_THERE},
        "application/octet-stream",
    )
    async def recording(self, asked: EntryPath) -> Response:
        entry = await self._entry(asked.entry)
        path = recording_path(self._config.folder, entry.id)
        if not path.is_file():
            raise HTTPException(404, f"Entry {entry.id} has no recording.")
        return _File(path, media_type="application/octet-stream", filename=path.name)

    def _in_force(self) -> dict[str, float]:
        view = self._station.view
        if view is None or not view.fresh:
            raise MavCompassError("The compass parameters were not read yet.", "Try again in a moment.")
        return dict(view.parameters)

    @get("/api/parameters", "Tell the compass parameters in force.", {200: "Parameters.", **_NOT_READ})
    async def parameters(self) -> Response:
        return JSONResponse({"parameters": self._in_force()})

    @post(
        "/api/parameters/diff",
        "Compare parameters with those in force; nothing is written.",
        {200: "Differences.", **_NOT_READ},
    )
    async def difference(self, wanted: Comparing) -> Response:
        now = self._in_force()
        changes = [
            {"name": name, "now": now.get(name), "then": value, "differs": _differs(now.get(name), value)}
            for name, value in wanted.parameters.items()
        ]
        return JSONResponse({"differences": changes})

    # --- writing and moving -------------------------------------------------------------------------

    @post("/api/calibration", "Start a calibration. The vehicle may move.", _TAKEN)
    async def calibrate(self, wanted: CalibrationRequest) -> Response:
        return self._take(replace(wanted, compasses=tuple(sorted(wanted.compasses))))

    @post("/api/check", "Start a pre-flight check. With a turn, it moves.", _TAKEN)
    async def check(self, wanted: CheckRequest) -> Response:
        return self._take(wanted)

    @post("/api/undo", "Put back what a calibration in the history replaced.", _TAKEN | _NOT_THERE)
    async def undo(self, wanted: Undoing) -> Response:
        entry = await self._entry(wanted.entry)
        if entry.undo_file is None:
            raise HTTPException(404, f"Entry {entry.id} wrote nothing, so there is nothing to undo.")
        return self._take(UndoRequest(entry.undo_file, entry.id))

    def _take(self, request: TaskRequest) -> Response:
        return _show(self._station.desk.submit(request, "http", utc_now()), 202)

    @post(
        "/api/task/answer",
        "Answer the question that the task asks.",
        {200: "Task.", 409: "No question is open."},
    )
    async def answer(self, answer: Answer) -> Response:
        task = self._station.desk.current
        if task is None or not task.give_answer(answer.yes):
            raise HTTPException(409, "No question is open.")
        return _show(task)

    @post("/api/task/stop", "Stop what is under way, safely.", {200: "Task.", 409: "Nothing is under way."})
    async def stop(self, _: Nothing) -> Response:
        task = self._station.desk.current
        if task is None or task.finished:
            raise HTTPException(409, "Nothing is under way.")
        task.stop.reason = task.stop.reason or "Stopped from the page."
        return _show(task)

    @post(
        "/api/gap",
        "Explain why a calibration's recording differs from the simulation; takes minutes.",
        _TAKEN | _NOT_THERE,
    )
    async def explain(self, wanted: Explaining) -> Response:
        entry = await self._entry(wanted.entry)
        if entry.kind != "calibration" or not recording_path(self._config.folder, entry.id).is_file():
            raise HTTPException(404, f"Entry {entry.id} has no recording.")
        return _show(self._gaps.submit(entry), 202)

    @get("/api/gap", "Tell how the latest diagnosis is getting on.", {200: "Task.", **_NOT_THERE})
    async def explanation(self) -> Response:
        return _show(self._gaps.desk.current)


def _show(task: Task | None, status: int = 200) -> Response:
    if task is None:
        raise HTTPException(404, "Nothing was asked for yet.")
    return JSONResponse(task.to_json(), status)


def _differs(now: float | None, then: float) -> bool:
    return now is None or abs(now - then) > 1e-6 * max(1.0, abs(then))
