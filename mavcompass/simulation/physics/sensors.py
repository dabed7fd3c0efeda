"""The simulated sensors: gyros and accelerometers, and compasses with iron around them.

A compass sits in hard and soft iron and reads `raw = M^-1 field - offsets`: its `iron` is the
FieldCorrection that cures it exactly. The flight controller reads it as firmware does: at 10 Hz, the
average of the last 100 ms, so the value lags a turning vehicle by 0.05 to 0.15 s and repeats in
faster streams.

Further physical effects come in as `Distortion`s. They act on the first compass and the first IMU.

The compasses that a vehicle comes with are drawn by seed, under an old, wrong calibration.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Collection, Sequence
from dataclasses import dataclass, replace
from typing import Literal, NamedTuple, Protocol

import numpy as np

from mavcompass.correction import IDENTITY, FieldCorrection, Vector
from mavcompass.frames import FloatArray
from mavcompass.simulation.physics.motion import Body, times
from mavcompass.simulation.physics.noise import NoiseTape, generator
from mavcompass.simulation.physics.signals import Reading, Signals, Stimulus
from mavcompass.units import MPS2_PER_MILLI_G, RAD_PER_DEG

COMPASS_PERIOD_US = 100_000
_COMPASS_SAMPLE_S = 0.01
_ZERO: Vector = (0.0, 0.0, 0.0)

# A MEMS gyro after the calibration at power-up: what is left of its bias, its drift and noise behind
# the autopilot's low-pass filter; the same for the accelerometer.
GYRO_BIAS_SIGMA_RADPS = 0.04 * RAD_PER_DEG
GYRO_DRIFT_RADPS_PER_SQRT_S = 0.0008 * RAD_PER_DEG
GYRO_NOISE_RADPS = 0.04 * RAD_PER_DEG
GYRO_SCALE_SIGMA = 0.002
ACCELEROMETER_BIAS_SIGMA_MPS2 = 1.0 * MPS2_PER_MILLI_G
ACCELEROMETER_NOISE_MPS2 = 1.5 * MPS2_PER_MILLI_G


class Distortion(Protocol):
    """Be a physical effect between the world and what the sensors say."""

    @property
    def groups(self) -> Collection[str]:
        """Name the sensors that it changes: "mag", "acc", "gyro"."""
        ...

    def run(self, signals: Signals, rng: np.random.Generator) -> Signals:
        """Return N samples distorted, which follow those of the last call."""
        ...


@dataclass(frozen=True, slots=True)
class CompassModel:
    """Describe one compass: its iron's exact cure, and its noise per sample at 100 Hz."""

    iron: FieldCorrection = IDENTITY
    noise_mgauss: float = 3.0


class ImuSample(NamedTuple):
    """Hold what one IMU says."""

    gyro_radps: Vector
    acc_mps2: Vector


class Compass:
    """Be one compass: average the field over 100 ms, add iron and noise."""

    def __init__(self, model: CompassModel, seed: int, instance: int) -> None:
        self.model = model
        inverse = np.linalg.inv(model.iron.matrix)
        self._matrix: tuple[float, ...] = tuple(inverse.ravel().tolist())
        self._offsets = model.iron.offsets_mgauss
        self._tape = NoiseTape(generator(seed, f"compass {instance}"), 3)
        self.raw_mgauss: Vector = _ZERO

    def sense(self, field: Vector) -> Vector:
        """Return the noiseless raw reading of a field in body axes."""
        (x, y, z), o = times(self._matrix, field), self._offsets
        return x - o[0], y - o[1], z - o[2]

    def add_noise(self, raw: Vector, averaging_s: float) -> Vector:
        """Return a reading with the noise of an average over some time."""
        sigma = self.model.noise_mgauss * math.sqrt(_COMPASS_SAMPLE_S / averaging_s)
        n = self._tape.row()
        return raw[0] + sigma * n[0], raw[1] + sigma * n[1], raw[2] + sigma * n[2]


class Imu:
    """Be one gyro and accelerometer with bias, scale error, drift and noise."""

    def __init__(self, seed: int, instance: int, vibration_mps2: float) -> None:
        rng = generator(seed, f"imu {instance}")
        self.gyro_bias_radps: list[float] = (GYRO_BIAS_SIGMA_RADPS * rng.standard_normal(3)).tolist()
        self.gyro_scale = 1.0 + GYRO_SCALE_SIGMA * float(rng.standard_normal())
        self.acc_bias_mps2: list[float] = (ACCELEROMETER_BIAS_SIGMA_MPS2 * rng.standard_normal(3)).tolist()
        self._vibration_mps2 = vibration_mps2
        self._tape = NoiseTape(rng, 9)

    def sample(self, body: Body, dt_s: float) -> ImuSample:
        """Read the sensor once."""
        n, b, a, k = self._tape.row(), self.gyro_bias_radps, self.acc_bias_mps2, self.gyro_scale
        drift = GYRO_DRIFT_RADPS_PER_SQRT_S * math.sqrt(dt_s)
        for i in range(3):
            b[i] += drift * n[6 + i]
        (p, q, r), (x, y, z) = body.rate_radps, body.specific_force_mps2
        s = GYRO_NOISE_RADPS
        e = ACCELEROMETER_NOISE_MPS2 + self._vibration_mps2 * body.shaking
        return ImuSample(
            (k * p + b[0] + s * n[0], k * q + b[1] + s * n[1], k * r + b[2] + s * n[2]),
            (x + a[0] + e * n[3], y + a[1] + e * n[4], z + a[2] + e * n[5]),
        )


class Surroundings(NamedTuple):
    """Hold what else acts on the sensors at one moment."""

    current_a: float
    throttle: float
    temperature_degc: float
    motors: tuple[float, ...]


class SensorSuite:
    """Read all sensors of a vehicle, tick by tick."""

    def __init__(
        self,
        models: Sequence[CompassModel],
        distortions: Sequence[Distortion],
        seed: int,
        tick_s: float,
        vibration_mps2: float,
    ) -> None:
        self.compasses = [Compass(m, seed, i) for i, m in enumerate(models, start=1)]
        self.imus = [Imu(seed, i, vibration_mps2) for i in (1, 2)]
        self.samples: list[ImuSample] = [ImuSample(_ZERO, _ZERO), ImuSample(_ZERO, _ZERO)]
        self.previous = self.samples
        self.distortions = tuple(distortions)
        # What only the compass feels can wait for the end of its averaging period.
        self._at_once = any(set(d.groups) - {"mag"} for d in self.distortions)
        self._rng = generator(seed, "effects")
        self._tick_s = tick_s
        self._field_sum = [0.0, 0.0, 0.0]
        self._distorted_sum = [0.0, 0.0, 0.0]
        self._count = 0
        self._waiting: list[tuple[tuple[object, ...], Vector, ImuSample]] = []

    def tick(self, body: Body, surroundings: Callable[[], Surroundings]) -> None:
        """Take one sample of everything at the body's present state."""
        first, second = self.imus
        self.previous = self.samples
        self.samples = [first.sample(body, self._tick_s), second.sample(body, self._tick_s)]
        field = field_in_body(body)
        for i in range(3):
            self._field_sum[i] += field[i]
        self._count += 1
        if self.distortions:
            compass = self.compasses[0]
            raw = compass.add_noise(compass.sense(field), self._tick_s)
            self._waiting.append((moment_of(body, surroundings()), raw, self.samples[0]))
            if self._at_once:
                self._distort()

    def read_compasses(self) -> None:
        """Finish an averaging period: bring every compass's `raw_mgauss` up to date."""
        n, period = self._count, COMPASS_PERIOD_US * 1e-6
        if not n:
            return
        if self._waiting:
            self._distort()
        mean = (self._field_sum[0] / n, self._field_sum[1] / n, self._field_sum[2] / n)
        for i, compass in enumerate(self.compasses):
            if i == 0 and self.distortions:
                d = self._distorted_sum
                compass.raw_mgauss = (d[0] / n, d[1] / n, d[2] / n)
            else:
                compass.raw_mgauss = compass.add_noise(compass.sense(mean), period)
        self._field_sum = [0.0, 0.0, 0.0]
        self._distorted_sum = [0.0, 0.0, 0.0]
        self._count = 0

    def _distort(self) -> None:
        """Pass the waiting moments through the effects."""
        moments, raw, imu = zip(*self._waiting, strict=True)
        self._waiting.clear()
        time_s, rotation, *others = (np.array(column) for column in zip(*moments, strict=True))
        stimulus = Stimulus(time_s, rotation.reshape(-1, 3, 3), *others)
        acc, gyro = np.array([i.acc_mps2 for i in imu]), np.array([i.gyro_radps for i in imu])
        signals = Signals(stimulus, Reading(np.array(raw), acc, gyro))
        for distortion in self.distortions:
            signals = distortion.run(signals, self._rng)
        reading = signals.reading
        for i, value in enumerate(reading.mag_mgauss.sum(axis=0).tolist()):
            self._distorted_sum[i] += value
        if self._at_once:
            (gx, gy, gz), (ax, ay, az) = reading.gyro_radps[-1].tolist(), reading.acc_mps2[-1].tolist()
            self.samples[0] = ImuSample((gx, gy, gz), (ax, ay, az))


def field_in_body(body: Body) -> Vector:
    """Return the Earth's field in the body's axes."""
    m, (n, e, d) = body.rotation, body.world.field_ned_mgauss
    return (
        m[0] * n + m[3] * e + m[6] * d,
        m[1] * n + m[4] * e + m[7] * d,
        m[2] * n + m[5] * e + m[8] * d,
    )


def moment_of(body: Body, around: Surroundings) -> tuple[object, ...]:
    """Note down a body's present state and surroundings as plain numbers, in the order of `Stimulus`."""
    return (
        body.time_s,
        body.rotation,
        body.world.field_ned_mgauss,
        body.rate_radps,
        body.specific_force_mps2,
        (body.north_m, body.east_m, -body.height_m),
        body.velocity_ned_mps,
        around.current_a,
        around.throttle,
        around.temperature_degc,
        around.motors,
    )


@dataclass(frozen=True, slots=True, eq=False)
class Truth:
    """Hold the true state at one moment.

    Attributes:
        rotation: body to NED, (3, 3); roll_rad, pitch_rad, yaw_rad: the same as angles.
        position_ned_m: relative to the start; field_ned_mgauss: the Earth's field there.
    """

    time_s: float
    rotation: FloatArray
    roll_rad: float
    pitch_rad: float
    yaw_rad: float
    yaw_rate_radps: float
    position_ned_m: Vector
    velocity_ned_mps: Vector
    field_ned_mgauss: Vector
    declination_rad: float
    current_a: float
    temperature_degc: float


def truth_of(body: Body, around: Surroundings, time_s: float) -> Truth:
    """Read the true state off a body and its surroundings."""
    return Truth(
        time_s=time_s,
        rotation=np.array(body.rotation).reshape(3, 3),
        roll_rad=body.roll_rad,
        pitch_rad=body.pitch_rad,
        yaw_rad=body.yaw_rad,
        yaw_rate_radps=body.yaw_rate_radps,
        position_ned_m=(body.north_m, body.east_m, -body.height_m),
        velocity_ned_mps=body.velocity_ned_mps,
        field_ned_mgauss=body.world.field_ned_mgauss,
        declination_rad=body.world.declination_rad,
        current_a=around.current_a,
        temperature_degc=around.temperature_degc,
    )


Calibration = Literal["old", "exact"]

# Noise per 100 Hz sample: an HMC5883L-class, an IST8310-class and a better compass.
_NOISE_MGAUSS = (2.5, 3.0, 1.5)


@dataclass(frozen=True, slots=True)
class CompassSetup:
    """Hold a compass and the calibration that is in force at the start."""

    model: CompassModel
    in_force: FieldCorrection


def _vector(values: np.ndarray) -> Vector:
    x, y, z = values.tolist()
    return (x, y, z)


def _iron(rng: np.random.Generator, hard_mgauss: float) -> FieldCorrection:
    direction = rng.standard_normal(3)
    direction[2] *= 0.6
    offsets = hard_mgauss * direction / math.hypot(*direction)
    return FieldCorrection(
        offsets_mgauss=_vector(offsets),
        diagonals=_vector(1.0 + rng.uniform(-0.08, 0.08, 3) * (1.0, 1.0, 0.4)),
        off_diagonals=_vector(rng.uniform(-0.03, 0.03, 3) * (1.0, 0.5, 0.5)),
    )


def draw_compasses(seed: int, horizontal_mgauss: float, calibration: Calibration) -> tuple[CompassSetup, ...]:
    """Draw three compasses.

    The first has been calibrated once, before something of iron was moved: its calibration is wrong
    by 0.5 to 0.75 of the horizontal field, which bends headings by 20 to 30 degrees rms. The other
    two are calibrated as well as people do (a few degrees). "exact" sets all three exactly right.
    """
    setups = []
    for index, noise in enumerate(_NOISE_MGAUSS):
        rng = generator(seed, f"iron {index + 1}")
        iron = _iron(rng, hard_mgauss=rng.uniform(60.0, 240.0))
        in_force = iron
        if calibration == "old":
            wrong = rng.uniform(0.5, 0.75) if index == 0 else rng.uniform(0.02, 0.06)
            heading = rng.uniform(0.0, 2.0 * math.pi)
            moved = wrong * horizontal_mgauss * np.array([math.cos(heading), math.sin(heading), 0.0])
            moved[2] = rng.uniform(-40.0, 40.0) * (1.0 if index == 0 else 0.2)
            in_force = replace(iron, offsets_mgauss=_vector(np.add(iron.offsets_mgauss, moved)))
            if index == 0:
                in_force = replace(in_force, diagonals=(1.0, 1.0, 1.0), off_diagonals=(0.0, 0.0, 0.0))
        setups.append(CompassSetup(CompassModel(iron, noise), in_force))
    return tuple(setups)
