"""ArduPilot's compasses: which one steers, and the corrected field it works with and sends."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from mavcompass.compass_parameters import (
    ardupilot_correction,
    ardupilot_is_external,
    ardupilot_name,
    ardupilot_orientations,
    ardupilot_sensor_to_body,
)
from mavcompass.correction import FieldCorrection, Vector
from mavcompass.frames import FloatArray
from mavcompass.simulation.autopilot.board import Board
from mavcompass.simulation.autopilot.compasses import Compasses
from mavcompass.simulation.autopilot.parameters import ParameterStore
from mavcompass.simulation.physics.motion import times

INSTANCES = (1, 2, 3)
_FREE_ANGLES = tuple(f"CUST_ROT{n}_{angle}" for n in (1, 2) for angle in ("ROLL", "PITCH", "YAW"))


class CompassBank(Compasses):
    """Hold ArduPilot's three compasses."""

    autopilot = "ardupilot"

    def __init__(self, board: Board, store: ParameterStore) -> None:
        super().__init__(board, store, len(INSTANCES))
        self.hardware_ids = tuple(store.factory_value(ardupilot_name("DEV_ID", i)) for i in INSTANCES)
        self.order: tuple[int, ...] = INSTANCES
        self.bad_rotation = False
        self._corrections: list[FieldCorrection] = []
        self._matrices: list[tuple[float, ...]] = []
        self._rotations: list[tuple[float, ...] | None] = []
        self.battery_volts: Callable[[], float] = lambda: 0.0
        self._volts = 0.0
        self._free_angles: dict[str, float] = {}
        self._at_start()

    def boot(self) -> None:
        """Order the compasses by priority and choose the one that steers: the first in use."""
        by_id = {dev_id: i for i, dev_id in zip(INSTANCES, self.hardware_ids, strict=True)}
        wanted = [by_id.get(self._store.get(f"COMPASS_PRIO{n}_ID")) for n in INSTANCES]
        order = [i for i in dict.fromkeys(wanted) if i is not None]
        self.order = tuple(order + [i for i in INSTANCES if i not in order])
        in_use = [i for i in self.order if self.in_use(i)]
        self.steering = in_use[0] if in_use else None
        self.bad_rotation = False
        self._at_start()

    def _at_start(self) -> None:
        """Take all parameters over, the free angles, which wait for a start, too."""
        self._free_angles = {name: self._store[name] for name in _FREE_ANGLES}
        self.parameters_changed()

    def in_use(self, instance: int) -> bool:
        """Tell whether COMPASS_USE lets a compass be used."""
        return bool(self._store.get(ardupilot_name("USE", instance), 1.0))

    def yaw(self) -> float | None:
        """Return the heading of the compass that steers; None where there is none to believe."""
        if not self._store["COMPASS_ENABLE"] or self.steering is None or not self.in_use(self.steering):
            return None
        return self._yaw(self._store["COMPASS_DEC"])

    def parameters_changed(self) -> None:
        """Take the parameters over: offsets, matrix, scale, motor terms, orientation."""
        values = self._store.values
        self._corrections = [ardupilot_correction(values, i) for i in INSTANCES]
        self._matrices = [tuple(c.matrix.ravel().tolist()) for c in self._corrections]
        self._rotations = [self._rotation(i) for i in INSTANCES]

    def correction(self, instance: int) -> FieldCorrection:
        """Return the correction in force."""
        return self._corrections[instance - 1]

    def raw(self, instance: int) -> Vector:
        """Return a compass's present reading in body axes, before the correction."""
        stuck = self._stuck(instance)
        raw = stuck or self._board.sensors.compasses[instance - 1].raw_mgauss
        rotation = self._rotations[instance - 1]
        return raw if rotation is None or stuck is not None else times(rotation, raw)

    def read(self) -> None:
        """Correct the new readings; a compass without data keeps its last field."""
        if not self._store.get("COMPASS_ENABLE", 1.0):
            return
        # As Compass_PerMotor.h, set_voltage; from the first reading on, not from zero.
        volts = self.battery_volts()
        self._volts = 0.9 * self._volts + 0.1 * volts if self._volts else volts
        for i in INSTANCES:
            if not self._repeats(i):
                self.fields[i - 1] = self._correct(i)

    def load(self, correction: FieldCorrection) -> float | FloatArray:
        """Return what a motor term goes with: of outputs those of a copter's motors 1 to 4."""
        if correction.motor_source != "outputs":
            return super().load(correction)
        if self._board.profile.firmware != "copter":
            return np.zeros(4)
        outputs = np.array(self._board.surroundings().motors)
        return np.asarray((self._volts * outputs) ** correction.motor_exponent)

    def field(self, instance: int) -> Vector:
        """Return the corrected field of compass 1, 2 or 3, milligauss."""
        return self.fields[instance - 1]

    def uncorrected(self, instance: int) -> Vector:
        """Return what the firmware takes for the raw field.

        It takes matrix and offsets off the corrected field, but neither SCALE nor the motor's share; a
        matrix that cannot be inverted stays.
        """
        c = self._corrections[instance - 1]
        matrix = c.matrix / c.scale
        inverse = np.linalg.inv(matrix) if np.linalg.det(matrix) else np.eye(3)
        x, y, z = (inverse @ self.field(instance) - np.asarray(c.offsets_mgauss)).tolist()
        return (x, y, z)

    def _correct(self, instance: int) -> Vector:
        c, m = self._corrections[instance - 1], self._matrices[instance - 1]
        raw, o, k = self.raw(instance), c.offsets_mgauss, (0.0, 0.0, 0.0)
        if c.motor_source != "none":
            k = c.motor_field(self.load(c)).tolist()
        x, y, z = times(m, (raw[0] + o[0], raw[1] + o[1], raw[2] + o[2]))
        return x + k[0], y + k[1], z + k[2]

    def _rotation(self, instance: int) -> tuple[float, ...] | None:
        """Return how the parameters turn what a sensor as it is mounted reads; None: not at all."""
        values = {**self._store.values, **self._free_angles}
        orient = ardupilot_name("ORIENT", instance)
        if ardupilot_is_external(values, instance) and values[orient] not in ardupilot_orientations(values):
            if not self.bad_rotation:
                self._board.say("Internal errors 0x400000 l:0 bad_rotation")
            self.bad_rotation = True
        turned = ardupilot_sensor_to_body(values, instance) @ self._mountings[instance - 1].T
        return None if np.allclose(turned, np.eye(3)) else tuple(turned.ravel().tolist())
