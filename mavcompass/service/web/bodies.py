"""What requests bring besides those for a procedure: small models, and the way from text to a model."""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Annotated, Any, get_type_hints

from msgspec import Meta

from mavcompass.service.models import Mistakes, Model, read
from mavcompass.service.work.history import Kind

# JSON's numbers are exact up to here, and so are those of whoever reads them.
MOST_NUMBER = 2**53
EntryNumber = Annotated[int, Meta(ge=1, le=MOST_NUMBER)]


@dataclass(frozen=True, slots=True)
class Answer:
    """Answer the question that the task asks."""

    yes: bool


@dataclass(frozen=True, slots=True)
class Nothing:
    """Bring nothing."""


@dataclass(frozen=True, slots=True)
class Undoing:
    """Name what to undo."""

    entry: Annotated[EntryNumber, Meta(description="The history's entry whose undo file is to be put back.")]


@dataclass(frozen=True, slots=True)
class Explaining:
    """Name what to explain."""

    entry: Annotated[EntryNumber, Meta(description="The calibration whose recording is to be explained.")]


@dataclass(frozen=True, slots=True)
class Comparing:
    """Bring parameters to compare with those in force."""

    parameters: Annotated[dict[str, float], Meta(max_length=1000, description="Names and values.")]


@dataclass(frozen=True, slots=True)
class EntryPath:
    """Name an entry in the address."""

    entry: Annotated[EntryNumber, Meta(description="Number of an entry of the history.")]


@dataclass(frozen=True, slots=True)
class HistoryQuery:
    """Choose among the entries of the history."""

    kind: Annotated[Kind | None, Meta(description="Only of this kind.")] = None
    device: Annotated[
        Annotated[int, Meta(ge=0, le=MOST_NUMBER)] | None, Meta(description="Only about this device id.")
    ] = None
    before: Annotated[EntryNumber | None, Meta(description="Continue a list before this one.")] = None
    limit: Annotated[int, Meta(ge=1, le=200, description="At most so many.")] = 50


class BadRequest(Exception):
    """Report a request that is not as described: the HTTP status and a sentence."""

    def __init__(self, status: int, what: str) -> None:
        super().__init__(what)
        self.status = status
        self.what = what


def parse_body(data: bytes, content_type: str, model: type[Model]) -> Model:
    """Read and check a body; an empty one counts as {}. Raises BadRequest with 400, 415 or 422."""
    value: Any = {}
    if data:
        if content_type.partition(";")[0].strip().lower() != "application/json":
            raise BadRequest(415, "The body must be application/json.")
        try:
            value = json.loads(data, parse_float=_number)
        except (ValueError, RecursionError) as error:
            raise BadRequest(400, "The body is not JSON.") from error
    if not isinstance(value, dict):
        raise BadRequest(422, "The body must be an object.")
    return _read(model, value)


def parse_address(values: Mapping[str, str], model: type[Model]) -> Model:
    """Read what an address holds, leaving what the model does not know. Raises BadRequest with 422."""
    known = get_type_hints(model)
    return _read(model, {name: text for name, text in values.items() if name in known}, strict=False)


def _read(model: type[Model], values: Mapping[str, Any], strict: bool = True) -> Model:
    try:
        return read(model, values, strict)
    except Mistakes as wrong:
        raise BadRequest(422, "; ".join(f"{name!r} {what}" for name, what in wrong.found) + ".") from wrong


def _number(text: str) -> int | float:
    """Read a number; JSON knows no whole ones, so 4.0 is one."""
    value = float(text)
    return int(value) if value.is_integer() else value
