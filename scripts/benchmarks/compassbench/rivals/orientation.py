"""What people compute a heading with once the compass is calibrated: each with its released defaults."""

from __future__ import annotations

import numpy as np

from compassbench.cases import STEP_S, Case, columns
from compassbench.rivals import F, Headings

# These filters want x forward, y left, z up; the angle anticlockwise from their world's x to north.
LEFT_UP = np.array([1.0, -1.0, -1.0])
NORTH = {"vqf": 0.5 * np.pi, "Mahony": 0.5 * np.pi, "Madgwick": 0.0}


def solve(case: Case, argument: str = "") -> Headings:
    """Give the heading at each reading."""
    assert case.given is not None
    offset, matrix = case.given
    field = (case.mag + offset) @ matrix.T
    if argument == "accelerometer":
        return Headings(levelled(field, -columns(case.mag_time, case.time, case.acc)))
    sensed = [case.gyro, case.acc, columns(case.time, case.mag_time, field * 0.1)]  # microtesla
    gyro, acc, mag = (np.ascontiguousarray(one * LEFT_UP) for one in sensed)
    if argument == "vqf":
        import vqf

        w, x, y, z = vqf.VQF(STEP_S).updateBatch(gyro, acc, mag)["quat9D"].T
    else:
        import ahrs

        kind = getattr(ahrs.filters, argument)
        first = NORTH[argument] - levelled(field[:1], -case.acc[:1])[0]
        start = np.array([np.cos(0.5 * first), 0.0, 0.0, np.sin(0.5 * first)])
        w, x, y, z = kind(gyr=gyro, acc=acc, mag=mag, frequency=1.0 / STEP_S, q0=start).Q.T
    turned = np.arctan2(2.0 * (x * y + w * z), 1.0 - 2.0 * (y * y + z * z))
    return Headings(np.interp(case.mag_time, case.time, np.unwrap(NORTH[argument] - turned)))


def levelled(field: F, down: F) -> F:
    """Return the heading of fields (M, 3) by what points down (M, 3)."""
    east = np.cross(down, field)
    north = np.cross(east, down) / np.linalg.norm(down, axis=1)[:, np.newaxis]
    return np.arctan2(east[:, 0], north[:, 0])
