"""Which way is a compass mounted? The rotation between what it reads and the Earth's field in the body.

With raw readings r and the expected field e, both less their means, the rotation R and gain g that leave
the least of |e - g R r|^2 follow from the singular values C = sum e r^T = U S V^T (Kabsch 1976; Umeyama):

    R = U diag(1, 1, d) V^T,  d = det(U V^T),  g = (s1 + s2 + d s3) / |r|^2                          (O1)

A sensor whose driver has an axis the wrong way round fits better with -d: no rotation mends that.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import ArrayLike

from mavcompass.calibration.evidence import heading_by
from mavcompass.calibration.result import CalibrationResult, Mounting
from mavcompass.calibration.rigid import DEFAULT_PRIOR
from mavcompass.compass_parameters import mounting_values, sensor_to_body, values
from mavcompass.compass_parameters.orientations import NUMBERED, angle_between, nearest
from mavcompass.correction import IDENTITY
from mavcompass.earth_field import EarthField
from mavcompass.errors import PoorCalibration, Refused
from mavcompass.frames import FloatArray, euler_to_matrix
from mavcompass.heading.evidence import expected_field
from mavcompass.heading.fault_isolation import RATHER_SOUND, FaultIsolation
from mavcompass.printable import named
from mavcompass.track import Series, Track

# A heading that is off by less is no matter of the mounting: boards are set by eye, irons bend as much.
TURNED_RAD = math.radians(20.0)
# Soft iron bends a measured rotation by its cross terms: within two sigmas of a numbered one it is that one.
_NUMBERED_RAD = 2.0 * DEFAULT_PRIOR.cross_sigma
# A field that moves less than this in a second direction leaves the rotation open.
_LEAST_SPREAD_MGAUSS = 20.0
# A mirrored axis is said where it leaves less by this factor; what is believed leaves less of the field.
_MIRRORED_RATIO, _BELIEVED_SHARE = 1.5, 0.35


@dataclass(frozen=True, slots=True, eq=False)
class Rotation:
    """Hold how a compass is turned against the mounting that is set.

    Attributes:
        matrix: to be applied to readings in body axes by the mounting that is set, (3, 3).
        gain: of the field. residual_rms_mgauss: what it leaves, per axis.
        mirrored: True where an axis has the wrong sign. believed: True where little of the field is left.
    """

    matrix: FloatArray
    gain: float
    residual_rms_mgauss: float
    mirrored: bool
    believed: bool

    @property
    def angle_rad(self) -> float:
        """Return the angle of the rotation."""
        return angle_between(self.matrix, np.eye(3))


def find_rotation(raw_mgauss: ArrayLike, expected_mgauss: ArrayLike) -> Rotation:
    """Find the rotation that makes raw readings (N, 3) the Earth's field in the body (N, 3), eq. (O1).

    Hard iron does not matter, soft iron bends the answer by a few degrees. `expected_mgauss` is by a heading
    that does not come from this compass; rows that are not known are nan.
    Raises PoorCalibration where the expected field hardly changes: any rotation would do.
    """
    raw, expected = (np.asarray(v, dtype=np.float64) for v in (raw_mgauss, expected_mgauss))
    known = np.isfinite(raw).all(axis=1) & np.isfinite(expected).all(axis=1)
    raw, expected = raw[known], expected[known]
    if len(raw) >= 3:
        raw, expected = raw - raw.mean(axis=0), expected - expected.mean(axis=0)
    spread = np.linalg.svd(expected, compute_uv=False) / math.sqrt(max(len(expected), 1))
    if len(raw) < 3 or spread[1] < _LEAST_SPREAD_MGAUSS:
        raise PoorCalibration(
            "The vehicle turned too little to tell how the compass is mounted.",
            "Turn it all the way round, and tilt it by 20 degrees or more if it can be tilted.",
        )
    left, values, right = np.linalg.svd(expected.T @ raw)
    flip = float(np.sign(np.linalg.det(left @ right)))
    power, size = float((expected**2).sum()), float((raw**2).sum())

    def rest(sign: float) -> float:
        agreement = float(values[0] + values[1] + sign * values[2])
        return math.sqrt(max(power - agreement**2 / size, 0.0) / expected.size)

    # A turn in a plane cannot tell a mirrored axis from none.
    mirrored = spread[2] >= _LEAST_SPREAD_MGAUSS and rest(flip) > _MIRRORED_RATIO * rest(-flip)
    return Rotation(
        matrix=left @ np.diag([1.0, 1.0, flip]) @ right,
        gain=float(values[0] + values[1] + flip * values[2]) / size,
        residual_rms_mgauss=rest(flip),
        mirrored=bool(mirrored),
        believed=not mirrored and rest(flip) < _BELIEVED_SHARE * math.sqrt(power / expected.size),
    )


def mounted_turned(
    track: Track,
    result: CalibrationResult,
    others: Mapping[int, CalibrationResult],
    earth: EarthField | None,
    found: FaultIsolation,
) -> FloatArray | None:
    """Find how far a compass is turned against what is set, by the surest of the sources that are sound."""
    believed = [i for i in found.likeliest if i > 0 and found.sound[i] > RATHER_SOUND]
    if not believed:
        return None
    source = found.sources[min(believed, key=lambda i: found.sources[i].sigma_rad)]
    declination = 0.0 if earth is None else earth.declination_rad
    heading = heading_by(track, source.name, others, declination)
    if heading is None:
        # What tells no heading at each moment tells by how much this one is off.
        rotation = euler_to_matrix(0.0, 0.0, -source.deviation_rad[0])
    else:
        strength = (
            (earth.horizontal_mgauss, earth.ned_mgauss[2])
            if earth is not None
            else (result.horizontal_mgauss, result.vertical_mgauss)
        )
        time = track.compasses[result.instance].time_s
        try:
            seen = find_rotation(
                track.raw_field(result.instance), expected_field(track, heading, time, *strength)
            )
        except PoorCalibration:
            return None
        if not seen.believed:
            return None
        rotation = seen.matrix
    in_force = sensor_to_body(track.autopilot, track.parameters, result.instance)
    number, off = nearest(rotation @ in_force, NUMBERED)
    if off < _NUMBERED_RAD:
        rotation = NUMBERED[number] @ in_force.T
    return rotation if angle_between(rotation, np.eye(3)) > TURNED_RAD else None


def turned_compass(track: Track, instance: int, rotation: FloatArray) -> Track:
    """Return the recording as if one compass had a further rotation (3, 3) after the mounting in force."""
    compass = track.compasses[instance]
    raw = np.asarray(track.raw_field(instance)) @ np.asarray(rotation).T
    reading = replace(
        compass,
        reported=Series(compass.time_s, raw),
        in_force=(replace(compass.in_force[0], correction=IDENTITY),),
        truncated=False,
        not_applied=None,
    )
    return replace(track, compasses={**track.compasses, instance: reading})


def as_set(track: Track, judged: CalibrationResult, rotation: FloatArray) -> Mounting:
    """Spell a mounting in the autopilot's parameters; where it has none, say so.

    `judged` is the compass so mounted, which the mounting mends if it is accepted.
    """
    angle_deg = math.degrees(angle_between(rotation, np.eye(3)))
    wanted = rotation @ sensor_to_body(track.autopilot, track.parameters, judged.instance)
    try:
        setting = mounting_values(track.autopilot, track.parameters, judged.instance, wanted)
        spelled = values(track.autopilot, track.parameters, judged.instance, judged.correction, rotation)
    except Refused as why:
        return Mounting(seen=True, turned=rotation, angle_deg=angle_deg, no_setting=str(why))
    setting = {name: value for name, value in setting.items() if track.parameters.get(name) != value}
    mounting = Mounting(seen=True, turned=rotation, angle_deg=angle_deg, setting=setting)
    if not judged.accepted:
        return mounting
    mended = replace(judged, mounting=mounting, parameters=spelled)
    return replace(mounting, mended=mended)


def mounting_words(result: CalibrationResult, mounting: Mounting, told_by: Sequence[str]) -> str:
    """Say how a compass is mounted, which sources of the heading tell it, and what mends it."""
    show = "shows" if len(told_by) == 1 else "show"
    found = (
        f"Compass {result.instance} is mounted turned by {mounting.angle_deg:.0f} degrees against what is"
        f" set, as {named(told_by)} {show}"
    )
    if mounting.no_setting:
        return f"{found}. {mounting.no_setting}"
    setting = ", ".join(f"{name} {value:g}" for name, value in mounting.setting.items())
    if mounting.mended is None:
        return f"{found}: {setting} is right."
    sigma_deg = mounting.mended.heading_sigma_deg
    return f"{found}: {setting} is right (then within {sigma_deg:.2f} deg; --orientation sets it)."
