"""A firmware's compasses: which one steers, which are lost, and the heading of the one that steers."""

from __future__ import annotations

from abc import ABC, abstractmethod

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
