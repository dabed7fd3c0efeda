"""The model of a compass on a turning vehicle, and what its parameters do to the heading.

A stretch k of a recording, at magnetic heading psi_k and mean load I_k of the motors, reads in the mean

    r_k = b + T A_k (H cos psi_k, -H sin psi_k, Z) + m (I_k - mean I)                            (M1)

with hard iron b, symmetric soft iron and gain T, the Earth's horizontal and vertical field H and Z, the
motors' field m per unit of load (of several loads a sum), and A_k from level to body axes, the mean of tilt
and turn about psi_k (S1): at rest the tilt L_k, but for what sways. A level heading psi has the error

    d psi = (e_psi . T^-1 (db + dT f)) / H,   e_psi = (sin psi, cos psi, 0)                      (M2)

to first order, f being the true field in body axes. Symmetry of T is a convention: a turn of the
whole compass about the vertical shows in no relative measurement.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from mavcompass.frames import NO_HEADING_RAD, FloatArray, level_to_body
from mavcompass.heading.compute import level_field

# Places of the quantities in the state vector; the K headings follow, then the fields of further loads.
OFFSET = slice(0, 3)
GAIN = slice(3, 9)
HORIZONTAL, VERTICAL, GYRO_SCALE, GYRO_BIAS = 9, 10, 11, 12
MOTOR = slice(13, 16)
LAG = 16
HEADINGS = 17
# The source of a heading's error that no further position averages out.
ACCELEROMETER = "accelerometer"
NAMES = (
    "offset_x",
    "offset_y",
    "offset_z",
    "gain_xx",
    "gain_yy",
    "gain_zz",
    "gain_xy",
    "gain_xz",
    "gain_yz",
    "horizontal_field",
    "vertical_field",
    "gyro_scale",
    "gyro_bias",
    "motor_x",
    "motor_y",
    "motor_z",
    "field_lag",
)
# Of these, a heading hangs on offsets and gains.
CALIBRATED = NAMES[: GAIN.stop]
# Row, column of each of the six gain parameters.
_GAIN_ROWS = np.array([0, 1, 2, 0, 0, 1])
_GAIN_COLUMNS = np.array([0, 1, 2, 1, 2, 2])


def motor_places(readings: int, loads: int = 1) -> NDArray[np.intp]:
    """Return where the state of so many readings has the field of each load, x, y, z, (3 loads,)."""
    behind = HEADINGS + readings
    return np.r_[MOTOR, behind : behind + 3 * (loads - 1)]


def gain_matrix(parameters: ArrayLike) -> FloatArray:
    """Build the symmetric matrix (3, 3) from (xx, yy, zz, xy, xz, yz)."""
    xx, yy, zz, xy, xz, yz = (float(v) for v in np.asarray(parameters))
    return np.array([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]])


def gain_parameters(matrix: ArrayLike) -> FloatArray:
    """Read (xx, yy, zz, xy, xz, yz) off a symmetric matrix (3, 3)."""
    return np.asarray(matrix)[_GAIN_ROWS, _GAIN_COLUMNS]


def gain_jacobian(vectors: FloatArray) -> FloatArray:
    """Return d(T v)/d(xx, yy, zz, xy, xz, yz), (..., 3, 6), for vectors v (..., 3)."""
    jacobian = np.zeros((*vectors.shape, 6))
    x, y, z = vectors[..., 0], vectors[..., 1], vectors[..., 2]
    jacobian[..., 0, 0], jacobian[..., 1, 1], jacobian[..., 2, 2] = x, y, z
    jacobian[..., 0, 3], jacobian[..., 1, 3] = y, x
    jacobian[..., 0, 4], jacobian[..., 2, 4] = z, x
    jacobian[..., 1, 5], jacobian[..., 2, 5] = z, y
    return jacobian


def by_tilt(mapping: FloatArray, state: FloatArray, headings_rad: FloatArray) -> FloatArray:
    """Return how readings (K) at magnetic headings change with roll and pitch, (K, 3, 2).

    `mapping` takes level axes to body axes, (K, 3, 3).
    """
    horizontal, gain = state[HORIZONTAL], gain_matrix(state[GAIN])
    level = level_field(headings_rad, horizontal, state[VERTICAL])
    x, y, z = np.einsum("kij,kj->ik", mapping, level)
    zero = np.zeros_like(x)
    by_roll = np.stack([zero, z, -y], axis=1) @ gain.T
    by_pitch = np.stack([-z, zero, x], axis=1) @ gain.T
    return np.stack([by_roll, by_pitch], axis=2)


def heading_gradient(
    state: FloatArray, heading_rad: ArrayLike, roll_rad: float = 0.0, pitch_rad: float = 0.0
) -> FloatArray:
    """Return the heading's derivative by offsets and gains, (N, 9), at magnetic headings (N,) (eq. M2)."""
    psi = np.atleast_1d(np.asarray(heading_rad, dtype=np.float64))
    to_level = level_to_body(roll_rad, pitch_rad).T
    body = level_field(psi, state[HORIZONTAL], state[VERTICAL]) @ to_level
    across = np.stack([np.sin(psi), np.cos(psi), np.zeros(psi.size)], axis=1) @ to_level
    weights = across @ np.linalg.inv(gain_matrix(state[GAIN])) / state[HORIZONTAL]
    by_gain = np.einsum("ni,nij->nj", weights, gain_jacobian(body))
    return np.concatenate([weights, by_gain], axis=1)


@dataclass(frozen=True, slots=True, eq=False)
class HeadingError:
    """Turn the covariance of offsets and gains into a heading's standard deviation.

    Attributes:
        state: the fitted state. covariance: (9, 9), of offsets and gains.
    """

    state: FloatArray
    covariance: FloatArray

    def sigma_rad(self, heading_rad: ArrayLike, roll_rad: float = 0.0, pitch_rad: float = 0.0) -> FloatArray:
        """Return the standard deviation at magnetic headings (N,), radians, by the calibration alone."""
        gradient = heading_gradient(self.state, heading_rad, roll_rad, pitch_rad)
        variance = np.einsum("ni,ij,nj->n", gradient, self.covariance, gradient)
        return np.sqrt(np.clip(variance, 0.0, NO_HEADING_RAD**2))

    def rms_rad(self, roll_rad: float = 0.0, pitch_rad: float = 0.0) -> float:
        """Return the standard deviation averaged (rms) over the circle."""
        circle = np.arange(72) * (2.0 * math.pi / 72)
        return math.sqrt(float((self.sigma_rad(circle, roll_rad, pitch_rad) ** 2).mean()))
