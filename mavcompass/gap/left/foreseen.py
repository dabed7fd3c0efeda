"""What a floor holds besides the noise: what the rest of a recording leaves unknown of its held-out parts."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np

from mavcompass.frames import FloatArray
from mavcompass.gap.fit import Fit, Mask, Problem
from mavcompass.gap.left.floor import Floor, heading_error_rad
from mavcompass.gap.replay import Replay


def foreseen(floor: Floor, replay: Replay, train: Mask, test: Mask) -> Floor:
    """Raise a floor by what the training rows leave unknown of the held-out ones when nothing is wrong.

    The nuisances' covariance, carried to the held-out field and heading: attitude, place and calibration are
    known there only as well as the rest of the recording tells them.
    """
    problem = Problem(replay, floor.noise, train, floor.prior)
    null = problem.null()
    if not null.covariance.size or not test.any():
        return floor
    field_more, heading_more = _unknown(problem, null, test)
    field_rest, heading_rest = _of_turns(
        replay.signals.stimulus.field_ned_mgauss[0], replay.reference.rest_rad2
    )
    return _raised(floor, field_more + field_rest, heading_more + heading_rest)


def _unknown(problem: Problem, fit: Fit, test: Mask) -> tuple[float, float]:
    """Return the mean squares of field (mG) and heading (deg) that the nuisances leave unknown."""
    rows, predicted = np.flatnonzero(test), problem.predict(fit).mag_mgauss
    changes = problem.nuisance_changes(fit)["mag"]
    changed = (predicted[:, :, None] + changes).transpose(2, 0, 1)
    heading = [heading_error_rad(problem.replay, one, predicted)[rows] for one in changed]
    field = changes[rows].reshape(3 * rows.size, -1)
    turned = np.degrees(np.stack(heading, axis=1))
    count = sum(n.mean.size for n in problem.nuisances)
    covariance = fit.covariance[:count, :count]
    field_more, heading_more = (
        float(np.mean(np.einsum("np,pq,nq->n", J, covariance, J))) for J in (field, turned)
    )
    return field_more, heading_more


def _raised(floor: Floor, field_more: float, heading_more: float) -> Floor:
    return replace(
        floor,
        field_rms_mgauss=math.sqrt(floor.field_rms_mgauss**2 + field_more),
        heading_rms_deg=math.sqrt(floor.heading_rms_deg**2 + heading_more),
    )


def _of_turns(field_mgauss: FloatArray, covariance_rad2: FloatArray) -> tuple[float, float]:
    """Return the mean squares of field (mG) and heading (deg) that small turns of the attitude make."""
    north, east, down = field_mgauss
    # A turn v moves the field by v x B, of which heading sees what is level and across.
    moved = np.array([[0.0, down, -east], [-down, 0.0, north], [east, -north, 0.0]])
    across = (north * moved[1] - east * moved[0]) / max(north**2 + east**2, 1.0)
    of_heading = float(across @ covariance_rad2 @ across)
    return float(np.trace(moved @ covariance_rad2 @ moved.T)) / 3.0, math.degrees(math.sqrt(of_heading)) ** 2
