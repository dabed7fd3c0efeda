"""What is looked up only when it is asked for.

The door of a room hands out names when they are first used, so that opening it costs nothing. What the files
of a folder add to the program is found, so that one new file is all that an addition takes.
"""

from __future__ import annotations

import pkgutil
from collections.abc import Callable, Iterator, Mapping
from importlib import import_module
from types import ModuleType
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


def module_names(package: ModuleType) -> list[str]:
    """List the files and folders of a package, without importing them; a leading underscore hides one."""
    return [m.name for m in pkgutil.iter_modules(package.__path__) if not m.name.startswith("_")]


def modules_in(package: ModuleType) -> Iterator[ModuleType]:
    """Import them, one after another, in the order of their names."""
    for name in module_names(package):
        yield import_module(f"{package.__name__}.{name}")
