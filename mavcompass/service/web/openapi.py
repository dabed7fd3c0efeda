"""The OpenAPI description of the HTTP interface, made from the routes and the bodies' schemas."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from mavcompass import __version__
from mavcompass.service.web import bodies

_ENTRY = {
    "name": "entry",
    "in": "path",
    "required": True,
    "description": "Number of an entry of the history.",
    "schema": {"type": "integer", "minimum": 1, "maximum": 2**53},
}
_ERROR = {
    "type": "object",
    "required": ["error"],
    "properties": {"error": {"type": "string"}, "remedy": {"type": "string"}},
}


@dataclass(frozen=True, slots=True)
class Operation:
    """Describe one operation: what it does, what it takes, which statuses it answers with."""

    method: str
    path: str
    summary: str
    statuses: Mapping[int, str]
    body: bodies.Schema | None = None
    parameters: tuple[Mapping[str, Any], ...] = ()
    content: str = "application/json"


def _query(name: str, schema: Mapping[str, Any], text: str) -> Mapping[str, Any]:
    return {"name": name, "in": "query", "required": False, "description": text, "schema": schema}


_HISTORY_QUERY = (
    _query("kind", {"type": "string", "enum": ["calibration", "check", "undo", "gap"]}, "Only of this kind."),
    _query("device", {"type": "integer", "minimum": 0, "maximum": 2**53}, "Only about this device id."),
    _query("before", {"type": "integer", "minimum": 1, "maximum": 2**53}, "Continue a list before this one."),
    _query("limit", {"type": "integer", "minimum": 1, "maximum": 200}, "At most so many."),
)
_BUSY = "Another procedure is under way: one motion at a time."
_TAKEN = {202: "Taken; see its task.", 409: _BUSY, 503: "The service is stopping."}
_NOT_THERE = {404: "There is none of this number."}

OPERATIONS = (
    Operation(
        "get", "/api/state", "Tell everything: link, vehicle, headings, findings, task.", {200: "State."}
    ),
    Operation(
        "get",
        "/api/heading",
        "Tell the latest heading of every compass.",
        {200: "Headings.", 503: "The vehicle is not heard."},
    ),
    Operation("get", "/api/task", "Tell how the latest request is getting on.", {200: "Task.", **_NOT_THERE}),
    Operation(
        "post", "/api/calibration", "Start a calibration. The vehicle may move.", _TAKEN, bodies.CALIBRATION
    ),
    Operation("post", "/api/check", "Start a pre-flight check. With a turn, it moves.", _TAKEN, bodies.CHECK),
    Operation(
        "post",
        "/api/task/answer",
        "Answer the question that the task asks.",
        {200: "Task.", 409: "No question is open."},
        bodies.ANSWER,
    ),
    Operation(
        "post",
        "/api/task/stop",
        "Stop what is under way, safely.",
        {200: "Task.", 409: "Nothing is under way."},
        bodies.STOP,
    ),
    Operation(
        "post",
        "/api/undo",
        "Put back what a calibration in the history replaced.",
        _TAKEN | _NOT_THERE,
        bodies.UNDO,
    ),
    Operation(
        "get", "/api/history", "List what was done, newest first.", {200: "Entries."}, None, _HISTORY_QUERY
    ),
    Operation(
        "get",
        "/api/history/{entry}",
        "Tell one entry with its document.",
        {200: "Entry.", **_NOT_THERE},
        None,
        (_ENTRY,),
    ),
    Operation(
        "get",
        "/api/history/{entry}/report",
        "Show the HTML report of an entry.",
        {200: "Report.", **_NOT_THERE},
        None,
        (_ENTRY,),
        "text/html",
    ),
    Operation(
        "get",
        "/api/history/{entry}/recording",
        "Get the recording of a calibration (.tlog).",
        {200: "Recording.", **_NOT_THERE},
        None,
        (_ENTRY,),
        "application/octet-stream",
    ),
    Operation(
        "get",
        "/api/parameters",
        "Tell the compass parameters in force.",
        {200: "Parameters.", 503: "They were not read yet."},
    ),
    Operation(
        "post",
        "/api/parameters/diff",
        "Compare parameters with those in force; nothing is written.",
        {200: "Differences.", 503: "They were not read yet."},
        bodies.DIFF,
    ),
    Operation(
        "post",
        "/api/gap",
        "Explain why a calibration's recording differs from the simulation; takes minutes.",
        _TAKEN | _NOT_THERE,
        bodies.GAP,
    ),
    Operation(
        "get", "/api/gap", "Tell how the latest diagnosis is getting on.", {200: "Task.", **_NOT_THERE}
    ),
    Operation("get", "/metrics", "Metrics for Prometheus.", {200: "Metrics."}, content="text/plain"),
    Operation("get", "/register_service", "Tell BlueOS what is served here.", {200: "Registration."}),
    Operation("get", "/healthz", "Tell whether the service lives.", {200: "It does.", 503: "It is stuck."}),
    Operation(
        "get", "/readyz", "Tell whether the vehicle is heard.", {200: "It is.", 503: "It is not heard."}
    ),
)


def openapi() -> dict[str, Any]:
    """Build the description."""
    paths: dict[str, dict[str, Any]] = {}
    for operation in OPERATIONS:
        paths.setdefault(operation.path, {})[operation.method] = _describe(operation)
    return {
        "openapi": "3.1.0",
        "info": {
            "title": "mavcompass service",
            "version": __version__,
            "description": "Heading, calibration and checks of a vehicle's compasses. The WebSocket"
            " /api/stream sends {now, task} up to 20 times a second.",
        },
        "paths": paths,
        "components": {
            "securitySchemes": {"token": {"type": "http", "scheme": "bearer"}},
            "schemas": {"Error": _ERROR},
        },
    }


def _describe(operation: Operation) -> dict[str, Any]:
    error = {"application/json": {"schema": {"$ref": "#/components/schemas/Error"}}}
    statuses = dict(operation.statuses)
    if operation.parameters:
        statuses[422] = "A parameter is out of range."
    if operation.body is not None:
        statuses |= {
            400: "The body is not JSON.",
            401: "The token is missing or wrong.",
            403: "The request comes from another site.",
            413: "The body is too long.",
            415: "The body is not application/json.",
            422: "The body is not as described.",
        }
    statuses[421] = "The service does not answer to this host name."
    name = operation.path.replace("/", "_").replace("{", "").replace("}", "")
    described: dict[str, Any] = {
        "summary": operation.summary,
        "operationId": f"{operation.method}{name}",
        "responses": {
            str(status): {
                "description": text,
                "content": {operation.content: {"schema": {}}} if status < 300 else error,
            }
            for status, text in sorted(statuses.items())
        },
    }
    if operation.parameters:
        described["parameters"] = list(operation.parameters)
    if operation.body is not None:
        described["security"] = [{"token": []}]
        described["requestBody"] = {
            "required": bool(operation.body.get("required")),
            "content": {"application/json": {"schema": operation.body}},
        }
    return described
