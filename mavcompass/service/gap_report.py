"""The document and the page of a gap diagnosis, for the service's history."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from mavcompass.gap.result import Diagnosis
from mavcompass.report.gap import write_gap_report


def gap_document(diagnosis: Diagnosis, report: Path) -> dict[str, Any]:
    """Return the gap JSON of a diagnosis, and write its HTML report to `report`."""
    report.parent.mkdir(parents=True, exist_ok=True)
    write_gap_report(diagnosis, report)
    return diagnosis.to_json()
