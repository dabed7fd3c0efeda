"""Keep linear algebra on one thread.

The matrices of a calibration or a diagnosis have a handful of columns: threads make them wait for each other
(ten times slower where the processor is shared), and a fleet of them already fills every core.
"""

from __future__ import annotations

import ctypes
from collections.abc import Iterator
from contextlib import contextmanager
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np


@cache
def _libraries() -> tuple[tuple[Any, Any], ...]:
    """Find the (set, get) thread functions of the OpenBLAS that numpy's wheel carries; none elsewhere."""
    found = []
    for path in (Path(np.__file__).parent.parent / "numpy.libs").glob("*openblas*"):
        try:
            library = ctypes.CDLL(str(path))
        except OSError:
            continue
        for suffix in ("64_", ""):
            setter = getattr(library, f"scipy_openblas_set_num_threads{suffix}", None)
            getter = getattr(library, f"scipy_openblas_get_num_threads{suffix}", None)
            if setter is not None and getter is not None:
                found.append((setter, getter))
                break
    return tuple(found)


@contextmanager
def single_thread() -> Iterator[None]:
    """Run a block, or a function, with one thread per matrix product, then restore what was set before."""
    before = [(setter, getter()) for setter, getter in _libraries()]
    for setter, _ in before:
        setter(1)
    try:
        yield
    finally:
        for setter, count in before:
            setter(count)
