"""The bodies of requests: one JSON Schema each, which both the check and the OpenAPI description use."""

from __future__ import annotations

import json
from collections.abc import Mapping
from typing import Any

from mavcompass.calibration.methods import method_names

Schema = Mapping[str, Any]

CALIBRATION: Schema = {
    "type": "object",
    "additionalProperties": False,
    "properties": {
        "compasses": {
            "type": "array",
            "items": {"type": "integer", "minimum": 1, "maximum": 3},
            "maxItems": 3,
            "uniqueItems": True,
            "description": "Counted from 1; empty means those of the configuration, or all.",
        },
        "motion": {
            "type": "string",
            "enum": ["auto", "vehicle", "hand"],
            "description": "Who turns the vehicle; auto: itself where it is armed, else a person.",
        },
        "writing": {
            "type": "string",
            "enum": ["ask", "yes", "never"],
            "description": "Whether the result is written: after a question, at once, or not at all.",
        },
        "method": {"type": "string", "enum": list(method_names())},
        "positions": {"type": "integer", "minimum": 3, "maximum": 24},
        "dwell_s": {"type": "number", "minimum": 0.5, "maximum": 60.0},
    },
}
CHECK: Schema = {
    "type": "object",
    "additionalProperties": False,
    "properties": {
        "turn": {
            "type": "string",
            "enum": ["none", "vehicle", "hand"],
            "description": "Who turns the vehicle by 90 degrees, if anybody.",
        }
    },
}
ANSWER: Schema = {
    "type": "object",
    "additionalProperties": False,
    "required": ["yes"],
    "properties": {"yes": {"type": "boolean"}},
}
STOP: Schema = {"type": "object", "additionalProperties": False, "properties": {}}
UNDO: Schema = {
    "type": "object",
    "additionalProperties": False,
    "required": ["entry"],
    "properties": {
        "entry": {
            "type": "integer",
            "minimum": 1,
            "maximum": 2**53,
            "description": "Number of the history's entry whose undo file is to be put back.",
        }
    },
}
GAP: Schema = {
    "type": "object",
    "additionalProperties": False,
    "required": ["entry"],
    "properties": {
        "entry": {
            "type": "integer",
            "minimum": 1,
            "maximum": 2**53,
            "description": "Number of the calibration whose recording is to be explained.",
        }
    },
}
DIFF: Schema = {
    "type": "object",
    "additionalProperties": False,
    "required": ["parameters"],
    "properties": {
        "parameters": {
            "type": "object",
            "maxProperties": 1000,
            "additionalProperties": {"type": "number"},
            "description": "Names and values to compare with those in force.",
        }
    },
}

_TYPES: dict[str, type | tuple[type, ...]] = {
    "object": dict,
    "array": list,
    "string": str,
    "boolean": bool,
    "integer": int,
    "number": (int, float),
}


class BadBody(Exception):
    """Report a body that is not what the schema says: the HTTP status and a sentence."""

    def __init__(self, status: int, what: str) -> None:
        super().__init__(what)
        self.status = status
        self.what = what


def parse_body(data: bytes, content_type: str, schema: Schema) -> dict[str, Any]:
    """Read and check a body; an empty one counts as {}. Raises BadBody with 400, 415 or 422."""
    if not data:
        value: Any = {}
    else:
        if content_type.partition(";")[0].strip().lower() != "application/json":
            raise BadBody(415, "The body must be application/json.")
        try:
            value = json.loads(data)
        except (ValueError, RecursionError) as error:
            raise BadBody(400, "The body is not JSON.") from error
    wrong = mistake(value, schema, "The body")
    if wrong is not None:
        raise BadBody(422, wrong)
    assert isinstance(value, dict)
    return value


def mistake(value: Any, schema: Schema, name: str) -> str | None:
    """Return what is wrong with a value, None where nothing is; knows what the schemas here use."""
    kind = schema.get("type", "")
    wanted = _TYPES[kind]
    # JSON knows no whole numbers: 4.0 is one. True and false are no numbers.
    whole = kind == "integer" and isinstance(value, float) and value.is_integer()
    if not (isinstance(value, wanted) or whole) or (isinstance(value, bool) and kind != "boolean"):
        return f"{name} must be of type {kind}."
    if "enum" in schema and value not in schema["enum"]:
        return f"{name} must be one of {', '.join(schema['enum'])}."
    if kind in ("integer", "number"):
        low, high = schema.get("minimum", value), schema.get("maximum", value)
        return None if low <= value <= high else f"{name} must be between {low:g} and {high:g}."
    if kind == "array":
        return _array_mistake(value, schema, name)
    return _object_mistake(value, schema, name) if kind == "object" else None


def _array_mistake(value: list[Any], schema: Schema, name: str) -> str | None:
    if len(value) > schema.get("maxItems", len(value)):
        return f"{name} may have {schema['maxItems']} elements."
    inside = next((w for item in value if (w := mistake(item, schema["items"], f"{name}[]"))), None)
    if inside is None and schema.get("uniqueItems") and len(set(value)) < len(value):
        return f"{name} has an element twice."
    return inside


def _object_mistake(value: dict[str, Any], schema: Schema, name: str) -> str | None:
    for required in schema.get("required", ()):
        if required not in value:
            return f"{required!r} is missing."
    if len(value) > schema.get("maxProperties", len(value)):
        return f"{name} may have {schema['maxProperties']} members."
    properties, others = schema.get("properties", {}), schema.get("additionalProperties", True)
    for key, item in value.items():
        inner = properties.get(key, others)
        if inner is False:
            return f"{key!r} is not known; there are: {', '.join(properties) or 'none'}."
        if isinstance(inner, Mapping) and (wrong := mistake(item, inner, repr(key))):
            return wrong
    return None
