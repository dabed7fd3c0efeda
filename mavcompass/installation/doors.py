"""The door of a room whose names are looked up when they are first used, so that opening it costs nothing."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from importlib import import_module
from typing import Any


def door(package: str, names: Mapping[str, str]) -> tuple[Callable[[str], Any], Callable[[], list[str]]]:
    """Make a package's `__getattr__` and `__dir__`, which hand out names by the modules that hold them.

    Args:
        package: its `__name__`.
        names: each name handed out and its module within the package, such as "formats.csv.writer".
    """

    def look_up(name: str) -> Any:
        if name not in names:
            raise AttributeError(f"module {package!r} has no attribute {name!r}")
        return getattr(import_module(f"{package}.{names[name]}"), name)

    return look_up, lambda: sorted(names)
