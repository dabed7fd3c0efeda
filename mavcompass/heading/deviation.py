"""The deviation card of a compass: by how much it is off on each heading, and why.

deviation(psi) = A + B sin psi + C cos psi + D sin 2 psi + E cos 2 psi

is the navigator's form: A from a compass turned about the vertical, B and C from permanent magnetism along
and across the vehicle, D and E from soft iron. The deviation is what must be added to the compass's
heading to get the magnetic one: magnetic = compass + deviation, east positive.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from mavcompass.correction import FieldCorrection, MotorSource
from mavcompass.frames import FloatArray, level_to_body, wrap_pi
from mavcompass.heading.compute import level_field, level_heading, tilt_compensated_heading

LETTERS = "ABCDE"
# The motors' loads at a moment, by what a correction's motor term goes with.
Loads = Mapping[tuple[MotorSource, float], ArrayLike]
NO_LOADS: Loads = {}


@dataclass(frozen=True, slots=True, eq=False)
class DeviationCard:
    """Hold a deviation card, angles in degrees as on paper.

    Attributes:
        compass_deg: headings that the compass shows, (N,), evenly spaced from 0.
        deviation_deg: to be added to them, (N,).
        coefficients_deg: A, B, C, D, E. residual_deg: rms of what five coefficients leave.
        sigma_deg: standard deviation of each deviation, (N,), nan where not known.
    """

    compass_deg: FloatArray
    deviation_deg: FloatArray
    coefficients_deg: dict[str, float]
    residual_deg: float
    sigma_deg: FloatArray


def _terms(heading_rad: ArrayLike) -> FloatArray:
    psi = np.asarray(heading_rad, dtype=np.float64)
    return np.stack([np.ones_like(psi), *(f(k * psi) for k in (1.0, 2.0) for f in (np.sin, np.cos))], axis=-1)


def fit_deviation(compass_rad: ArrayLike, magnetic_rad: ArrayLike, headings: int = 8) -> DeviationCard:
    """Fit the five coefficients to compass headings and what they should have been, (N,) each.

    The card is drawn for `headings` (8 or 16) evenly spaced compass headings.
    Raises ValueError for fewer than five different headings.
    """
    compass, magnetic = np.asarray(compass_rad, dtype=np.float64), np.asarray(magnetic_rad, dtype=np.float64)
    deviation = np.degrees(wrap_pi(magnetic - compass))
    design = _terms(compass)
    if np.linalg.matrix_rank(design, tol=1e-6) < 5:
        raise ValueError("five coefficients need at least five different headings")
    answer, *_ = np.linalg.lstsq(design, deviation, rcond=None)
    residual = deviation - design @ answer
    card = np.arange(headings, dtype=np.float64) * (2.0 * math.pi / headings)
    return DeviationCard(
        compass_deg=np.degrees(card),
        deviation_deg=_terms(card) @ answer,
        coefficients_deg=dict(zip(LETTERS, (float(a) for a in answer), strict=True)),
        residual_deg=math.sqrt(float((residual**2).mean())),
        sigma_deg=np.full(headings, math.nan),
    )


def deviation_card(
    used: FieldCorrection,
    true: FieldCorrection,
    horizontal_mgauss: float,
    vertical_mgauss: float,
    headings: int = 8,
    sigma_rad: ArrayLike | None = None,
) -> DeviationCard:
    """Draw the card of a compass that uses one correction where another one is right.

    With `used` in force before a calibration and `true` its result, it is the card of the uncalibrated
    compass from the same turn. The deviations are computed exactly at the card's headings; the
    coefficients summarise them. `sigma_rad` (72,) is the calibration's sigma at 72 even headings.
    """
    seen, psi = seen_by_old(used, true, horizontal_mgauss, vertical_mgauss)
    shown = np.asarray(level_heading(seen))
    fitted = fit_deviation(shown, psi, headings)
    card = np.radians(fitted.compass_deg)
    order = np.argsort(shown)
    exact = np.interp(card, shown[order], np.degrees(wrap_pi(psi - shown))[order], period=2.0 * math.pi)
    sigma = fitted.sigma_deg
    if sigma_rad is not None:
        sigma = np.degrees(np.interp(card, shown[order], np.asarray(sigma_rad)[order], period=2.0 * math.pi))
    return DeviationCard(fitted.compass_deg, exact, fitted.coefficients_deg, fitted.residual_deg, sigma)


def heading_change_rad(
    old: FieldCorrection,
    new: FieldCorrection,
    horizontal_mgauss: float,
    vertical_mgauss: float,
    roll_rad: float = 0.0,
    pitch_rad: float = 0.0,
    turned: FloatArray | None = None,
    loads: Loads = NO_LOADS,
) -> FloatArray:
    """Return by how much the heading changes from `old` to `new` at 72 true headings, tilt and loads, (72,).

    The field is taken to be what `new` makes of the raw readings, so for a good `new` this is the
    error of `old`. Both are for readings in the same axes; `turned` (3, 3) is the rotation into these from
    the axes in which the old heading was taken.
    """
    seen, psi = seen_by_old(old, new, horizontal_mgauss, vertical_mgauss, roll_rad, pitch_rad, loads)
    seen = seen @ (np.eye(3) if turned is None else turned)
    return np.asarray(wrap_pi(tilt_compensated_heading(seen, roll_rad=roll_rad, pitch_rad=pitch_rad) - psi))


def seen_by_old(
    old: FieldCorrection,
    new: FieldCorrection,
    horizontal_mgauss: float,
    vertical_mgauss: float,
    roll_rad: float = 0.0,
    pitch_rad: float = 0.0,
    loads: Loads = NO_LOADS,
) -> tuple[FloatArray, FloatArray]:
    """Return what `old` makes, (72, 3), of raw readings of which `new` makes the Earth's field, and the true
    headings."""
    psi = np.asarray(np.arange(72) * (2.0 * math.pi / 72))
    field_mgauss = level_field(psi, horizontal_mgauss, vertical_mgauss) @ level_to_body(roll_rad, pitch_rad).T
    raw = new.undo(field_mgauss, loads.get(new.goes_with))
    return old.apply(raw, loads.get(old.goes_with)), psi
