"""Find what the files of a folder add to the program, so that one new file is all that an addition takes."""

from __future__ import annotations

import pkgutil
from collections.abc import Iterator
from importlib import import_module
from types import ModuleType


def module_names(package: ModuleType) -> list[str]:
    """List the files and folders of a package, without importing them; a leading underscore hides one."""
    return [m.name for m in pkgutil.iter_modules(package.__path__) if not m.name.startswith("_")]


def modules_in(package: ModuleType) -> Iterator[ModuleType]:
    """Import them, one after another, in the order of their names."""
    for name in module_names(package):
        yield import_module(f"{package.__name__}.{name}")
