"""Judge an answer by the truth. What counts as right was fixed before any answer was looked at."""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from compassbench.cases import EFFECTS, Case
from compassbench.motions import F, matrices
from compassbench.rivals import Headings, Named, Solution

# A compass better than this is of the best class that makers of compass modules state (PNI's heading status).
RIGHT_DEG = 2.0
# What an estimator may need to come to rest.
SETTLED_S = 5.0
CIRCLE = np.arange(72) * (2.0 * math.pi / 72)


def judged(case: Case, answer: Solution | Headings | Named) -> dict[str, Any]:
    """Return the figures of one answer."""
    if isinstance(answer, Solution):
        return errors(level_errors(case, answer), answer.sigma_deg)
    if isinstance(answer, Headings):
        return heading(case, answer)
    return named(case, answer)


def level_errors(case: Case, found: Solution) -> F:
    """Return the errors of the level magnetic heading on the circle, at each load, degrees (loads, 72)."""
    truth = case.truth
    if truth.gain is None:
        return recorded_errors(case, found)
    level, down = math.hypot(truth.field[0], truth.field[1]), truth.field[2]
    body = np.stack([level * np.cos(CIRCLE), -level * np.sin(CIRCLE), np.full(CIRCLE.size, down)], axis=1)
    all_loads = []
    for load in truth.loads:
        raw = body @ truth.gain.T + truth.offset + load * truth.motor
        field = (raw + found.offset) @ np.asarray(found.matrix).T + load * found.motor
        all_loads.append(_wrapped(np.arctan2(-field[:, 1], field[:, 0]) - CIRCLE))
    return np.array(all_loads)


def recorded_errors(case: Case, found: Solution) -> F:
    """Return the mean errors of a recording's nearly level and slow headings, by sectors of 30 degrees.

    The means, for what a single reading is off by is not the calibration's: noise, lateness, a hall's steel.
    """
    truth = case.truth
    tilt = matrices(np.column_stack([truth.euler[:, :2], np.zeros(len(truth.euler))]))
    field = np.einsum("nij,nj->ni", tilt, (case.mag + found.offset) @ np.asarray(found.matrix).T)
    magnetic = truth.euler[:, 2] - math.atan2(truth.field[1], truth.field[0])
    off = np.exp(1j * (np.arctan2(-field[:, 1], field[:, 0]) - magnetic))
    slow = np.linalg.norm(case.gyro_at_readings(), axis=1) < math.radians(10.0)
    used = slow & (tilt[:, 2, 2] > math.cos(math.radians(30.0))) & (case.mag_time >= truth.from_s)
    sector = np.floor(np.degrees(magnetic) / 30.0).astype(int) % 12
    rows = [off[used & (sector == k)] for k in range(12)]
    return np.degrees([np.angle(row.sum()) for row in rows if row.size >= 5])


def heading(case: Case, found: Headings) -> dict[str, Any]:
    """Judge headings by the true magnetic heading at the moment of each reading."""
    truth = case.truth
    settled = case.mag_time > case.mag_time[0] + SETTLED_S
    magnetic = truth.euler[:, 2] - math.atan2(truth.field[1], truth.field[0])
    off = _wrapped(found.heading - magnetic)[settled]
    return errors(off, None if found.sigma is None else np.degrees(found.sigma)[settled])


def errors(off_deg: F, sigma_deg: F | float | None) -> dict[str, Any]:
    """Return the rms of errors, and the shares within one and two of the sigmas claimed for them."""
    rms = math.sqrt(float((off_deg**2).mean()))
    if not math.isfinite(rms):
        return {"crashed": "its numbers are none"}
    figures: dict[str, Any] = {"rms": rms}
    if sigma_deg is not None:
        figures["sigma"] = float(np.sqrt(np.mean(np.square(sigma_deg))))
        figures["within"] = [float((np.abs(off_deg) <= k * np.asarray(sigma_deg)).mean()) for k in (1, 2)]
    return figures


def named(case: Case, found: Named) -> dict[str, Any]:
    """Judge a diagnosis: right, honest (says that it does not know, or not surely), missed, wrong, alarm."""
    effect = case.kind.removeprefix("gap ")
    if effect == "none":
        return {"said": "alarm" if found.names or not found.sure else "right", "names": sorted(found.names)}
    near = set(EFFECTS[effect])
    if not found.sure:
        said = "honest"
    elif not found.names:
        said = "missed"
    else:
        said = "right" if found.names <= near else "wrong"
    return {"said": said, "names": sorted(found.names)}


def _wrapped(angle_rad: F) -> F:
    return np.degrees(np.angle(np.exp(1j * angle_rad)))
