"""PX4's compasses: sensors mounted at a rotation, calibrated in their own axes, in gauss."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from mavcompass.compass_parameters import (
    PX4_ANGLES,
    PX4_CUSTOM,
    px4_name,
    px4_sensor_correction,
    px4_sensor_to_body,
    px4_values,
)
from mavcompass.correction import FieldCorrection, Vector
from mavcompass.frames import wrap_angle
from mavcompass.simulation.autopilot.board import Board, Status
from mavcompass.simulation.autopilot.compasses import Compasses
from mavcompass.simulation.autopilot.parameters import ParameterStore

INSTANCES = (1, 2)
# Changes of the offset, and of the matrix, that are no longer than this are not loaded.
_SMALLEST_CHANGE_MGAUSS, _SMALLEST_CHANGE = 5.0, 0.01
# A heading that is further off than this is not believed (EKF2_HEAD_NOISE).
_BELIEVED_RAD = 0.3
# What the estimator learns of an offset in a flight, as a share of it.
_LEARNT = 0.6


class Px4Compasses(Compasses):
    """Hold raw readings in the sensors' axes, and the corrected field in the body's.
    Parameters are loaded while it is disarmed only; on disarming, what the estimator has learnt of the
    steering compass's offset is stored, with the rest of the calibration that it flew with.
    """

    autopilot = "px4"

    def __init__(self, board: Board, store: ParameterStore, status: Status) -> None:
        super().__init__(board, store, len(INSTANCES))
        self._status = status
        self._corrections = [self._wanted(i) for i in INSTANCES]  # in the sensors' axes
        self._take_mountings()
        self.raw_sensor_mgauss: list[Vector] = [(0.0, 0.0, 0.0)] * len(INSTANCES)
        self.steering = INSTANCES[0]

    def boot(self) -> None:
        """Take all parameters over, choose the compass of the highest priority (0 is disabled)."""
        self.parameters_changed()
        self._corrections = [self._wanted(i) for i in INSTANCES]
        priorities = {i: self._store[px4_name("PRIO", i)] for i in INSTANCES}
        best = max(INSTANCES, key=lambda i: priorities[i])
        self.steering = best if priorities[best] > 0.0 else None

    def yaw(self) -> float | None:
        """Return the heading of the compass that steers; None where there is none to believe."""
        return self._yaw(self._board.world.declination_rad)

    def correction(self, instance: int) -> FieldCorrection:
        """Return the correction in force, in body axes; none beyond the compasses it has."""
        if instance not in INSTANCES:
            return FieldCorrection()
        return self._corrections[instance - 1].turned(self._rotations[instance - 1])

    def held(self, instance: int) -> FieldCorrection:
        """Return the correction that the parameters hold, loaded or not."""
        return self._wanted(instance).turned(px4_sensor_to_body(self._store.values, instance))

    def parameters_changed(self) -> None:
        """Load the parameters, except what hardly changed; a loaded calibration resets the heading."""
        if self._status.armed:
            return
        self._take_mountings()
        for place, instance in enumerate(INSTANCES):
            new = _where_changed(self._corrections[place], self._wanted(instance))
            if new != self._corrections[place]:
                self._corrections[place] = new
                if instance == self.steering:
                    self._reset_heading()

    def store_learnt(self) -> None:
        """Store the calibration that it flew with, its offset moved toward what the estimator has learnt."""
        if self.steering is None:
            return
        place = self.steering - 1
        flown, cure = self.correction(self.steering), self._board.sensors.compasses[place].model.iron
        bias = np.subtract(cure.offsets_mgauss, flown.offsets_mgauss) * (_LEARNT, _LEARNT, 0.0)
        if math.hypot(*bias) <= _SMALLEST_CHANGE_MGAUSS:
            return
        x, y, z = np.add(flown.offsets_mgauss, bias).tolist()
        learnt = replace(flown, offsets_mgauss=(x, y, z))
        stored = px4_values(learnt, self.steering, self._rotations[place]) | self._flown_mountings[place]
        for name, value in stored.items():
            self._store.set(name, value)
        self._corrections[place] = self._wanted(self.steering)
        self._reset_heading()

    def store_found(self, instance: int, cure: FieldCorrection) -> None:
        """Store what its own calibration found, in the sensor's axes."""
        rotation = self._rotations[instance - 1]
        for name, value in px4_values(cure.turned(rotation), instance, rotation).items():
            self._store.set(name, value)
        self.parameters_changed()

    def _reset_heading(self) -> None:
        """Take the compass's heading over; aided by a receiver, the filter believes none that is far off."""
        self.read()
        yaw_rad, estimate = self.yaw(), self._board.filter
        if yaw_rad is None:
            return
        if not self._store["EKF2_GPS_CTRL"] or abs(wrap_angle(yaw_rad - estimate.yaw_rad)) < _BELIEVED_RAD:
            estimate.take_yaw(yaw_rad)

    def read(self) -> None:
        """Take the new readings, turn them into the sensors' axes, correct them."""
        around = self._board.surroundings()
        for place, instance in enumerate(INSTANCES):
            if self._repeats(instance):
                continue
            raw = self._stuck(instance) or self._board.sensors.compasses[place].raw_mgauss
            x, y, z = (self._mountings[place].T @ np.array(raw)).tolist()
            self.raw_sensor_mgauss[place] = (x, y, z)
            correction = self._corrections[place]
            load = around.current_a if correction.motor_source == "current" else around.throttle
            field = correction.apply([x, y, z], load if any(correction.motor_mgauss) else None)
            # The parameters may say another rotation than the mounting: they are what is believed.
            x, y, z = (self._rotations[place] @ field).tolist()
            self.fields[place] = (x, y, z)

    def expected_raw(self, instance: int, field: Sequence[float]) -> list[float]:
        """Return what a sensor without offset would read of a body field: S^-1 R^T field."""
        matrix = self._corrections[instance - 1].matrix
        inverse = np.linalg.inv(matrix) if np.linalg.det(matrix) else np.eye(3)
        found: list[float] = (inverse @ self._rotations[instance - 1].T @ np.asarray(field)).tolist()
        return found

    def _wanted(self, instance: int) -> FieldCorrection:
        """Return what the parameters say; with another sensor's id they are not for this one."""
        name = px4_name("ID", instance)
        if self._store[name] != self._store.factory_value(name):
            return FieldCorrection()
        return px4_sensor_correction(self._store.values, instance)

    def _take_mountings(self) -> None:
        """Take the mountings over; angles that are not zero make ROT 100."""
        store, quantities = self._store, ("ROT", *PX4_ANGLES)
        for instance in INSTANCES:
            angles = (store[px4_name(angle, instance)] for angle in PX4_ANGLES)
            if store[px4_name("ROT", instance)] >= 0.0 and any(angles):
                store.set(px4_name("ROT", instance), float(PX4_CUSTOM))
        self._rotations = [px4_sensor_to_body(store.values, i) for i in INSTANCES]
        self._flown_mountings = [
            {px4_name(q, i): store[px4_name(q, i)] for q in quantities} for i in INSTANCES
        ]


def _where_changed(old: FieldCorrection, new: FieldCorrection) -> FieldCorrection:
    """Take over of a calibration what changed by more than a little: offset, diagonal, off-diagonal."""
    if math.dist(old.offsets_mgauss, new.offsets_mgauss) <= _SMALLEST_CHANGE_MGAUSS:
        new = replace(new, offsets_mgauss=old.offsets_mgauss)
    if math.dist(old.diagonals, new.diagonals) <= _SMALLEST_CHANGE:
        new = replace(new, diagonals=old.diagonals)
    if math.dist(old.off_diagonals, new.off_diagonals) <= _SMALLEST_CHANGE:
        new = replace(new, off_diagonals=old.off_diagonals)
    return new
