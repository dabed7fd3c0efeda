"""The autopilot's own calibration, held against what the same readings say by the best method for them."""

from __future__ import annotations

import math
from dataclasses import replace

from mavcompass.calibration.methods import auto, ellipsoid
from mavcompass.calibration.recorded import Recorded
from mavcompass.calibration.result import BEYOND_CHANCE, CalibrationResult, Witness
from mavcompass.errors import PoorCalibration
from mavcompass.heading.deviation import heading_change_rad


def calibrate(recorded: Recorded) -> CalibrationResult:
    """Judge what the autopilot found: its heading error is its distance from our own solution, and that's.

    Raises PoorCalibration where there is none, where it failed, and where ours has no solution.
    """
    found = recorded.found
    if found is None:
        raise PoorCalibration(
            "No calibration of the autopilot's own is at hand: it is run on a live vehicle.",
            "A recording is solved by --method auto, that of a vehicle turned every way as well.",
        )
    if found.correction is None:
        raise PoorCalibration(found.why_not)
    own = auto.calibrate(replace(recorded, windows=None))
    if not own.accepted:  # hands turn faster than gyro and level can be followed; a length needs neither
        turned = ellipsoid.calibrate_witnessed(recorded, None)
        own = turned if turned.accepted else own
    correction = found.correction.with_motor_of(recorded.in_force)
    apart_rad = heading_change_rad(correction, own.correction, own.horizontal_mgauss, own.vertical_mgauss)
    apart_deg = math.degrees(math.sqrt(float((apart_rad**2).mean())))
    contradicts = apart_deg > BEYOND_CHANCE * own.heading_sigma_deg
    said = f"The same readings by {own.method}: heading {apart_deg:.2f} deg another, rms over the circle."
    result = replace(
        own,
        method="autopilot",
        correction=correction,
        evidence=(Witness("own-solution", apart_deg, own.heading_sigma_deg, contradicts),),
        warnings=(said, *own.warnings),
    )
    result = result.widened(math.hypot(apart_deg, own.heading_sigma_deg), "method")
    why = f"The autopilot's result is {apart_deg:.1f} deg from what its readings say by {own.method}."
    return result.compared().within(recorded.limits, why if contradicts else "")
