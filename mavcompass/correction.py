"""FieldCorrection: what turns a raw magnetometer reading into the Earth's field, and back.

The form is ArduPilot's, in body axes:

    field = M ((raw + offsets) scale) + motor load,    M = [[DX, OX, OY],
                                                            [OX, DY, OZ],
                                                            [OY, OZ, DZ]]

with the diagonal D, the off-diagonals O, and `load` the battery current in amperes, the throttle as a
fraction, or one number for each motor. PX4's form is brought into this one by `compass_parameters`.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Literal

import numpy as np
from numpy.typing import ArrayLike

from mavcompass.errors import PoorCalibration
from mavcompass.frames import FloatArray

Vector = tuple[float, float, float]
MotorSource = Literal["none", "throttle", "current", "outputs"]
# COMPASS_PMOT_EXP as it comes.
USUAL_EXPONENT = 0.65


# No magnetometer's range is a hundred gauss; ArduPilot's own calibration takes scales from 0.2 to 5.
_MOST_MGAUSS, _MOST_STRETCH = 1e5, 50.0


def _vector(values: ArrayLike) -> Vector:
    x, y, z = _numbers(values)
    return (x, y, z)


def _numbers(values: ArrayLike) -> tuple[float, ...]:
    return tuple(np.asarray(values, dtype=np.float64).ravel().tolist())


@dataclass(frozen=True, slots=True)
class FieldCorrection:
    """Hold one compass's correction.

    Attributes:
        offsets_mgauss: added to the raw field (so minus the hard iron), milligauss.
        diagonals, off_diagonals: the symmetric matrix M; off_diagonals are (xy, xz, yz).
        scale: the scalar that multiplies the whole field.
        motor_mgauss: field added per unit of motor load, milligauss per ampere or at full throttle; three
            numbers for each load.
        motor_source: which load `motor_mgauss` goes with; "outputs" are one for each of ArduPilot's motors
            1 to 4, see `Track.motor_load`. motor_exponent: theirs.
    """

    offsets_mgauss: Vector = (0.0, 0.0, 0.0)
    diagonals: Vector = (1.0, 1.0, 1.0)
    off_diagonals: Vector = (0.0, 0.0, 0.0)
    scale: float = 1.0
    motor_mgauss: tuple[float, ...] = (0.0, 0.0, 0.0)
    motor_source: MotorSource = "none"
    motor_exponent: float = USUAL_EXPONENT

    @property
    def motors(self) -> FloatArray:
        """Return what is added per unit of each load, shape (loads, 3)."""
        return np.reshape(self.motor_mgauss, (-1, 3))

    @property
    def goes_with(self) -> tuple[MotorSource, float]:
        """Return which load the motor term goes with: source and exponent."""
        return self.motor_source, self.motor_exponent

    @property
    def matrix(self) -> FloatArray:
        """Return M times scale, shape (3, 3): all that is linear in this correction."""
        dx, dy, dz = self.diagonals
        xy, xz, yz = self.off_diagonals
        return self.scale * np.array([[dx, xy, xz], [xy, dy, yz], [xz, yz, dz]])

    @property
    def possible(self) -> bool:
        """Tell whether a compass can have it: numbers in a sensor's range, a matrix with an inverse."""
        given = (*self.offsets_mgauss, *self.motor_mgauss)
        if not all(abs(value) < _MOST_MGAUSS for value in given):  # False for nan
            return False
        try:
            sizes = (np.abs(self.matrix).max(), np.abs(np.linalg.inv(self.matrix)).max())
        except np.linalg.LinAlgError:
            return False
        return all(size <= _MOST_STRETCH for size in sizes)

    @property
    def inverse(self) -> FloatArray:
        """Return the inverse of `matrix`. Raises PoorCalibration where a vehicle's own has none."""
        try:
            return np.asarray(np.linalg.inv(self.matrix))
        except np.linalg.LinAlgError as error:
            raise PoorCalibration(
                "The correction in force cannot be taken out of the readings: its matrix has no inverse.",
                "Set its scales to 1 (ArduPilot: COMPASS_DIA to 1, COMPASS_ODI to 0), then calibrate.",
            ) from error

    @classmethod
    def from_matrix(
        cls,
        offsets_mgauss: ArrayLike,
        matrix: ArrayLike,
        scale: float = 1.0,
        motor_mgauss: ArrayLike = (0.0, 0.0, 0.0),
        motor_source: MotorSource = "none",
    ) -> FieldCorrection:
        """Build a correction from a symmetric matrix (3, 3), of which `scale` is taken out.

        Raises ValueError where the matrix is not symmetric: neither autopilot can hold a rotation.
        """
        m = np.asarray(matrix, dtype=np.float64) / scale
        if not np.allclose(m, m.T, rtol=0.0, atol=1e-9 * float(np.abs(m).max())):
            raise ValueError("a field correction's matrix is symmetric; take its rotation out first")
        return cls(
            offsets_mgauss=_vector(offsets_mgauss),
            diagonals=_vector(np.diag(m)),
            off_diagonals=_vector([m[0, 1], m[0, 2], m[1, 2]]),
            scale=float(scale),
            motor_mgauss=_numbers(motor_mgauss),
            motor_source=motor_source,
        )

    def apply(self, raw_mgauss: ArrayLike, load: ArrayLike | None = None) -> FloatArray:
        """Correct raw readings (..., 3), in milligauss, given the motor load (...), of outputs (..., 4)."""
        raw = np.asarray(raw_mgauss, dtype=np.float64)
        corrected = (raw + np.asarray(self.offsets_mgauss)) @ self.matrix.T
        return corrected if load is None else corrected + self.motor_field(load)

    def undo(self, field_mgauss: ArrayLike, load: ArrayLike | None = None) -> FloatArray:
        """Rebuild raw readings (..., 3) from corrected ones; the inverse of `apply`.

        Raises PoorCalibration where the matrix is singular (a zero on its diagonal).
        """
        field = np.asarray(field_mgauss, dtype=np.float64)
        if load is not None:
            field = field - self.motor_field(load)
        return field @ self.inverse.T - np.asarray(self.offsets_mgauss)

    def motor_field(self, load: ArrayLike) -> FloatArray:
        """Return the compensation (..., 3) for a motor load (...), of outputs (..., 4); an unknown load (nan)
        gives none."""
        known = np.nan_to_num(np.asarray(load, dtype=np.float64), nan=0.0)
        if self.motor_source != "outputs":
            known = known[..., np.newaxis]
        return np.asarray(known @ self.motors)

    def then(self, later: FieldCorrection) -> FieldCorrection:
        """Compose: one correction that does this one and then `later` to its output.

        Raises ValueError where the product of the matrices is not symmetric, or the two motor terms
        go with different loads.
        """
        loads = [c for c in (self, later) if any(c.motor_mgauss)]
        if len({c.goes_with for c in loads}) > 1:
            raise ValueError("corrections for different motor loads do not compose")
        offsets = np.asarray(self.offsets_mgauss) + np.linalg.solve(self.matrix, later.offsets_mgauss)
        plain = FieldCorrection.from_matrix(
            offsets, later.matrix @ self.matrix, scale=self.scale * later.scale
        )
        return plain.with_motors(self.motors @ later.matrix.T + later.motors, loads[0] if loads else IDENTITY)

    def turned(self, rotation: FloatArray) -> FieldCorrection:
        """Return this correction for raw readings, and a field, that are turned by a rotation (3, 3)."""
        plain = FieldCorrection.from_matrix(
            rotation @ np.asarray(self.offsets_mgauss), rotation @ self.matrix @ rotation.T, self.scale
        )
        return plain.with_motors(self.motors @ rotation.T, self)

    def with_motor_of(self, other: FieldCorrection) -> FieldCorrection:
        """Carry the motor term of another correction of the same compass into this matrix."""
        return self.with_motors((self.matrix @ np.linalg.solve(other.matrix, other.motors.T)).T, other)

    def without_outputs(self) -> FieldCorrection:
        """Leave the motor term out, if that is one for each motor."""
        return self.with_motors(IDENTITY.motors, IDENTITY) if self.motor_source == "outputs" else self

    def with_motors(self, motors_mgauss: FloatArray, of: FieldCorrection) -> FieldCorrection:
        """Take a motor term, (loads, 3), for the loads of another correction."""
        return replace(
            self,
            motor_mgauss=_numbers(motors_mgauss),
            motor_source=of.motor_source,
            motor_exponent=of.motor_exponent,
        )


IDENTITY = FieldCorrection()
