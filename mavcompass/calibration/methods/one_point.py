"""One point: the true heading is given, for a vehicle that can be neither lifted nor turned.

One reading at a known heading is one more row of the rigid compass's problem: the field that the world's
magnetic model, the level and the heading give is what the gains make of it plus the offset,

    b = r - T A F(psi),   psi = true heading - declination                                       (P1)

with the terms of (M1). Only b shows. T stays what a calibration in force says, or one; what is not known of
it bends the heading everywhere but here, and that is what the result's sigma says.
"""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np

from mavcompass.calibration.methods.four_positions import calibrate_positions, witnessed
from mavcompass.calibration.motion.observed import motion_or_none
from mavcompass.calibration.observation import (
    Dwell,
    TurnRecord,
    assemble,
    dwell_between,
    find_dwells,
    turn_record,
)
from mavcompass.calibration.recorded import Recorded
from mavcompass.calibration.result import CalibrationResult, TrueHeading
from mavcompass.errors import PoorCalibration, UsageError
from mavcompass.frames import circular_mean, wrap_pi
from mavcompass.track import Track

# Antennas as they are aligned with the nose.
_ANTENNA_RAD = math.radians(1.5)
# So near each other two stretches stand at one heading, and so near a recorded one may be to the one given.
_SAME_RAD, _NEAR_RAD = math.radians(3.0), math.radians(45.0)


def calibrate(recorded: Recorded) -> CalibrationResult:
    """Calibrate the offsets where the vehicle stands at a given true heading, or at its second antenna's.

    Raises PoorCalibration where the place is unknown, or the vehicle did not stand still at that heading;
    UsageError where there is no heading.
    """
    track, instance, earth = recorded.track, recorded.instance, recorded.earth
    if earth is None:
        raise PoorCalibration(
            "The place is unknown: a heading that is given tells the field only where the world's magnetic"
            " model tells its strength, dip and declination.",
            "Wait for the receiver's position, or record it; or turn the vehicle, which needs no place.",
        )
    record = turn_record(track, instance)
    dwells = _stands(recorded, record, earth.declination_rad)
    true = recorded.true_heading or _antenna(track, dwells)
    # Rocks and steel turn the field here, and not where the vehicle goes.
    site_rad = math.atan2(recorded.prior.site_sigma_mgauss, earth.horizontal_mgauss)
    sigma_rad = math.hypot(true.sigma_rad, earth.declination_sigma_rad, site_rad)
    first = (true.heading_rad - earth.declination_rad, sigma_rad)
    data = replace(assemble(track, dwells, instance, record), first_heading=first)
    prior = recorded.prior.of(recorded.in_force)
    result = calibrate_positions(data, recorded.in_force, earth, instance, recorded.limits, prior)
    said = _about(result, first[0], recorded.limits.heading_deg)
    result = replace(result, method="one-point", true_heading=true, warnings=(said, *result.warnings))
    return witnessed(result, None if recorded.windows is not None else motion_or_none(recorded))


def _about(result: CalibrationResult, magnetic_rad: float, limit_deg: float) -> str:
    error, sigma_deg = result.heading_error, result.heading_sigma_deg
    assert error is not None
    here = math.degrees(float(error.sigma_rad(magnetic_rad)[0]))
    worst = math.degrees(float(error.sigma_rad(np.arange(72) * (2.0 * math.pi / 72)).max()))
    accept = f" To take it as it is: --max-error-deg {math.ceil(sigma_deg)}." if sigma_deg > limit_deg else ""
    return (
        f"One heading shows the offsets only: sure within {here:.1f} deg at it and {worst:.1f} deg at the"
        f" worst other one, 1 sigma. Scales and cross terms were taken, not measured.{accept}"
    )


def _antenna(track: Track, dwells: list[Dwell]) -> TrueHeading:
    """Return the heading by a second antenna at the first dwell. Raises UsageError where none tells it."""
    yaw = track.gps_yaw_rad
    said = None if yaw is None else yaw.between(dwells[0].start_s, dwells[0].end_s)
    known = np.zeros(0) if said is None else np.asarray(said.values)[np.isfinite(said.values)]
    if not known.size:
        raise UsageError(
            "One point needs the true heading, and no second antenna tells it.",
            "Give it with --true-heading DEG: a known line, a landmark's bearing, the sun's azimuth.",
        )
    return TrueHeading(circular_mean(known), _ANTENNA_RAD, by="gps-yaw")


# --- where it stood ----------------------------------------------------------------------------------


def _stands(recorded: Recorded, record: TurnRecord | None, declination_rad: float) -> list[Dwell]:
    """Return the still stretches at the given heading."""
    track, instance = recorded.track, recorded.instance
    if recorded.windows is not None:
        return [dwell_between(track, instance, start, end, record) for start, end in recorded.windows]
    dwells = find_dwells(track, instance, record, cut=False)
    if not dwells:
        raise PoorCalibration(
            "The vehicle never stood still in this recording: nothing was seen at the given heading.",
            "Let it stand for some seconds, or turn it through four positions.",
        )
    longest = max(dwells, key=lambda d: d.end_s - d.start_s)
    if all(_apart(dwell, longest) < _SAME_RAD for dwell in dwells):
        return dwells
    there = _toward(recorded, dwells, declination_rad)
    return [dwell for dwell in dwells if _apart(dwell, there) < _SAME_RAD]


def _apart(one: Dwell, other: Dwell) -> float:
    return abs(float(wrap_pi(one.turned_rad - other.turned_rad)))


def _toward(recorded: Recorded, dwells: list[Dwell], declination_rad: float) -> Dwell:
    """Return the stretch that the autopilot, or else the compass, took for the one at the given heading.

    Raises PoorCalibration where that is not clear: a bent compass tells one quarter from the next, not more.
    """
    true, track = recorded.true_heading, recorded.track
    if true is None:
        return dwells[0]
    away = []
    for dwell in dwells:
        attitude = track.attitude_rad
        yaw = None if attitude is None else attitude.between(dwell.start_s, dwell.end_s)
        if yaw is not None and len(yaw):
            heading = circular_mean(np.asarray(yaw.values)[:, 2])
        else:
            heading = dwell.heading_rad(recorded.in_force) + declination_rad
        away.append(abs(float(wrap_pi(heading - true.heading_rad))))
    nearest = dwells[int(np.argmin(away))]
    others = [off for off, dwell in zip(away, dwells, strict=True) if _apart(dwell, nearest) >= _SAME_RAD]
    if min(away) > min(_NEAR_RAD, 0.5 * min(others)):
        raise PoorCalibration(
            f"The vehicle stood at several headings, and none is clearly the one given: the nearest is"
            f" {math.degrees(min(away)):.0f} degrees from it.",
            "Cut the recording to where it stood at that heading, or take a method that needs none.",
        )
    return nearest
