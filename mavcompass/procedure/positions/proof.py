"""Prove a written calibration by one more turn: the field's own heading against the gyro.

And by solving anew with the position that this adds: a right calibration hardly changes, while one that a
position taken in bad air has bent does. One turn alone shows a bend only where it is steep.

Not against ATTITUDE: the autopilot's estimator follows a new calibration only slowly and stays wrong
by up to twenty degrees through a whole further turn.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from mavcompass.calibration.observation import assemble, dwell_between
from mavcompass.calibration.result import CalibrationResult
from mavcompass.frames import wrap_pi
from mavcompass.heading.deviation import heading_change_rad
from mavcompass.procedure.positions.visiting import Window
from mavcompass.track import Track

# What a right calibration may differ by all the same: three sigmas, and never less than this.
_LEAST_TOLERANCE_RAD = math.radians(1.5)
_LEAST_CHANGE_DEG = 0.75
# A turn by a shows 2 sin(a/2) of what an offset bends: half of it from here on. Less proves nothing.
_LEAST_TURN_RAD = math.radians(29.0)


@dataclass(frozen=True, slots=True)
class CompassProof:
    """Hold what the proof turn showed of one compass, degrees.

    Attributes:
        change_deg, change_allowed_deg: how much the heading changes, rms over the circle, where the
            solution takes the proof's position in, and how much it may.
        doubts: why the solution with that position would not be accepted.
        apart_mgauss: how far the corrected field is from that before, where it only stood.
        least_turn_rad: a smaller turn tells nothing; 0 where it only stood.
    """

    instance: int
    field_turned_deg: float
    gyro_turned_deg: float
    tolerance_deg: float
    change_deg: float = 0.0
    change_allowed_deg: float = _LEAST_CHANGE_DEG
    doubts: tuple[str, ...] = ()
    apart_mgauss: float = 0.0
    least_turn_rad: float = _LEAST_TURN_RAD

    @property
    def difference_deg(self) -> float:
        """Return field minus gyro, in [-180, 180)."""
        return math.degrees(float(wrap_pi(math.radians(self.field_turned_deg - self.gyro_turned_deg))))

    @property
    def tells(self) -> bool:
        """Tell whether it ended far enough from where it began to show anything."""
        return abs(float(wrap_pi(math.radians(self.gyro_turned_deg)))) >= self.least_turn_rad

    @property
    def passed(self) -> bool:
        """Tell whether the turn tells, the turns agree and the solution stands."""
        turned_alike = abs(self.difference_deg) <= self.tolerance_deg
        return self.tells and turned_alike and self.change_deg <= self.change_allowed_deg and not self.doubts


@dataclass(frozen=True, slots=True)
class Proof:
    """Hold the proof of all compasses."""

    compasses: tuple[CompassProof, ...]

    @property
    def tells(self) -> bool:
        """Tell whether the turn was far enough for all."""
        return all(compass.tells for compass in self.compasses)

    @property
    def passed(self) -> bool:
        """Tell whether all agree."""
        return all(compass.passed for compass in self.compasses)

    def summary(self) -> str:
        """Return the sentence for the person."""
        if not any(c.least_turn_rad for c in self.compasses):
            return self._stood()
        turned = ", ".join(f"compass {c.instance} {c.field_turned_deg:.1f}" for c in self.compasses)
        gyro = ", ".join(dict.fromkeys(f"{c.gyro_turned_deg:.1f}" for c in self.compasses))
        parts = [f"{turned} deg; gyro {gyro} deg"]
        if not self.tells:
            parts.append("too small a turn to prove anything")
        parts += [
            f"with this position the heading of compass {c.instance} would be {c.change_deg:.1f} deg another"
            for c in self.compasses
            if c.change_deg > c.change_allowed_deg
        ]
        doubts = "".join(f" {doubt}" for compass in self.compasses for doubt in compass.doubts)
        verdict = "Checked by a turn" if self.passed else "The turn does not confirm the new values"
        return f"{verdict}: {'; '.join(parts)}.{doubts}"

    def _stood(self) -> str:
        read = ", ".join(
            f"compass {c.instance} {c.apart_mgauss:.1f} mG and {abs(c.difference_deg):.1f} deg"
            for c in self.compasses
        )
        if not self.passed:
            return f"The field does not read as the new values must make it: {read} off."
        return (
            f"Checked where it stands: the field reads as the new values must make it ({read} off). That"
            " proves that they are in force, and no other heading: check those by a landmark, or by a turn."
        )


def prove(
    track: Track,
    before: Window,
    after: Window,
    results: Sequence[CalibrationResult],
    again: Sequence[CalibrationResult],
    turned: bool = True,
) -> Proof:
    """Compare the turn between two dwells as the corrected field saw it with the gyro's.

    `after` lies behind the write: there the autopilot itself applies the new values. `again` are the
    solutions that take `after` in as one more position. Not `turned`, both are one position.
    """
    return Proof(
        tuple(
            _prove_one(track, before, after, result, anew, turned)
            for result, anew in zip(results, again, strict=True)
        )
    )


def _prove_one(
    track: Track,
    before: Window,
    after: Window,
    result: CalibrationResult,
    again: CalibrationResult,
    turned: bool,
) -> CompassProof:
    dwells = [dwell_between(track, result.instance, w.start_s, w.end_s) for w in (before, after)]
    data = assemble(track, dwells, result.instance)
    step = data.steps[0]
    first, second = (dwell.heading_rad(result.correction) for dwell in dwells)
    gyro_rad = math.hypot(
        step.sigma_rad,
        data.gyro_scale_sigma * step.angle_rad,
        data.gyro_bias_sigma_radps * step.duration_s,
    )
    # A tilt that is not known turns the field by the dip's tangent.
    dip = result.vertical_mgauss / max(result.horizontal_mgauss, 1.0)
    tilt_rad = dip * math.hypot(*(dwell.tilt_sigma_rad for dwell in dwells))
    # What bends one heading bends the same again.
    own_deg = math.sqrt(2.0) * result.heading_sigma_deg if turned else 0.0
    sigma_deg = math.hypot(own_deg, math.degrees(math.hypot(gyro_rad, tilt_rad)), 0.2)
    change_rad = heading_change_rad(
        result.correction, again.correction, result.horizontal_mgauss, result.vertical_mgauss
    )
    return CompassProof(
        instance=result.instance,
        field_turned_deg=math.degrees(step.angle_rad + float(wrap_pi(second - first - step.angle_rad))),
        gyro_turned_deg=math.degrees(step.angle_rad),
        tolerance_deg=max(math.degrees(_LEAST_TOLERANCE_RAD), 3.0 * sigma_deg),
        change_deg=math.degrees(math.sqrt(float((change_rad**2).mean()))),
        change_allowed_deg=max(_LEAST_CHANGE_DEG, 3.0 * result.heading_sigma_deg),
        doubts=again.reasons,
        apart_mgauss=float(
            np.linalg.norm(np.diff([result.correction.apply(d.mean_mgauss) for d in dwells], axis=0))
        ),
        least_turn_rad=_LEAST_TURN_RAD if turned else 0.0,
    )
