"""Which way is a compass mounted? The rotation between what it reads and the Earth's field in the body.

With raw readings r and the expected field e, both less their means, the rotation R and gain g that leave
the least of |e - g R r|^2 follow from the singular values C = sum e r^T = U S V^T (Kabsch 1976; Umeyama):

    R = U diag(1, 1, d) V^T,  d = det(U V^T),  g = (s1 + s2 + d s3) / |r|^2                          (O1)

A sensor whose driver has an axis the wrong way round fits better with -d: no rotation mends that.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from mavcompass.errors import PoorCalibration
from mavcompass.frames import FloatArray

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
        return math.acos(min(max(0.5 * (float(np.trace(self.matrix)) - 1.0), -1.0), 1.0))


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
