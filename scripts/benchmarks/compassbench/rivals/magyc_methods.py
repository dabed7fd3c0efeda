"""The methods of the package magyc, as released; run in an environment of its own."""

from __future__ import annotations

import magyc
import numpy as np

from compassbench.cases import Case
from compassbench.rivals import Refusal, Solution


def solve(case: Case, argument: str = "") -> Solution:
    """Calibrate by one of its methods, in gauss as its examples do."""
    gauss = case.mag * 1e-3
    method = getattr(magyc, argument)
    if argument in ("ellipsoid_fit_fang", "sphere_fit"):
        found = method(gauss)
    elif argument == "twostep_hsi":
        found = method(gauss, case.world * 1e-3)
    else:
        # Equal times would be divided by.
        fresh = np.concatenate([[True], np.diff(case.mag_time) > 0.0])
        found = method(gauss[fresh], case.gyro_at_readings()[fresh], case.mag_time[fresh])
    if any(np.iscomplexobj(part) for part in found[:2]):
        raise ValueError("its iron is of complex numbers")
    soft = np.eye(3) if argument == "sphere_fit" else np.asarray(found[1], dtype=float)
    hard = np.ravel(found[0]) * 1e3
    if not (np.isfinite(hard).all() and np.isfinite(soft).all()):
        raise Refusal("its numbers are none")
    return Solution(-hard, np.linalg.inv(soft))
