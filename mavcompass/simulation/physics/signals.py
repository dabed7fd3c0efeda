"""What reaches a sensor, and what it says: the two ends of every sensor model and effect.

Arrays carry the samples in the first axis; a live simulation passes arrays of one sample, the
replay of a recording passes all of it at once, so both use the same models.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from mavcompass.frames import FloatArray, rotate, rotate_back
from mavcompass.units import STANDARD_GRAVITY_MPS2


@dataclass(frozen=True, slots=True, eq=False)
class Stimulus:
    """Hold the true state of the world at the sensors, N samples.

    Attributes:
        time_s: (N,), seconds.
        rotation: body-to-NED rotation matrices, (N, 3, 3).
        field_ned_mgauss: the Earth's field at the vehicle, (N, 3).
        rate_radps: body angular rate, (N, 3); specific_force_mps2: body specific force, (N, 3).
        position_ned_m: (N, 3); velocity_ned_mps: (N, 3).
        current_a: battery current, (N,); throttle: 0..1, (N,); temperature_degc: (N,).
        motors: outputs 0..1, where motors reverse -1..1, (N, k).
    """

    time_s: FloatArray
    rotation: FloatArray
    field_ned_mgauss: FloatArray
    rate_radps: FloatArray
    specific_force_mps2: FloatArray
    position_ned_m: FloatArray
    velocity_ned_mps: FloatArray
    current_a: FloatArray
    throttle: FloatArray
    temperature_degc: FloatArray
    motors: FloatArray

    @classmethod
    def posed(
        cls, time_s: FloatArray, rotation: FloatArray, field_ned_mgauss: FloatArray, **given: FloatArray
    ) -> Stimulus:
        """Hold attitudes (N, 3, 3) in a field, (3,) or (N, 3), at rest and idle but for what is `given`."""
        n = len(time_s)
        none, idle, force = np.zeros((n, 3)), np.zeros(n), rotation[:, 2, :] * -STANDARD_GRAVITY_MPS2
        field = np.broadcast_to(field_ned_mgauss, (n, 3))
        rest = cls(time_s, rotation, field, none, force, none, none, idle, idle, idle, none[:, :0])
        return replace(rest, **given)

    @property
    def loads(self) -> dict[str, FloatArray]:
        """Return what the whole vehicle is loaded with, by name, (N,) each."""
        return {"current": self.current_a, "throttle": self.throttle, "temperature": self.temperature_degc}


@dataclass(frozen=True, slots=True, eq=False)
class Turning:
    """Hold how a vehicle turns: body-to-NED rotation matrices (M, 3, 3) and angular rates (M, 3).

    `at_samples` are the rotation matrices at the samples of a stimulus, (N, 3, 3), where these are others.
    """

    time_s: FloatArray
    rotation: FloatArray
    rate_radps: FloatArray
    at_samples: FloatArray


@dataclass(frozen=True, slots=True, eq=False)
class RecordedStimulus(Stimulus):
    """Hold the state of the world at samples of a recording, and how its vehicle turned between them."""

    turning: Turning


@dataclass(frozen=True, slots=True, eq=False)
class Reading:
    """Hold what magnetometer, accelerometer and gyro say, body FRD, raw, each (N, 3)."""

    mag_mgauss: FloatArray
    acc_mps2: FloatArray
    gyro_radps: FloatArray


def ideal(stimulus: Stimulus) -> Reading:
    """Return what perfect sensors say."""
    field = rotate_back(stimulus.rotation, stimulus.field_ned_mgauss)
    return Reading(field, stimulus.specific_force_mps2, stimulus.rate_radps)


@dataclass(frozen=True, slots=True, eq=False)
class Signals:
    """Hold what reaches the sensors and what they say of it, N samples."""

    stimulus: Stimulus
    reading: Reading

    def with_mag(self, mag_mgauss: FloatArray) -> Signals:
        """Replace what the magnetometer says."""
        r = self.reading
        return Signals(self.stimulus, Reading(mag_mgauss, r.acc_mps2, r.gyro_radps))

    def with_acc(self, acc_mps2: FloatArray) -> Signals:
        """Replace what the accelerometer says."""
        r = self.reading
        return Signals(self.stimulus, Reading(r.mag_mgauss, acc_mps2, r.gyro_radps))

    def with_gyro(self, gyro_radps: FloatArray) -> Signals:
        """Replace what the gyro says."""
        r = self.reading
        return Signals(self.stimulus, Reading(r.mag_mgauss, r.acc_mps2, gyro_radps))

    def in_field(self, field_ned_mgauss: FloatArray) -> Signals:
        """Put the vehicle into another world field, (N, 3)."""
        s = self.stimulus
        change = rotate_back(s.rotation, field_ned_mgauss - s.field_ned_mgauss)
        moved = replace(s, field_ned_mgauss=field_ned_mgauss)
        return Signals(moved, self.reading).with_mag(self.reading.mag_mgauss + change)

    def turned(self, rotation: FloatArray, rate_radps: FloatArray) -> Signals:
        """Give the vehicle another attitude (N, 3, 3) and rate (N, 3) under the same forces."""
        s, r = self.stimulus, self.reading
        force_ned = rotate(s.rotation, s.specific_force_mps2)
        force = rotate_back(rotation, force_ned)
        mag_change = rotate_back(rotation, s.field_ned_mgauss) - rotate_back(s.rotation, s.field_ned_mgauss)
        moved = replace(s, rotation=rotation, rate_radps=rate_radps, specific_force_mps2=force)
        return Signals(
            moved,
            Reading(
                r.mag_mgauss + mag_change,
                r.acc_mps2 + (force - s.specific_force_mps2),
                r.gyro_radps + (rate_radps - s.rate_radps),
            ),
        )
