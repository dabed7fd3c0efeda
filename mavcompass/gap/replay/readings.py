"""Every reading of a compass beside its nominal simulation, before any averaging."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from mavcompass.frames import FloatArray

_QUIET_SHARE = 0.4


@dataclass(frozen=True, slots=True, eq=False)
class Readings:
    """Hold what single readings tell.

    Attributes:
        time_s: (M,), repeats of a slow compass left out.
        error_mgauss: raw less nominal, (M, 3). nominal_mgauss: (M, 3).
        valid: readings with a reference, (M,).
        quiet: of these, with both neighbours, the ones while the field hardly turns: what is late, averaged
            or repeated by nature scatters while the vehicle turns.
    """

    time_s: FloatArray
    error_mgauss: FloatArray
    nominal_mgauss: FloatArray
    valid: NDArray[np.bool_]
    quiet: NDArray[np.bool_]

    @classmethod
    def of(
        cls, time_s: FloatArray, raw: FloatArray, nominal: FloatArray, valid: NDArray[np.bool_]
    ) -> Readings:
        """Compare readings (M, 3) with their nominal simulation."""
        turning = np.linalg.norm(np.gradient(nominal, time_s, axis=0), axis=1)
        slow = turning <= np.quantile(turning[valid], _QUIET_SHARE) if valid.any() else valid
        quiet = valid & slow
        quiet[1:-1] &= (valid & slow)[:-2] & (valid & slow)[2:]
        quiet[[0, -1]] = False
        return cls(time_s, raw - nominal, nominal, valid, quiet)

    @property
    def period_s(self) -> float:
        """Return the usual time between readings, seconds."""
        return float(np.median(np.diff(self.time_s)))

    def without(self, change_mgauss: FloatArray) -> Readings:
        """Take an effect's part (M, 3) out of the readings."""
        return replace(self, error_mgauss=self.error_mgauss - change_mgauss)
