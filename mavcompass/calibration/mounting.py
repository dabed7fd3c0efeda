"""Which way is a compass mounted? The rotation between what it reads and the Earth's field in the body.

With raw readings r and the expected field e, both less their means, the rotation R (and a gain g) that leave
the least of |e - g R r|^2 follow from C = sum e r^T = U S V^T (Kabsch 1976; Umeyama):

    R = U diag(1, 1, d) V^T,  d = det(U V^T)                                                         (O1)
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import ArrayLike

from mavcompass.calibration.first_state import swing_mgauss
from mavcompass.calibration.model import HORIZONTAL, OFFSET, VERTICAL
from mavcompass.calibration.motion.fit import MotionFit, begin
from mavcompass.calibration.motion.observed import observe_motion
from mavcompass.calibration.motion.sections import Sections
from mavcompass.calibration.recorded import Recorded
from mavcompass.calibration.result import CalibrationResult, Mounting
from mavcompass.calibration.rigid import DEFAULT_PRIOR
from mavcompass.compass_parameters import mounting_values, sensor_to_body, values
from mavcompass.correction import IDENTITY
from mavcompass.errors import PoorCalibration, Refused
from mavcompass.frames import NO_HEADING_RAD, NUMBERED, FloatArray, angle_between, nearest
from mavcompass.heading.compute import level_field
from mavcompass.printable import named
from mavcompass.track import Series, Track

# A heading that is off by less is no matter of the mounting: boards are set by eye, irons bend as much.
TURNED_RAD = math.radians(20.0)
# Soft iron bends a measured rotation by its cross terms: within two sigmas of a numbered one it is that one.
_NUMBERED_RAD = 2.0 * DEFAULT_PRIOR.cross_sigma
# A field that moves less than this in a second direction leaves the rotation open.
_LEAST_SPREAD_MGAUSS = 20.0
# Hard iron of 5 to 300 mG is usual on vehicles: two sigmas.
_OFFSET_MGAUSS = 150.0
_SIGNED_AXES = [
    np.eye(3)[list(order)] * signs
    for order in itertools.permutations(range(3))
    for signs in itertools.product((1.0, -1.0), repeat=3)
]


def find_rotation(raw_mgauss: ArrayLike, expected_mgauss: ArrayLike) -> FloatArray:
    """Find the rotation that makes raw readings (N, 3) the Earth's field in the body (N, 3), eq. (O1).

    Hard iron does not matter, soft iron bends the answer by a few degrees. `expected_mgauss` is by a heading
    that does not come from this compass; rows that are not known are nan.
    Raises PoorCalibration where the expected field hardly changes: any rotation would do.
    """
    raw, expected = (np.asarray(v, dtype=np.float64) for v in (raw_mgauss, expected_mgauss))
    known = np.isfinite(raw).all(axis=1) & np.isfinite(expected).all(axis=1)
    raw, expected = (v[known] - v[known].sum(axis=0) / max(known.sum(), 1) for v in (raw, expected))
    spread = np.linalg.svd(expected, compute_uv=False) / math.sqrt(max(len(expected), 1))
    if len(raw) < 3 or spread[1] < _LEAST_SPREAD_MGAUSS:
        raise PoorCalibration(
            "The vehicle turned too little to tell how the compass is mounted.",
            "Turn it all the way round, and tilt it by 20 degrees or more if it can be tilted.",
        )
    left, _, right = np.linalg.svd(expected.T @ raw)
    return np.asarray(left @ np.diag([1.0, 1.0, np.sign(np.linalg.det(left @ right))]) @ right)


def numbered(track: Track, instance: int, rotation: FloatArray, within_rad: float) -> FloatArray:
    """Return the rotation to the numbered orientation next to one, (3, 3), if it is as near as that."""
    in_force = sensor_to_body(track.autopilot, track.parameters, instance)
    number, off = nearest(rotation @ in_force, NUMBERED)
    return NUMBERED[number] @ in_force.T if off < within_rad else rotation


def likely_rotations(recorded: Recorded, reach: float) -> list[tuple[FloatArray, float]]:
    """List rotations (3, 3) by which a compass may be turned, each with the log evidence of its readings.

    Turned back rightly it reads (M1) by gains and hard iron that compasses have; otherwise the field turns
    against the gyro, dips to the sky or leans against the vehicle. Tried are the right angles, these with an
    axis the wrong way round (which no mounting mends), and the rotation that the headings of the likeliest
    ask for. Left out is what lies beyond `reach` of the best, where its fit begins or ends. Raises
    PoorCalibration for too little motion.
    """
    track, instance = recorded.track, recorded.instance
    motion = observe_motion(replace(recorded, track=turned_compass(track, instance, np.eye(3))))
    if (nothing_known := motion.sections.sparse(NO_HEADING_RAD)) is not None:
        raise nothing_known
    raw, in_force = motion.sections.mean_mgauss, sensor_to_body(track.autopilot, track.parameters, instance)
    # A fit errs by less than a tenth of it, so that what lies far apart where fits begin will lie farther.
    swing = swing_mgauss(raw)

    def turned(rotation: FloatArray) -> Sections:
        return replace(motion.sections, mean_mgauss=raw @ rotation.T)

    def cost(rotation: FloatArray) -> float:
        first = begin(recorded, turned(rotation), motion.load_source)
        return first.cost(swing) + 0.5 * float((first.state[OFFSET] ** 2).sum()) / _OFFSET_MGAUSS**2

    def tried(rotation: FloatArray) -> tuple[FloatArray, float, MotionFit]:
        fit = motion.on(turned(rotation)).fit
        variance = fit.covariance[OFFSET, OFFSET] + _OFFSET_MGAUSS**2 * np.eye(3)
        by_offset = fit.offset_mgauss @ np.linalg.solve(variance, fit.offset_mgauss)
        return rotation, fit.log_evidence - 0.5 * float(by_offset + np.linalg.slogdet(variance)[1]), fit

    right_angles = [axes @ in_force.T for axes in _SIGNED_AXES]
    costs = np.array([cost(rotation) for rotation in right_angles])
    found = [tried(right_angles[i]) for i in np.flatnonzero(costs < costs.min() + reach)]
    rotation, _, fit = max(found, key=lambda one: one[1])
    for _ in range(5):  # each takes most of what is left of a free angle, some 50 degrees at first
        level = level_field(fit.headings_rad, fit.state[HORIZONTAL], fit.state[VERTICAL])
        expected = np.einsum("kij,kj->ki", motion.sections.mapping, level)
        rotation = numbered(track, instance, find_rotation(raw, expected), _NUMBERED_RAD)
        if min(angle_between(rotation, other) for other, _, _ in found) < _NUMBERED_RAD:
            break
        found.append(tried(rotation))
        fit = found[-1][2]
    best = max(log for _, log, _ in found)
    return [(rotation, log) for rotation, log, _ in found if log > best - reach]


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
