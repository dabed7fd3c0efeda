"""The iron that the calibration in force cures: a measurement of the vehicle, part of its nominal simulation.

ArduPilot's correction, field = M ((raw + ofs) scale) + motor load, read backwards, says what the raw sensor
does:

    raw = A (field - motor load) + b,    A = (M scale)^-1,    b = -ofs.

How far it is to be trusted is a prior: right within what calibrations usually leave, or, where a baseline
refutes that, of another iron.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from mavcompass.correction import IDENTITY, FieldCorrection, MotorSource
from mavcompass.frames import FloatArray
from mavcompass.gap.replay.nuisance import Nuisance
from mavcompass.simulation.effects.effect import Effect, Memory, Parameter, Signals, Stage
from mavcompass.track import MagSeries

IRON_MATRIX, IRON_OFFSET = "iron matrix in force", "iron offset in force"
_LEAST_VARIATION = 0.2
_Rng = np.random.Generator | None
_ENTRIES = tuple(f"{row}{column}" for row in "xyz" for column in "xyz")


@dataclass(frozen=True, slots=True)
class Trust:
    """Say how far the calibration in force may be off: some mG, some parts of one, and a share of what it
    cures.

    `motor_mgauss` is the same for what the motors' field varies by over the recording.
    """

    offset_mgauss: float
    matrix: float
    motor_mgauss: float
    share: float


STATED = Trust(1.0, 0.003, 1.0, 0.02)
ANOTHER_IRON = Trust(150.0, 0.1, 150.0, 0.0)


@dataclass(frozen=True, slots=True, eq=False)
class KnownIron:
    """Hold what a calibration says of the raw sensor.

    Attributes:
        correction: the calibration, as the autopilot has it in force.
        matrix: A (3, 3); offset_mgauss: b (3,); motor_mgauss: what a unit of the load adds to the raw field,
        (3,). load: the motor load at the rows, (N,), zeros where there is none; source: what it is.
    """

    correction: FieldCorrection
    matrix: FloatArray
    offset_mgauss: FloatArray
    motor_mgauss: FloatArray
    load: FloatArray
    source: MotorSource = "none"

    @property
    def calibrated(self) -> bool:
        """Tell a calibration from none."""
        return self.correction != IDENTITY

    def raw(self, field_mgauss: FloatArray) -> FloatArray:
        """Return what the raw sensor says of a field (N, 3) in body axes, if the calibration is right."""
        return field_mgauss @ self.matrix.T + self.offset_mgauss + self.load[:, None] * self.motor_mgauss

    def field(self, raw_mgauss: FloatArray) -> FloatArray:
        """Return the field (N, 3) in body axes that the calibration makes of raw readings."""
        free = raw_mgauss - self.offset_mgauss - self.load[:, None] * self.motor_mgauss
        return np.asarray(free @ np.linalg.inv(self.matrix).T)

    def nuisances(self, trust: Trust) -> tuple[Nuisance, Nuisance]:
        """Return the iron as part of the nominal simulation, with what is not known of it."""
        sigma = self.sigma(trust)
        matrix = Nuisance.of(self._matrix_effect(), np.zeros(9), sigma[3:])
        sigma = sigma[:3]
        if self.load.any():
            varies = float(np.ptp(self.load))
            # A load that is always the same tells nothing: its field is part of the offset.
            told = varies > _LEAST_VARIATION * abs(float(self.load.mean()))
            sigma = np.concatenate([sigma, np.full(3, trust.motor_mgauss / varies if told else 1e-6)])
        return matrix, Nuisance.of(self._offset_effect(), np.zeros(sigma.size), sigma)

    def sigma(self, trust: Trust) -> FloatArray:
        """Return how far offsets (3, in mG) and matrix elements (9) may be off, (12,)."""
        offset = trust.offset_mgauss + trust.share * np.abs(self.offset_mgauss)
        cured = float(np.abs(self.matrix - np.eye(3)).max())
        return np.concatenate([offset, np.full(9, trust.matrix + trust.share * cured)])

    def _matrix_effect(self) -> Effect:
        def forward(signals: Signals, theta: FloatArray, memory: Memory, rng: _Rng) -> Signals:
            return signals.with_mag(
                signals.reading.mag_mgauss @ (self.matrix @ (np.eye(3) + theta.reshape(3, 3))).T
            )

        def slopes(signals: Signals, theta: FloatArray) -> FloatArray:
            by_entry = self.matrix[:, :, None] * signals.reading.mag_mgauss[:, None, None, :]
            return by_entry.reshape(-1, 3, 9)

        entries = tuple(Parameter(n, "1", -0.9, 0.9, 0.0, 0.01) for n in _ENTRIES)
        title = "the matrix that the calibration in force cures"
        return Effect(IRON_MATRIX, title, Stage.MATRIX, entries, forward, affine=True, slopes=slopes)

    def _offset_effect(self) -> Effect:
        # What is not known of the motors counts from their usual load: the offset stays the offset.
        unusual = self.load - self.load.mean()

        def forward(signals: Signals, theta: FloatArray, memory: Memory, rng: _Rng) -> Signals:
            offset = np.asarray(self.offset_mgauss + theta[:3])
            if theta.size > 3:
                offset = offset + self.load[:, None] * self.motor_mgauss + unusual[:, None] * theta[3:]
            return signals.with_mag(signals.reading.mag_mgauss + offset)

        def slopes(signals: Signals, theta: FloatArray) -> FloatArray:
            offset = np.broadcast_to(np.eye(3), (unusual.size, 3, 3))
            motor = unusual[:, None, None] * offset
            return offset if theta.size == 3 else np.concatenate([offset, motor], axis=2)

        parameters = tuple(Parameter(n, "mG", -2000.0, 2000.0, 0.0, 10.0) for n in "xyz")
        if self.load.any():
            parameters += tuple(Parameter(f"motor_{n}", "mG", -2000.0, 2000.0, 0.0, 1.0) for n in "xyz")
        title = "the offset that the calibration in force cures"
        return Effect(IRON_OFFSET, title, Stage.FIELD, parameters, forward, slopes=slopes)


def calibration_in_force(compass: MagSeries) -> FieldCorrection:
    """Return the last calibration that was in force, the identity where the recording does not tell one."""
    if compass.not_applied is not None:
        return compass.not_applied
    return compass.in_force[-1].correction if compass.correction_known else IDENTITY


def known_iron(correction: FieldCorrection, load: FloatArray, source: MotorSource) -> KnownIron:
    """Read a calibration backwards; `load` (N,) is the motor load that its motor term goes with."""
    matrix = correction.inverse
    motor = np.asarray(-matrix @ np.asarray(correction.motor_mgauss), dtype=np.float64)
    return KnownIron(correction, matrix, -np.asarray(correction.offsets_mgauss), motor, load, source)


def load_of(
    source: MotorSource, current_a: FloatArray, throttle: FloatArray
) -> tuple[FloatArray, MotorSource]:
    """Return the load that a motor term goes with, (N,), and which: the current where it has none."""
    if source == "throttle" or not np.isfinite(current_a).any():
        return np.nan_to_num(throttle), "throttle"
    return np.nan_to_num(current_a), "current"
