"""mavcompass through its public Python door; the settings are its defaults."""

from __future__ import annotations

import numpy as np

import mavcompass
from compassbench.cases import UTC_S, Case
from compassbench.rivals import Headings, Named, Refusal, Solution
from mavcompass.calibration.result import CalibrationResult
from mavcompass.correction import FieldCorrection
from mavcompass.track import MagSeries, Series, Track

# What vehicles report of an external compass that is set to lie along the vehicle.
EXTERNAL = {
    "px4": {f"CAL_MAG0_{name}": 0.0 for name in ("ROT", "ROLL", "PITCH", "YAW")},
    "ardupilot": {"COMPASS_EXTERNAL": 1.0, "COMPASS_ORIENT": 0.0},
}


def track_of(case: Case) -> Track:
    """Put a case's columns into a Track, as a reader of a log would."""
    whole = case.autopilot == "ardupilot"
    compass = MagSeries(1, Series.of(case.mag_time, case.mag), quantum_mgauss=float(whole), truncated=whole)
    course = None
    if case.course is not None:
        course = Series.of(case.time, np.column_stack([case.course, np.zeros(len(case.time))]))
    return Track(
        source=f"{case.kind} {case.index}",
        autopilot=case.autopilot,
        vehicle=case.vehicle,
        compasses={1: compass},
        acc_mps2=Series.of(case.time, case.acc),
        gyro_radps=Series.of(case.time, case.gyro),
        attitude_rad=Series.of(case.time, case.attitude),
        gps_velocity_mps=course,
        receiver_velocity_mps=course,
        place=Series.of(case.time[:1], [case.place]),
        current_a=None if case.current is None else Series.of(case.time, case.current),
        utc_offset_s=UTC_S,
        parameters=EXTERNAL[case.autopilot],
    )


def solve(case: Case, argument: str = "") -> Solution | Headings | Named:
    """Do what the task asks for; a refusal of the package is one here."""
    try:
        named = {"heading": heading, "gap": gap}
        return named[argument](case) if argument else solution(mavcompass.calibrate(track_of(case)))
    except mavcompass.MavCompassError as refusal:
        raise Refusal(str(refusal)) from refusal


def solution(result: CalibrationResult) -> Solution:
    """Take a result; where a turned mounting is told with the correction that mends it, take that."""
    turned = np.eye(3)
    if result.mounting.mended is not None and result.mounting.turned is not None:
        turned, result = np.asarray(result.mounting.turned), result.mounting.mended
    if not result.accepted:
        raise Refusal(" ".join(result.reasons))
    found = result.correction
    return Solution(
        turned.T @ np.asarray(found.offsets_mgauss),
        found.matrix @ turned,
        np.asarray(found.motor_mgauss),
        result.heading_sigma_deg,
    )


def heading(case: Case) -> Headings:
    """Compute the headings by the calibration that is given."""
    assert case.given is not None
    found = mavcompass.heading(track_of(case), FieldCorrection.from_matrix(*case.given))
    return Headings(found.magnetic_rad, found.magnetic_sigma_rad)


def gap(case: Case) -> Named:
    """Diagnose the flight beside its baseline."""
    assert case.baseline is not None
    found = mavcompass.diagnose_gap(track_of(case), track_of(case.baseline))
    names = frozenset(cause.effect for cause in found.causes)
    return Named(names, found.verdict in ("no_gap", "named"))
