"""The OpenAPI description of the HTTP interface, made from its operations and their models."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import MISSING, dataclass, fields
from functools import partial
from typing import Any, Literal, get_type_hints

import msgspec

from mavcompass import __version__
from mavcompass.service.web import bodies
from mavcompass.service.work.tasks import CalibrationRequest, CheckRequest

_REFERENCE = "#/components/schemas/{name}"
_ERROR = {
    "type": "object",
    "required": ["error"],
    "properties": {"error": {"type": "string"}, "remedy": {"type": "string"}},
}


@dataclass(frozen=True, slots=True)
class Operation:
    """Describe one operation: who does it, what it does, which statuses it answers with.

    Attributes:
        handler: name of the method of `app.Api`. takes: the model of the body, else of the address.
    """

    method: str
    handler: str
    path: str
    summary: str
    statuses: Mapping[int, str]
    takes: type | None = None
    content: str = "application/json"

    @property
    def where(self) -> Literal["body", "path", "query"]:
        """Tell where it takes its model from."""
        return "body" if self.method == "post" else "path" if "{" in self.path else "query"


_BUSY = "Another procedure is under way: one motion at a time."
_TAKEN = {202: "Taken; see its task.", 409: _BUSY, 503: "The service is stopping."}
_NOT_THERE = {404: "There is none of this number."}

_get = partial(Operation, "get")
_post = partial(Operation, "post")

OPERATIONS = (
    _get("state", "/api/state", "Tell everything: link, vehicle, headings, findings, task.", {200: "State."}),
    _get(
        "heading",
        "/api/heading",
        "Tell the latest heading of every compass.",
        {200: "Headings.", 503: "The vehicle is not heard."},
    ),
    _get("task", "/api/task", "Tell how the latest request is getting on.", {200: "Task.", **_NOT_THERE}),
    _post(
        "calibrate",
        "/api/calibration",
        "Start a calibration. The vehicle may move.",
        _TAKEN,
        CalibrationRequest,
    ),
    _post("check", "/api/check", "Start a pre-flight check. With a turn, it moves.", _TAKEN, CheckRequest),
    _post(
        "answer",
        "/api/task/answer",
        "Answer the question that the task asks.",
        {200: "Task.", 409: "No question is open."},
        bodies.Answer,
    ),
    _post(
        "stop",
        "/api/task/stop",
        "Stop what is under way, safely.",
        {200: "Task.", 409: "Nothing is under way."},
        bodies.Nothing,
    ),
    _post(
        "undo",
        "/api/undo",
        "Put back what a calibration in the history replaced.",
        _TAKEN | _NOT_THERE,
        bodies.Undoing,
    ),
    _get(
        "history", "/api/history", "List what was done, newest first.", {200: "Entries."}, bodies.HistoryQuery
    ),
    _get(
        "entry",
        "/api/history/{entry}",
        "Tell one entry with its document.",
        {200: "Entry.", **_NOT_THERE},
        bodies.EntryPath,
    ),
    _get(
        "report",
        "/api/history/{entry}/report",
        "Show the HTML report of an entry.",
        {200: "Report.", **_NOT_THERE},
        bodies.EntryPath,
        content="text/html",
    ),
    _get(
        "recording",
        "/api/history/{entry}/recording",
        "Get the recording of a calibration (.tlog).",
        {200: "Recording.", **_NOT_THERE},
        bodies.EntryPath,
        content="application/octet-stream",
    ),
    _get(
        "parameters",
        "/api/parameters",
        "Tell the compass parameters in force.",
        {200: "Parameters.", 503: "They were not read yet."},
    ),
    _post(
        "difference",
        "/api/parameters/diff",
        "Compare parameters with those in force; nothing is written.",
        {200: "Differences.", 503: "They were not read yet."},
        bodies.Comparing,
    ),
    _post(
        "explain",
        "/api/gap",
        "Explain why a calibration's recording differs from the simulation; takes minutes.",
        _TAKEN | _NOT_THERE,
        bodies.Explaining,
    ),
    _get(
        "explanation",
        "/api/gap",
        "Tell how the latest diagnosis is getting on.",
        {200: "Task.", **_NOT_THERE},
    ),
    _get("metrics", "/metrics", "Metrics for Prometheus.", {200: "Metrics."}, content="text/plain"),
    _get("health", "/healthz", "Tell whether the service lives.", {200: "It does.", 503: "It is stuck."}),
    _get("ready", "/readyz", "Tell whether the vehicle is heard.", {200: "It is.", 503: "It is not heard."}),
)


def openapi() -> dict[str, Any]:
    """Build the description."""
    taken = {operation.takes for operation in OPERATIONS if operation.where == "body"} - {None}
    _, schemas = msgspec.json.schema_components(taken, ref_template=_REFERENCE)
    for schema in schemas.values():
        schema["additionalProperties"] = False
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
            "schemas": {"Error": _ERROR, **schemas},
        },
    }


def _describe(operation: Operation) -> dict[str, Any]:
    error = {"application/json": {"schema": {"$ref": _REFERENCE.format(name="Error")}}}
    statuses = dict(operation.statuses)
    takes = operation.takes
    if takes is not None and operation.where == "body":
        statuses |= {
            400: "The body is not JSON.",
            401: "The token is missing or wrong.",
            403: "The request comes from another site.",
            413: "The body is too long.",
            415: "The body is not application/json.",
            422: "The body is not as described.",
        }
    elif takes is not None:
        statuses[422] = "A parameter is out of range."
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
    if takes is not None and operation.where == "body":
        described["security"] = [{"token": []}]
        described["requestBody"] = {
            "required": any(field.default is MISSING for field in fields(takes)),
            "content": {"application/json": {"schema": {"$ref": _REFERENCE.format(name=takes.__name__)}}},
        }
    elif takes is not None:
        described["parameters"] = list(_parameters(takes, operation.where))
    return described


def _parameters(model: type, where: str) -> Iterator[dict[str, Any]]:
    """Describe the fields of a model as parameters of an address."""
    for name, kind in get_type_hints(model, include_extras=True).items():
        schema = msgspec.json.schema(kind)
        text = schema.pop("description")
        schema = schema.get("anyOf", [schema])[0]  # left out, not null
        yield {"name": name, "in": where, "required": where == "path", "description": text, "schema": schema}
