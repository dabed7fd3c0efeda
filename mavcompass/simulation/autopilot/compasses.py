"""A firmware's compasses: which one steers, which are lost, and the heading of the one that steers.

Behind them the fit of its own compass calibration: readings apart from each other, and their ellipsoid.
"""

from __future__ import annotations

import math
from abc import ABC, abstractmethod

import numpy as np
from numpy.typing import NDArray

from mavcompass.compass_parameters import sensor_to_body
from mavcompass.correction import FieldCorrection, Vector
from mavcompass.frames import FloatArray
from mavcompass.simulation.autopilot.attitude_filter import compass_yaw
from mavcompass.simulation.autopilot.board import Board
from mavcompass.simulation.autopilot.parameters import ParameterStore
from mavcompass.simulation.physics.motion import rotation_matrix


class Compasses(ABC):
    """Hold the corrected fields of compasses 1, 2, ..; brought up to date at 10 Hz.

    The sensors are mounted as the parameters that the vehicle was made with say.

    Attributes:
        autopilot: whose parameters they go by.
        fields: milligauss, body axes. steering: the compass that the filter follows, None for none.
    """

    autopilot: str

    def __init__(self, board: Board, store: ParameterStore, number: int) -> None:
        self._board = board
        self._store = store
        every = range(1, len(board.compass_setups) + 1)
        self._mountings = [sensor_to_body(self.autopilot, store.delivered, i) for i in every]
        self.fields: list[Vector] = [(0.0, 0.0, 0.0)] * number
        self.steering: int | None = None
        self._lost: dict[int, tuple[bool, Vector | None]] = {}

    @abstractmethod
    def boot(self) -> None:
        """Take the parameters over and choose the compass that steers."""

    @abstractmethod
    def parameters_changed(self) -> None:
        """Take the parameters over, as far as the firmware does without a reboot."""

    @abstractmethod
    def read(self) -> None:
        """Correct the new readings; a compass without data keeps its last field."""

    @abstractmethod
    def correction(self, instance: int) -> FieldCorrection:
        """Return the correction in force, in body axes."""

    def load(self, correction: FieldCorrection) -> float | FloatArray:
        """Return what the motor term of a correction goes with at this moment."""
        around = self._board.surroundings()
        return {"current": around.current_a, "throttle": around.throttle}.get(correction.motor_source, 0.0)

    def held(self, instance: int) -> FieldCorrection:
        """Return the correction that the parameters hold, in force or not."""
        return self.correction(instance)

    def turned(self, instance: int) -> FloatArray:
        """Return how the parameters, in force or not, turn a reading from where the sensor sits, (3, 3)."""
        by_parameters = sensor_to_body(self.autopilot, self._store.values, instance)
        return by_parameters @ self._mountings[instance - 1].T

    @abstractmethod
    def yaw(self) -> float | None:
        """Return the heading of the compass that steers; None where there is none to believe."""

    def healthy(self, instance: int) -> bool:
        """Tell whether a compass delivers data."""
        return self._lost.get(instance, (True, None))[0]

    def lose(self, instance: int, healthy: bool, value: Vector | None) -> None:
        """Stop a compass, at a raw value or at its last reading."""
        self._lost[instance] = (healthy, value)

    def expected_field(self, yaw_rad: float) -> Vector:
        """Return the world's field in body axes at a heading, with the filter's tilt."""
        estimate, (n, e, d) = self._board.filter, self._board.world.field_ned_mgauss
        m = rotation_matrix(estimate.roll_rad, estimate.pitch_rad, yaw_rad)
        x, y, z = (m[i] * n + m[3 + i] * e + m[6 + i] * d for i in range(3))
        return (x, y, z)

    def _yaw(self, declination_rad: float) -> float | None:
        if self.steering is None or not self.healthy(self.steering):
            return None
        estimate = self._board.filter
        field = self.fields[self.steering - 1]
        return compass_yaw(field, estimate.roll_rad, estimate.pitch_rad, declination_rad)

    def _repeats(self, instance: int) -> bool:
        """Tell whether a compass stopped at its last reading."""
        return instance in self._lost and self._lost[instance][1] is None

    def _stuck(self, instance: int) -> Vector | None:
        """Return the raw value that a compass stopped at, None for one that goes on."""
        return self._lost.get(instance, (True, None))[1]


Array = NDArray[np.float64]
_SECTIONS = 80
# Directions spread evenly over the sphere by the golden angle, each the middle of a section.
_HEIGHT = 1.0 - (2.0 * np.arange(_SECTIONS) + 1.0) / _SECTIONS
_ANGLE = np.arange(_SECTIONS) * math.pi * (3.0 - math.sqrt(5.0))
_MIDDLES = np.stack(
    [np.sqrt(1.0 - _HEIGHT**2) * np.cos(_ANGLE), np.sqrt(1.0 - _HEIGHT**2) * np.sin(_ANGLE), _HEIGHT], axis=1
)


class TurnedReadings:
    """Collect raw readings, milligauss, no nearer to each other than a distance."""

    def __init__(self) -> None:
        self.readings: Array = np.zeros((0, 3))

    def __len__(self) -> int:
        """Count them."""
        return len(self.readings)

    def take(self, reading: Vector, apart_mgauss: float) -> bool:
        """Take a reading; False where it is too near to another."""
        if len(self) and float(np.linalg.norm(self.readings - reading, axis=1).min()) < apart_mgauss:
            return False
        self.readings = np.vstack([self.readings, reading])
        return True

    def thin(self, apart_mgauss: float) -> None:
        """Drop readings that are nearer to another than that."""
        kept, self.readings = self.readings, np.zeros((0, 3))
        for reading in kept:
            self.take(reading, apart_mgauss)

    def centre(self) -> tuple[Array, float]:
        """Return centre and radius of the sphere through them: |r|^2 = 2 c r + (R^2 - c^2)."""
        r = self.readings
        design = np.hstack([2.0 * r, np.ones((len(r), 1))])
        found = np.linalg.lstsq(design, (r**2).sum(axis=1), rcond=None)[0]
        return found[:3], math.sqrt(max(float(found[3] + found[:3] @ found[:3]), 1.0))

    def fit(self) -> tuple[FieldCorrection, float, float] | None:
        """Return what makes a sphere of them, its radius and the rms that is left; None for no ellipsoid.

        A quadric r'Q r + 2 u'r = 1 about the readings' middle, by linear least squares; |M (r - c)| = R.
        """
        middle, radius = self.centre()
        x, y, z = ((self.readings - middle) / radius).T
        design = np.stack([x * x, y * y, z * z, 2 * x * y, 2 * x * z, 2 * y * z, 2 * x, 2 * y, 2 * z], axis=1)
        a, b, c, d, e, f, *u = np.linalg.lstsq(design, np.ones(len(x)), rcond=None)[0]
        quadric = np.array([[a, d, e], [d, b, f], [e, f, c]])
        values, axes = np.linalg.eigh(quadric)
        if values[0] <= 0.0:
            return None
        shift = -np.linalg.solve(quadric, u)
        stretch = axes @ np.diag(np.sqrt(values / (1.0 + shift @ quadric @ shift))) @ axes.T
        correction = FieldCorrection.from_matrix(-(middle + radius * shift), 0.5 * (stretch + stretch.T))
        length = np.linalg.norm(correction.apply(self.readings), axis=1)
        return correction, radius, float(np.sqrt(((length - radius) ** 2).mean()))

    def sections(self, centre: Array) -> int:
        """Return which of the sphere's sections hold a reading, seen from a centre, as bits."""
        ahead = (self.readings - centre) @ _MIDDLES.T
        return sum(1 << int(k) for k in np.unique(ahead.argmax(axis=1))) if len(self) else 0
