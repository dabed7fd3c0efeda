"""The pre-flight check: what is set, what the compasses show at rest, and one turn of 90 degrees."""

from __future__ import annotations

from mavcompass.procedure.check.preflight import CheckSettings, check
from mavcompass.procedure.check.report import CheckReport

__all__ = [
    "CheckReport",
    "CheckSettings",
    "check",
]
