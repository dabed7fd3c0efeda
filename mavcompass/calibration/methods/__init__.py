"""The methods of calibration, one file each, found by their names: "min-max" is `min_max.py`.

Each offers `calibrate(recorded)`, from one compass of a recording to a judged result. What several of them
share stands in files that begin with an underscore.
"""

from __future__ import annotations

import sys
from collections.abc import Callable
from importlib import import_module
from typing import TYPE_CHECKING

from mavcompass.errors import UsageError
from mavcompass.installation.doors import module_names

if TYPE_CHECKING:
    from mavcompass.calibration.recorded import Recorded
    from mavcompass.calibration.result import CalibrationResult


def method_names() -> tuple[str, ...]:
    """List the methods, without importing them."""
    return tuple(name.replace("_", "-") for name in module_names(sys.modules[__name__]))


def find_method(name: str) -> Callable[[Recorded], CalibrationResult]:
    """Return a method's `calibrate`. Raises UsageError for a name that there is not."""
    if name not in method_names():
        raise UsageError(f"There is no method {name!r}.", f"Choose one of: {', '.join(method_names())}.")
    found: Callable[[Recorded], CalibrationResult] = import_module(
        f"{__name__}.{name.replace('-', '_')}"
    ).calibrate
    return found
