"""Which way is the compass mounted? A search over the autopilots' rotations, mirrored axes included.

For each candidate rotation the raw field is turned into body axes and fitted against the Earth's field in
the body, b + g R raw, with one common gain g and an offset: the right one leaves the smallest residual. A
sensor whose driver has an axis the wrong way round shows as a rotation with a sign flip (determinant -1).
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from mavcompass.errors import PoorCalibration
from mavcompass.frames import SENSOR_ORIENTATIONS_DEG, FloatArray, sensor_orientation_matrix

# The best must beat the next by this ratio of residuals (rms) to be believed.
BELIEVED_RATIO = 1.5
_ALIKE = 1e-6
_FLIPS = {
    "": np.eye(3),
    "x mirrored": np.diag([-1.0, 1.0, 1.0]),
    "y mirrored": np.diag([1.0, -1.0, 1.0]),
    "z mirrored": np.diag([1.0, 1.0, -1.0]),
}


@dataclass(frozen=True, slots=True)
class Candidate:
    """Hold one mounting: the rotation's number, a mirrored axis or "", and how well it fits.

    `same` lists other numbers that are the same rotation.
    """

    orientation: int
    mirrored: str
    residual_rms_mgauss: float
    gain: float
    same: tuple[int, ...] = ()


@dataclass(frozen=True, slots=True)
class OrientationSearch:
    """Hold the search's outcome, candidates best first.

    Attributes:
        candidates: best first; mirrored ones after equal rotations.
        ratio: residual of the second best by that of the best.
        believed: True where the ratio is large enough and the best needs no mirror.
        words: the finding in a sentence.
    """

    candidates: tuple[Candidate, ...]
    ratio: float
    believed: bool
    words: str

    @property
    def best(self) -> Candidate:
        """Return the best candidate."""
        return self.candidates[0]


def search_orientation(
    raw_mgauss: ArrayLike, expected_mgauss: ArrayLike, in_force: int = 0
) -> OrientationSearch:
    """Find the sensor-to-body rotation that makes raw readings (N, 3) the Earth's field in the body (N, 3).

    Args:
        raw_mgauss: in the sensor's axes (or in body axes by the rotation in force: then `in_force` 0
            and the answer is relative to it).
        expected_mgauss: by an attitude that does not come from this compass.
        in_force: the autopilot's present orientation number, named in the finding.

    Raises PoorCalibration where the expected field hardly changes: any rotation would do.
    """
    raw, expected = (np.asarray(v, dtype=np.float64) for v in (raw_mgauss, expected_mgauss))
    centred = expected - expected.mean(axis=0)
    power = float((centred**2).sum())
    spread = np.linalg.svd(centred, compute_uv=False) / math.sqrt(len(expected))
    if spread[1] < 20.0:
        raise PoorCalibration(
            "The vehicle turned too little to tell how the compass is mounted.",
            "Turn it all the way round, and tilt it by 20 degrees or more if it can be tilted.",
        )
    away = raw - raw.mean(axis=0)
    correlation = centred.T @ away  # sum of expected_i raw_j
    size = float((away**2).sum())
    count = centred.size
    candidates = []
    for (number, name), matrix in _mountings().items():
        # min over g of |centred - g R away|^2 = power - (tr R^T C)^2 / |away|^2, for g > 0.
        agreement = float((correlation * matrix).sum())
        gain = agreement / size
        left = power - (agreement**2 / size if gain > 0.0 else 0.0)
        rms = math.sqrt(max(left, 0.0) / count)
        candidates.append(Candidate(number, name, rms, gain, _same_as(number)))
    candidates.sort(key=lambda c: (round(c.residual_rms_mgauss, 6), c.mirrored != "", c.orientation))
    candidates = _distinct(candidates, flat=spread[2] < 20.0)
    ratio = candidates[1].residual_rms_mgauss / max(candidates[0].residual_rms_mgauss, 1e-9)
    return _finding(tuple(candidates), ratio, in_force)


def _mountings() -> dict[tuple[int, str], FloatArray]:
    """Return each different mounting once, under its lowest number and first flip: (number, flip)."""
    different: dict[tuple[int, str], FloatArray] = {}
    for name, flip in _FLIPS.items():
        for number in sorted(SENSOR_ORIENTATIONS_DEG):
            matrix = sensor_orientation_matrix(number) @ flip
            if not any(np.abs(matrix - known).max() < _ALIKE for known in different.values()):
                different[number, name] = matrix
    return different


def _same_as(number: int) -> tuple[int, ...]:
    matrix = sensor_orientation_matrix(number)
    return tuple(
        other
        for other in sorted(SENSOR_ORIENTATIONS_DEG)
        if other != number and np.abs(sensor_orientation_matrix(other) - matrix).max() < _ALIKE
    )


def _distinct(candidates: list[Candidate], flat: bool) -> list[Candidate]:
    """Drop mirrored mountings that a turn in a plane cannot tell from the unmirrored one."""
    if not flat:
        return candidates
    kept: list[Candidate] = []
    for candidate in candidates:
        twin = any(abs(candidate.residual_rms_mgauss - k.residual_rms_mgauss) < 1e-6 for k in kept)
        if not (candidate.mirrored and twin):
            kept.append(candidate)
    return kept


def _finding(candidates: tuple[Candidate, ...], ratio: float, in_force: int) -> OrientationSearch:
    best = candidates[0]
    roll, pitch, yaw = SENSOR_ORIENTATIONS_DEG[best.orientation]
    name = f"orientation {best.orientation} (roll {roll:g}, pitch {pitch:g}, yaw {yaw:g} degrees)"
    evidence = f"residual {best.residual_rms_mgauss:.1f} mG, the next best {ratio:.1f} times as much"
    if best.mirrored and ratio > BELIEVED_RATIO:
        words = f"The sensor's {best.mirrored[0]} axis is mirrored: no rotation fits ({evidence})."
        return OrientationSearch(candidates, ratio, False, words)
    if ratio <= BELIEVED_RATIO:
        return OrientationSearch(candidates, ratio, False, f"No mounting stands out: {name}, {evidence}.")
    verdict = "as set" if best.orientation == in_force else f"not the one set ({in_force})"
    return OrientationSearch(
        candidates, ratio, True, f"The compass is mounted in {name}, {verdict}; {evidence}."
    )
