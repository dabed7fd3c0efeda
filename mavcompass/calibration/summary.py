"""A calibration's result in one sentence for a person."""

from __future__ import annotations

import math

from mavcompass.calibration.result import CalibrationResult


def summary(result: CalibrationResult) -> str:
    """Say what was found and how good it is."""
    x, y, z = result.correction.offsets_mgauss
    dx, dy, _ = result.correction.diagonals
    if not result.accepted:
        return f"Compass {result.instance}: not accepted."
    text = f"Compass {result.instance}: accepted"
    if math.isfinite(result.heading_sigma_deg):
        text += f", heading within {result.heading_sigma_deg:.2f} deg (1 sigma)"
    if math.isfinite(result.heading_change_deg):
        text += f"; the old values were {result.heading_change_deg:.1f} deg off"
    return f"{text}. Offsets {x:.1f} {y:.1f} {z:.1f} mG, scale {dx:.3f} {dy:.3f}."
