"""The machine-readable result of a calibration: schema mavcompass.calibration/1."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict

from mavcompass.calibration.result import CalibrationResult
from mavcompass.printable import plain
from mavcompass.procedure.report import CalibrationReport
from mavcompass.track import Track

SCHEMA = "mavcompass.calibration/1"


def recording_document(
    source: str, track: Track, results: Sequence[CalibrationResult], method: str
) -> dict[str, object]:
    """Put together the document of a calibration from a recording: nothing was written."""
    return _document(source, track, results, method) | {
        "written": False,
        "verified": False,
        "undo_file": None,
        "duration_s": track.duration_s,
        "messages": list(track.notes),
    }


def refused_document(
    source: str, method: str, instances: Sequence[int], reason: str, track: Track | None = None
) -> dict[str, object]:
    """Put together the document of a calibration for which there is no solution at all."""
    return {
        "schema": SCHEMA,
        "source": source,
        "autopilot": track.autopilot if track is not None else "unknown",
        "vehicle": track.vehicle if track is not None else "unknown",
        "method": method,
        "compasses": [
            {"instance": i, "method": method, "accepted": False, "reasons": [reason], "positions": []}
            for i in instances
        ],
        "written": False,
        "verified": False,
        "undo_file": None,
        "duration_s": track.duration_s if track is not None else None,
        "messages": list(track.notes) if track is not None else [],
    }


def live_document(source: str, report: CalibrationReport, method: str) -> dict[str, object]:
    """Put together the document of a live calibration."""
    outcome, proof = report.outcome, report.proof
    document = _document(source, report.track, report.results, method)
    document |= {
        "written": report.written,
        "verified": report.written and outcome is not None and outcome.verified,
        "undo_file": None
        if outcome is None or outcome.undo_file is None or report.undone
        else str(outcome.undo_file),
        "duration_s": report.duration_s,
        "on_vehicle_s": report.on_vehicle_s,
        "messages": list(report.messages),
    }
    if (heading := report.heading) is not None:
        document["autopilot_heading"] = {
            "error_before_deg": plain(heading.error_before_deg),
            "error_after_deg": plain(heading.error_after_deg),
            "wander_deg": plain(heading.wander_deg),
            "by": heading.by,
            "seconds": plain(heading.seconds),
            "right": not heading.is_off if heading.known else None,
        }
    if proof is not None:
        document["proof"] = [asdict(compass) | {"passed": compass.passed} for compass in proof.compasses]
    return document


def _document(
    source: str, track: Track, results: Sequence[CalibrationResult], method: str
) -> dict[str, object]:
    return {
        "schema": SCHEMA,
        "source": source,
        "autopilot": track.autopilot,
        "vehicle": track.vehicle,
        "method": method,
        "compasses": [result.to_json() for result in results],
    }
