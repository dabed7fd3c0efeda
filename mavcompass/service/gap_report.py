"""The document and the page of a gap diagnosis, for the service's history."""

from __future__ import annotations

from importlib import import_module
from importlib.util import find_spec
from pathlib import Path
from typing import Any

_REPORTS = "mavcompass.report.gap"


def gap_document(diagnosis: Any, report: Path) -> tuple[dict[str, Any], bool]:
    """Return the gap JSON of a diagnosis, and whether its HTML report was written to `report`."""
    document: dict[str, Any] = diagnosis.to_json()
    if find_spec(_REPORTS) is None:
        return document, False
    report.parent.mkdir(parents=True, exist_ok=True)
    import_module(_REPORTS).write_gap_report(diagnosis, report)
    return document, True
