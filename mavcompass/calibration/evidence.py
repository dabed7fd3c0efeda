"""What a calibration is held against: its compass's heading beside those of the others and all else."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np

from mavcompass.calibration.model import gain_parameters
from mavcompass.calibration.result import CalibrationResult
from mavcompass.calibration.rigid import DEFAULT_PRIOR
from mavcompass.earth_field import EarthField
from mavcompass.heading.evidence import (
    FLOOR_RAD,
    CompassHeading,
    Evidence,
    compare,
    compass_heading,
    other_compasses,
)
from mavcompass.track import Track


def gather(
    track: Track,
    result: CalibrationResult,
    others: Mapping[int, CalibrationResult],
    earth: EarthField | None,
    windows: Sequence[tuple[float, float]] | None = None,
) -> Evidence:
    """Compare the heading by a new calibration with all else that tells it, see `heading.evidence.compare`.

    Args:
        track: the recording. result: the compass's calibration.
        others: of the other compasses; one that has none, or one that is not accepted, counts under the
            calibration in force.
        earth, windows: as there.
    """
    headings = [_heading(track, i, others.get(i)) for i in other_compasses(track, result.instance)]
    evidence = compare(track, _calibrated(track, result), headings, earth, windows)
    given = "" if result.true_heading is None else result.true_heading.by
    return replace(evidence, sources=tuple(s for s in evidence.sources if s.name != given))


def _heading(track: Track, instance: int, result: CalibrationResult | None) -> CompassHeading:
    """Compute the heading by a calibration; by the one in force where that is not accepted."""
    if result is not None and result.accepted:
        return _calibrated(track, result)
    return compass_heading(track, instance)


def _calibrated(track: Track, result: CalibrationResult) -> CompassHeading:
    heading = compass_heading(track, result.instance, result.correction)
    sigma = math.hypot(math.radians(result.repeatable_sigma_deg), FLOOR_RAD)
    return replace(heading, sigma_rad=sigma, calibrated=True, by_itself=_by_itself(result))


def _by_itself(result: CalibrationResult) -> dict[str, float]:
    """Return how far a calibration's gains are from those of compasses, in sigmas.

    What is mounted turned sees other parts of the field; fitted as it is set, its gains are no compass's.
    """
    prior = DEFAULT_PRIOR
    vertical = math.hypot(prior.gain_sigma, prior.vertical_gain_sigma)
    sigma = np.array([prior.gain_sigma, prior.gain_sigma, vertical, *3 * [prior.cross_sigma]])
    if result.heading_error is not None:
        sigma = np.hypot(sigma, np.sqrt(np.diag(result.heading_error.covariance)[3:9]))
    away = gain_parameters(result.correction.inverse) - prior.gains
    return {"gains": float(np.abs(away / sigma).max())}
