"""The report of a calibration: one self-contained HTML file, made for looking."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from mavcompass.calibration.result import CalibrationResult, summary
from mavcompass.correction import FieldCorrection
from mavcompass.earth_field import earth_field_of
from mavcompass.printable import plain
from mavcompass.procedure.report import CalibrationReport
from mavcompass.report import figures
from mavcompass.report.svg import write_page
from mavcompass.track import Track


def write_report(report: CalibrationReport, path: Path) -> None:
    """Write the report of a live calibration. Raises UsageError where the file cannot be written."""
    outcome = report.outcome
    if report.undone:
        end = "The proof failed and the old values were put back."
    elif report.written:
        end = "Written to the vehicle and read back."
    else:
        end = "Nothing written."
    facts = {
        "Vehicle": str(report.identity),
        "Firmware and board": "not told" if report.vehicle is None else str(report.vehicle),
        "Duration": f"{report.duration_s:.0f} s",
        "Outcome": end,
    }
    if outcome is not None and outcome.undo_file is not None:
        facts["To undo"] = outcome.restore_command or str(outcome.undo_file)
    if report.heading is not None:
        facts["Autopilot"] = report.heading.summary()
    proof = None if report.proof is None else report.proof.summary()
    _write(
        path,
        report.track,
        report.results,
        facts | _place(report.track),
        report.messages,
        proof,
        report.written,
    )


def write_recording_report(track: Track, results: Sequence[CalibrationResult], path: Path) -> None:
    """Write the report of a calibration from a recording. Raises UsageError as above."""
    facts = {
        "Recording": track.source or "unknown",
        "Vehicle": f"{track.autopilot} {track.vehicle}",
        "Duration": f"{track.duration_s:.0f} s",
    }
    _write(path, track, results, facts | _place(track), track.notes, None, False)


def _place(track: Track) -> dict[str, str]:
    """Say where it was, what the Earth's field is there, and which sensors these are."""
    facts = {}
    world = earth_field_of(track)
    if world is not None and track.place is not None:
        lat, lon = np.nanmedian(track.place.values[:, :2], axis=0)
        facts["Place"] = (
            f"{abs(lat):.4f}° {'N' if lat >= 0 else 'S'}, {abs(lon):.4f}° {'E' if lon >= 0 else 'W'}"
        )
        facts["Earth's field there"] = (
            f"{world.total_mgauss:.0f} mG, dip {math.degrees(world.inclination_rad):.1f}°, declination"
            f" {math.degrees(world.declination_rad):+.1f}° (World Magnetic Model)"
        )
    ids = [f"{i}: {c.device_id}" for i, c in sorted(track.compasses.items()) if c.device_id]
    return facts | ({"Device ids": ", ".join(ids)} if ids else {})


def _write(
    path: Path,
    track: Track,
    results: Sequence[CalibrationResult],
    facts: Mapping[str, str],
    notes: Sequence[str],
    proof: str | None,
    written: bool,
) -> None:
    shown = {
        "accepted": bool(results) and all(result.accepted for result in results),
        "written": written,
        "facts": facts,
        "notes": notes,
        "proof": proof,
        "compasses": [_compass(track, result) for result in results],
    }
    write_page(path, "calibration.html", shown)


def _compass(track: Track, result: CalibrationResult) -> dict[str, Any]:
    """Collect what the template shows of one compass."""
    return {
        "instance": result.instance,
        "method": result.method,
        "accepted": result.accepted,
        "summary": summary(result),
        "reasons": result.reasons,
        "warnings": result.warnings,
        "proofs": [] if result.north is None else [said for said, *_ in result.north.proofs(result.instance)],
        "not_observable": result.not_observable,
        "sigma_deg": plain(result.heading_sigma_deg),
        "change_deg": plain(result.heading_change_deg),
        "change_max_deg": plain(result.heading_change_max_deg),
        "residual_mgauss": plain(result.residual_rms_mgauss),
        "figures": {
            "circle": figures.circle_figure(track, result),
            "raw": figures.raw_figure(track, result),
            "sphere": figures.sphere_figure(track, result),
            "error": figures.heading_error_figure(result),
            "sigma": figures.sigma_figure(result),
            "residuals": figures.residual_figure(result),
            "budget": figures.budget_figure(result),
        },
        "rows": _rows(result.in_force, result.correction),
        "card": _deviation_card(result),
        "parameters": result.parameters,
    }


def _rows(old: FieldCorrection, new: FieldCorrection) -> list[tuple[str, float, float]]:
    """Set old and new values side by side."""
    names = [
        *(f"offset {axis}, mG" for axis in "XYZ"),
        *(f"diagonal {axis}" for axis in "XYZ"),
        *(f"off-diagonal {pair}" for pair in ("XY", "XZ", "YZ")),
        "scale",
    ]
    columns = [(*c.offsets_mgauss, *c.diagonals, *c.off_diagonals, c.scale) for c in (old, new)]
    return list(zip(names, *columns, strict=True))


def _deviation_card(result: CalibrationResult) -> list[tuple[int, float, float]]:
    """List heading, error of the old calibration and sigma of the new one, every 30 degrees."""
    if (old_deg := result.in_force_error_deg()) is None:
        return []
    sigma = figures.sigma_deg(result, np.arange(72) * 5.0)
    return [(5 * k, float(old_deg[k]), float(sigma[k])) for k in range(0, 72, 6)]
