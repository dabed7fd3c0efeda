"""The pre-flight check: what is set, what the compasses show at rest, and one turn of 90 degrees."""

from __future__ import annotations

from mavcompass.procedure.check.items import CheckReport
from mavcompass.procedure.check.preflight import CheckSettings, check

__all__ = [
    "CheckReport",
    "CheckSettings",
    "check",
]
