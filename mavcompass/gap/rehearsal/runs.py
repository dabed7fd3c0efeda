"""Calibrations of many vehicles of a kind, and what their heading errors tell together."""

from __future__ import annotations

from collections.abc import Callable, Collection
from dataclasses import dataclass

import numpy as np

from mavcompass.errors import PoorCalibration
from mavcompass.frames import FloatArray
from mavcompass.gap.rehearsal.draws import Draws
from mavcompass.gap.rehearsal.judging import heading_errors_deg
from mavcompass.gap.rehearsal.kind import Kind
from mavcompass.gap.rehearsal.procedure import USUAL, Protocol, calibrate
from mavcompass.gap.rehearsal.result import Errors, Expected


@dataclass(frozen=True, slots=True, eq=False)
class Run:
    """Hold calibrations of the first N vehicles of a kind; nan where the fit had no solution.

    Attributes:
        errors_deg: rms over the circle, level and tilted, (N, 2).
        claimed_deg: what the calibration says of the level error, (N,). positions: visited, (N,).
        refusal: why the last that had none had no solution.
    """

    errors_deg: FloatArray
    claimed_deg: FloatArray
    positions: FloatArray
    refusal: PoorCalibration | None = None

    def first(self, count: int) -> Run:
        """Return the first vehicles alone."""
        return Run(self.errors_deg[:count], self.claimed_deg[:count], self.positions[:count], self.refusal)

    @property
    def errors(self) -> Errors:
        """Return what is to be expected."""
        level, tilted = (_expected(column[np.isfinite(column)]) for column in self.errors_deg.T)
        return Errors(level, tilted)

    def change_from(self, usual: Run) -> tuple[float, float]:
        """Return the ratio of rms errors, level and tilted, to those of the same vehicles done otherwise."""
        both = np.isfinite(self.errors_deg) & np.isfinite(usual.errors_deg)
        mine, theirs = (np.where(both, run.errors_deg, 0.0) for run in (self, usual))
        level, tilted = np.sqrt((mine**2).sum(axis=0) / np.maximum((theirs**2).sum(axis=0), 1e-12)).tolist()
        return level, tilted


def calibrations(
    kind: Kind,
    draws: Draws,
    count: int,
    protocol: Protocol = USUAL,
    without: Collection[str] = (),
    done: Callable[[], None] = lambda: None,
) -> Run:
    """Calibrate the first vehicles of a kind, judge what they got, and tell each that is done."""
    out = np.full((count, 4), np.nan)
    refusal = None
    for number in range(count):
        individual = draws[number]
        try:
            fit = calibrate(kind, individual, protocol, without)
        except PoorCalibration as why:
            refusal = why
        else:
            level, tilted = heading_errors_deg(kind, individual, fit.correction, without)
            visited = len(fit.magnetic_headings_rad)
            out[number] = level, tilted, np.degrees(fit.heading_sigma_rad), visited
        done()
    return Run(out[:, :2], out[:, 2], out[:, 3], refusal)


def _expected(errors_deg: FloatArray) -> Expected:
    rms_deg, median_deg = float(np.sqrt(np.mean(errors_deg**2))), float(np.median(errors_deg))
    return Expected(rms_deg, median_deg, float(np.quantile(errors_deg, 0.95, method="higher")))
