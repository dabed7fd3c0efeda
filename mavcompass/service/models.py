"""What people and programs write, checked against its model: a dataclass that is type, check and document.

The fields are annotated with `msgspec.Meta`: limits, a description for the document, and in `extra` a further
`check` of a value: it returns the rest of a sentence that begins with the field's name, None if all is well.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from functools import cache
from typing import Annotated, Any, TypeVar, get_type_hints

import msgspec
from msgspec import Meta, inspect

from mavcompass.printable import did_you_mean

Model = TypeVar("Model")
Check = Callable[[Any], str | None]

Compass = Annotated[int, Meta(ge=1, le=3)]
Text = Annotated[str, Meta(min_length=1)]


class Mistakes(Exception):
    """Report what is wrong: pairs of a field's name and the rest of a sentence that begins with it."""

    def __init__(self, found: list[tuple[str, str]]) -> None:
        super().__init__("; ".join(f"{name} {what}" for name, what in found))
        self.found = found


def checked(check: Check) -> Meta:
    """Return the annotation of a field that has a check of its own."""
    return Meta(extra={"check": check})


def read(model: type[Model], values: Mapping[str, Any], strict: bool = True) -> Model:
    """Make a model of what was written; not `strict` reads numbers from text.

    Raises Mistakes, which tells all of them at once.
    """
    kind: Any = model  # a class can be looked up, which mypy does not see
    types, fields = _fields(kind)
    good: dict[str, Any] = {}
    mistakes = [
        (name, "is missing") for name, field in fields.items() if field.required and name not in values
    ]
    for name, value in values.items():
        if name not in fields:
            there = ", ".join(fields) or "none"
            mistakes.append((name, f"is not known{did_you_mean(name, fields)} (there are: {there})"))
            continue
        try:
            good[name] = msgspec.convert(value, types[name], strict=strict)
        except msgspec.ValidationError:
            mistakes.append((name, f"must be {wanted(fields[name].type)}"))
        else:
            wrong = next((w for check in _checks(fields[name].type) if (w := check(good[name]))), None)
            mistakes += [(name, wrong)] if wrong else []
    if mistakes:
        raise Mistakes(mistakes)
    return model(**good)


@cache
def _fields(model: type) -> tuple[dict[str, Any], dict[str, inspect.Field]]:
    """Return a model's types, to convert to, and its fields, to describe, by name."""
    info = inspect.type_info(model)
    assert isinstance(info, inspect.DataclassType)
    return get_type_hints(model, include_extras=True), {field.name: field for field in info.fields}


def _checks(kind: inspect.Type) -> list[Check]:
    extra = kind.extra if isinstance(kind, inspect.Metadata) else None
    return [extra["check"]] if extra and "check" in extra else []


def wanted(kind: inspect.Type) -> str:
    """Say what a value must be, as the end of a sentence."""
    match kind:
        case inspect.Metadata():
            return wanted(kind.type)
        case inspect.BoolType():
            return "true or false"
        case inspect.IntType() | inspect.FloatType():
            name = "a whole number" if isinstance(kind, inspect.IntType) else "a number"
            return name if kind.ge is None else f"{name} between {kind.ge:.16g} and {kind.le:.16g}"
        case inspect.StrType():
            return "a text that is not empty" if kind.min_length else "a text"
        case inspect.LiteralType():
            return f"one of {', '.join(map(str, kind.values))}"
        case inspect.VarTupleType():
            most = "" if kind.max_length is None else f" of at most {kind.max_length}"
            return f"a list{most}, each {wanted(kind.item_type)}"
        case inspect.DictType():
            return f"names with values, at most {kind.max_length}, each {wanted(kind.value_type)}"
        case inspect.UnionType():
            return wanted(next(one for one in kind.types if not isinstance(one, inspect.NoneType)))
    raise TypeError(f"no words for {kind}")
