"""The OpenAPI description of the HTTP interface, made from its operations and their models."""

from __future__ import annotations

from collections.abc import Awaitable, Callable, Iterator, Mapping, Sequence
from dataclasses import MISSING, dataclass, fields
from functools import partial
from typing import Any, Literal, get_type_hints

import msgspec
from starlette.responses import Response

from mavcompass import __version__

_REFERENCE = "#/components/schemas/{name}"
_ERROR = {
    "type": "object",
    "required": ["error"],
    "properties": {"error": {"type": "string"}, "remedy": {"type": "string"}},
}


Handler = Callable[..., Awaitable[Response]]


@dataclass(frozen=True, slots=True)
class Operation:
    """Describe one operation: who does it, what it does, which statuses it answers with.

    Attributes:
        takes: the model of the body, else of the address; None where its handler takes nothing.
    """

    method: str
    handler: Handler
    path: str
    summary: str
    statuses: Mapping[int, str]
    content: str
    takes: type | None

    @property
    def where(self) -> Literal["body", "path", "query"]:
        """Tell where it takes its model from."""
        return "body" if self.method == "post" else "path" if "{" in self.path else "query"


def operation(
    method: str, path: str, summary: str, statuses: Mapping[int, str], content: str = "application/json"
) -> Callable[[Handler], Handler]:
    """Make a method of an interface an operation of it; what it takes is the type of its argument."""

    def decorate(handler: Handler) -> Handler:
        takes = [kind for name, kind in get_type_hints(handler).items() if name != "return"]
        described = Operation(method, handler, path, summary, statuses, content, *(takes or [None]))
        handler.operation = described  # type: ignore[attr-defined]
        return handler

    return decorate


get, post = partial(operation, "get"), partial(operation, "post")


def operations_of(interface: type) -> tuple[Operation, ...]:
    """List the operations of an interface, in the order in which they stand in it."""
    return tuple(one.operation for one in vars(interface).values() if hasattr(one, "operation"))


def openapi(operations: Sequence[Operation]) -> dict[str, Any]:
    """Build the description."""
    taken = {operation.takes for operation in operations if operation.where == "body"} - {None}
    _, schemas = msgspec.json.schema_components(taken, ref_template=_REFERENCE)
    for schema in schemas.values():
        schema["additionalProperties"] = False
    paths: dict[str, dict[str, Any]] = {}
    for operation in operations:
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
