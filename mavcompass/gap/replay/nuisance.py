"""What a replay does not know exactly and must solve for besides any effect: never named as a cause.

Nuisances have a forward model like effects, and a prior: the field's model error, the reference's yaw, the
age of telemetry and over how long it is a mean, the iron that the calibration in force cures. A gap that
fits inside these priors is none.
ArduPilot's correction, field = M ((raw + ofs) scale) + motor load, read backwards, says what the raw sensor
does:

    raw = A (field - motor load) + b,    A = (M scale)^-1,    b = -ofs.

How far it is to be trusted is a prior: right within what calibrations usually leave, or, where a baseline
refutes that, of another iron.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

from mavcompass.correction import IDENTITY, FieldCorrection, MotorSource
from mavcompass.frames import FloatArray, euler_to_matrix, rotate_back, rotvec_to_matrix, wrap_pi
from mavcompass.gap.result import Iron
from mavcompass.gap.tables import usual
from mavcompass.simulation.effects.causes.timing import LONGEST_LAG_S, late_field, low_pass
from mavcompass.simulation.effects.effect import SMOOTHING, Effect, Memory, Parameter, Rng, Signals, Stage

REFERENCE_YAW = "reference yaw"
TELEMETRY_AGE, TELEMETRY_MEAN = "telemetry age", "telemetry mean"
IRON_MATRIX, IRON_OFFSET = "iron matrix in force", "iron offset in force"
_ENTRIES = tuple(f"{row}{column}" for row in "xyz" for column in "xyz")


@dataclass(frozen=True, slots=True, eq=False)
class Prior:
    """Hold nuisances and what is known of their parameters, one after the other, as one normal distribution.

    Attributes:
        effects: the nuisances. mean: (K,). precision: the inverse of the covariance, (K, K).
    """

    effects: tuple[Effect, ...] = ()
    mean: FloatArray = field(default_factory=lambda: np.zeros(0))
    precision: FloatArray = field(default_factory=lambda: np.zeros((0, 0)))

    @classmethod
    def of(cls, effect: Effect, mean: FloatArray, sigma: FloatArray) -> Prior:
        """Build that of one nuisance with independent parameters."""
        return cls((effect,), mean, np.diag(1.0 / np.square(sigma)))

    def beside(self, *others: Prior) -> Prior:
        """Put others after it, of which it knows nothing."""
        every = (self, *others)
        return Prior(
            tuple(effect for one in every for effect in one.effects),
            np.concatenate([one.mean for one in every]),
            block_diagonal([one.precision for one in every]),
        )

    @property
    def places(self) -> dict[str, slice]:
        """Return where the parameters of each nuisance stand, by its id."""
        ends = np.cumsum([len(effect.parameters) for effect in self.effects]).tolist()
        starts = [0, *ends]
        return {e.id: slice(*at) for e, *at in zip(self.effects, starts, ends, strict=False)}

    @property
    def lower(self) -> FloatArray:
        """Return the lower ends of the physical ranges, (K,)."""
        return np.concatenate([np.zeros(0), *(effect.lower for effect in self.effects)])

    @property
    def upper(self) -> FloatArray:
        """Return the upper ends of the physical ranges, (K,)."""
        return np.concatenate([np.zeros(0), *(effect.upper for effect in self.effects)])

    def holds(self, *ids: str) -> NDArray[np.bool_]:
        """Tell which parameters belong to some nuisances, (K,)."""
        out = np.zeros(self.mean.size, dtype=np.bool_)
        for nuisance, at in self.places.items():
            out[at] = nuisance in ids
        return out

    @property
    def known(self) -> NDArray[np.bool_]:
        """Tell of which parameters something is known, (K,): how an attitude wanders is no knowledge."""
        out = ~self.holds(REFERENCE_YAW)
        if REFERENCE_YAW in self.places:
            out[self.places[REFERENCE_YAW].start] = True
        return out


def block_diagonal(blocks: Sequence[FloatArray]) -> FloatArray:
    """Put square blocks along a diagonal."""
    total = sum(len(b) for b in blocks)
    out = np.zeros((total, total))
    at = 0
    for block in blocks:
        out[at : at + len(block), at : at + len(block)] = block
        at += len(block)
    return out


def _world_field(signals: Signals, theta: FloatArray, memory: Memory, rng: Rng) -> Signals:
    return signals.in_field(signals.stimulus.field_ned_mgauss + theta)


WORLD_FIELD = Effect(
    id="world field",
    title="what the field's model does not know",
    stage=Stage.WORLD,
    parameters=tuple(Parameter(n, "mG", -2000.0, 2000.0, 0.0, 1.0) for n in ("north", "east", "down")),
    forward=_world_field,
)


def turned(signals: Signals, vectors_rad: FloatArray, yaw_rad: float = 0.0) -> Signals:
    """Turn the believed attitude by rotation vectors in world axes (N, 3), and then about the vertical."""
    s = signals.stimulus
    rotation = rotvec_to_matrix(vectors_rad) @ s.rotation
    if yaw_rad != 0.0:
        rotation = euler_to_matrix(0.0, 0.0, yaw_rad) @ rotation
    change = rotate_back(rotation, s.field_ned_mgauss) - rotate_back(s.rotation, s.field_ned_mgauss)
    moved = Signals(replace(s, rotation=rotation), signals.reading)
    return moved.with_mag(signals.reading.mag_mgauss + change)


def reference_attitude_error(curves_rad: FloatArray, with_yaw: FloatArray | None = None) -> Effect:
    """Build what a reference does not know: a constant of the yaw, and curves (N, 3, k) over time.

    With each radian of the constant other turns go, (N, 3) or (1, 3), if any.
    """
    beside = np.zeros((1, 3)) if with_yaw is None else with_yaw

    flat = curves_rad.reshape(3 * len(curves_rad), curves_rad.shape[2])

    def forward(signals: Signals, theta: FloatArray, memory: Memory, rng: Rng) -> Signals:
        vectors = (flat @ theta[1:]).reshape(-1, 3) + theta[0] * beside
        return turned(signals, vectors, float(theta[0]))

    amplitudes = (Parameter(f"curve {i + 1}", "1", -30.0, 30.0, 0.0, 1.0) for i in range(curves_rad.shape[2]))
    return Effect(
        id=REFERENCE_YAW,
        title="what the attitude reference does not know",
        stage=Stage.ATTITUDE,
        parameters=(Parameter("constant", "rad", -10.0, 10.0, 0.0, 0.01), *amplitudes),
        forward=forward,
    )


def yaw_starts(prior: Prior) -> list[FloatArray]:
    """List where to start a fit that may turn the attitude, (K,) each: from the prior; all around if that is
    wide."""
    if REFERENCE_YAW not in prior.places:
        return [prior.mean]
    constant = prior.places[REFERENCE_YAW].start
    if prior.precision[constant, constant] >= 1.0 / usual.yaw.unknown_rad**2:
        return [prior.mean]
    starts = np.tile(prior.mean, (usual.yaw.starts, 1))
    starts[:, constant] += np.arange(usual.yaw.starts) * 2.0 * np.pi / usual.yaw.starts
    starts[:, constant] = wrap_pi(starts[:, constant])
    return list(starts)


def _telemetry_age(signals: Signals, theta: FloatArray, memory: Memory, rng: Rng) -> Signals:
    return signals.with_mag(late_field(signals, signals.stimulus.time_s - theta[0]))


AGE = Effect(
    id=TELEMETRY_AGE,
    title="how old a reading is when the autopilot reports it, beyond what its time allows for",
    stage=Stage.TIMING,
    parameters=(Parameter("age", "s", -LONGEST_LAG_S, LONGEST_LAG_S, 0.08, 0.005),),
    forward=_telemetry_age,
)


def of_telemetry(late_s: float, every_s: float) -> tuple[Prior, Prior]:
    """Tell what is usual of an autopilot that reads its compass every so many seconds, and reports it late.

    It may average all that the sensor says meanwhile: times then vary by a twelfth of the square, as those of
    a low pass do by the square of its time constant.
    """
    age = Prior.of(AGE, np.array([usual.age.usual_s - late_s]), np.array([usual.age.sigma_s]))
    most_s = every_s / math.sqrt(12.0)
    averaged = Effect(
        id=TELEMETRY_MEAN,
        title="over how long an autopilot averages what it reports",
        stage=Stage.TIMING,
        parameters=(Parameter(SMOOTHING, "s", 0.0, most_s, 0.5 * most_s, 0.005),),
        forward=low_pass,
    )
    return age, Prior.of(averaged, np.array([0.5 * most_s]), np.array([0.5 * most_s]))


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
class KnownIron(Iron):
    """Hold what a calibration says of the raw sensor.

    Attributes:
        correction: the calibration, as the autopilot has it in force.
        load: the motor load at the rows, (N,), zeros where there is none; source: what it is.
        usual_load: what is not known of the motors counts from there, so that the offset stays the offset.
    """

    correction: FieldCorrection
    load: FloatArray
    source: MotorSource = "none"
    usual_load: float = 0.0

    @property
    def calibrated(self) -> bool:
        """Tell a calibration from none."""
        return self.correction != IDENTITY

    def raw(self, field_mgauss: FloatArray, load: FloatArray | None = None) -> FloatArray:
        """Return what the raw sensor says of a field (N, 3) in body axes, under its load or another (N,), if
        the calibration is right."""
        motors = (self.load if load is None else load)[:, None] * self.motor_mgauss
        return field_mgauss @ self.matrix.T + self.offset_mgauss + motors

    def field(self, raw_mgauss: FloatArray) -> FloatArray:
        """Return the field (N, 3) in body axes that the calibration makes of raw readings."""
        free = raw_mgauss - self.offset_mgauss - self.load[:, None] * self.motor_mgauss
        return np.asarray(free @ np.linalg.inv(self.matrix).T)

    def prior(self, trust: Trust) -> Prior:
        """Return the iron as part of the nominal simulation, with what is not known of it."""
        sigma = self.sigma(trust)
        (matrix, offset), sigma, bent = self.effects(), sigma[:3], sigma[3:]
        if self.load.any():
            varies = float(np.ptp(self.load))
            # A load that is always the same tells nothing: its field is part of the offset.
            told = varies > usual.present.load_share * abs(float(self.load.mean()))
            sigma = np.concatenate([sigma, np.full(3, trust.motor_mgauss / varies if told else 1e-6)])
        return Prior.of(matrix, np.zeros(9), bent).beside(Prior.of(offset, np.zeros(sigma.size), sigma))

    def sigma(self, trust: Trust) -> FloatArray:
        """Return how far offsets (3, in mG) and matrix elements (9) may be off, (12,)."""
        offset = trust.offset_mgauss + trust.share * np.abs(self.offset_mgauss)
        cured = float(np.abs(self.matrix - np.eye(3)).max())
        return np.concatenate([offset, np.full(9, trust.matrix + trust.share * cured)])

    def effects(self) -> tuple[Effect, Effect]:
        """Return the matrix, and the offset with the motors' field, by what they are more than known."""
        motors, unusual = self.load[:, None] * self.motor_mgauss, self.load - self.usual_load

        def bent(signals: Signals, theta: FloatArray, memory: Memory, rng: Rng) -> Signals:
            matrix = self.matrix @ (np.eye(3) + theta.reshape(3, 3))
            return signals.with_mag(signals.reading.mag_mgauss @ matrix.T)

        def moved(signals: Signals, theta: FloatArray, memory: Memory, rng: Rng) -> Signals:
            offset = np.asarray(self.offset_mgauss + theta[:3])
            if theta.size > 3:
                offset = offset + motors + unusual[:, None] * theta[3:]
            return signals.with_mag(signals.reading.mag_mgauss + offset)

        entries = tuple(Parameter(n, "1", -0.9, 0.9, 0.0, 0.01) for n in _ENTRIES)
        shifts = tuple(Parameter(n, "mG", -2000.0, 2000.0, 0.0, 10.0) for n in "xyz")
        if self.load.any():
            shifts += tuple(Parameter(f"motor_{n}", "mG", -2000.0, 2000.0, 0.0, 1.0) for n in "xyz")
        return (
            Effect(IRON_MATRIX, "the matrix that is cured", Stage.MATRIX, entries, bent, affine=True),
            Effect(IRON_OFFSET, "the offset that is cured", Stage.FIELD, shifts, moved),
        )


def known_iron(correction: FieldCorrection, load: FloatArray, source: MotorSource) -> KnownIron:
    """Read a calibration backwards; `load` (N,) is the motor load that its motor term goes with."""
    matrix = correction.inverse
    motor = np.asarray(-matrix @ np.asarray(correction.motor_mgauss), dtype=np.float64)
    usually = float(load.mean()) if load.size else 0.0
    return KnownIron(matrix, -np.asarray(correction.offsets_mgauss), motor, correction, load, source, usually)


def load_of(
    source: MotorSource, current_a: FloatArray, throttle: FloatArray
) -> tuple[FloatArray, MotorSource]:
    """Return the load that a motor term goes with, (N,), and which: the current where it has none."""
    if source == "throttle" or not np.isfinite(current_a).any():
        return np.nan_to_num(throttle), "throttle"
    return np.nan_to_num(current_a), "current"
