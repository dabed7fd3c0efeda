"""The flight controller's own opinion of its attitude, which a bad compass bends.

Yaw is carried by the gyro and pulled to the compass selected at power-up, slowly and with a bounded
pull, as a filter does whose field and bias states share the blame. The constants follow recordings of
real firmware: with a compass 30 to 60 degrees off the yaw creeps by 1.7 to 3 degrees per second, a
small disagreement is worked off over ten seconds, and a part of it goes into the gyro's bias. In flight
another part goes into the direction that the Earth's field is believed to have, which new offsets leave.
"""

from __future__ import annotations

import math

from mavcompass.correction import Vector
from mavcompass.frames import wrap_angle
from mavcompass.simulation.physics.noise import NoiseTape, generator
from mavcompass.units import RAD_PER_DEG, STANDARD_GRAVITY_MPS2

# The noises of a Kalman filter of yaw and gyro bias: a reading's (0.05 of 0.2 gauss across), and per root
# of a second the yaw's and the bias's. As shipped its gains come to 0.08 and 0.0015 per second.
_READING_RAD, _YAW_RAD, _BIAS_RADPS = 0.25, 0.0046, 1.2e-4
# The variances of yaw and bias, and what they share, that it then settles at, read ten times a second.
_STEADY = (5.0e-4, -9.4e-6, 7.5e-7)
# What a resting gyro tells, per root of a second (EKF2_GYR_NOISE, five times a second).
_GYRO_RADPS = 0.015 * math.sqrt(0.2)
# The gains hold for what a reading is off by up to this.
_INNOVATION_MAX_RAD = 22.5 * RAD_PER_DEG
BIAS_MAX_RADPS = 0.5 * RAD_PER_DEG
# A filter that learns the field puts so much of a disagreement per second there, and forgets it in so long,
# as it holds the field against the declination: a copter of ArduPilot 4.5.7 was 5 to 7 degrees off for half
# a minute after its compass had become right, and 3 after a minute.
_FIELD_PULL_PER_S, _FIELD_FORGOTTEN_S = 0.02, 60.0
_TILT_ERROR_SIGMA_RAD = 0.1 * RAD_PER_DEG
_TILT_ERROR_TIME_S = 40.0
# A yaw that is off turns the acceleration that the filter holds against its velocities.
_TILT_BEND_TIME_S = 10.0
# What is told as the compass's variance is the disagreement in units of three sigmas of the yaw noise.
_VARIANCE_SCALE_RAD = 3.0 * 0.5
_VARIANCE_TIME_S = 2.0


def compass_yaw(field: Vector, roll_rad: float, pitch_rad: float, declination_rad: float) -> float:
    """Return the true heading that a field in body axes gives at a tilt."""
    sr, cr, sp, cp = math.sin(roll_rad), math.cos(roll_rad), math.sin(pitch_rad), math.cos(pitch_rad)
    ahead = field[0] * cp + (field[1] * sr + field[2] * cr) * sp
    right = field[1] * cr - field[2] * sr
    return wrap_angle(math.atan2(-right, ahead) + declination_rad)


class AttitudeFilter:
    """Estimate roll, pitch, yaw and the yaw gyro's bias."""

    def __init__(self, seed: int) -> None:
        self._seed = seed
        self.restart(0)

    def restart(self, boot: int) -> None:
        """Forget everything, as at a power-up; every one has noise of its own."""
        self._tape = NoiseTape(generator(self._seed, f"attitude filter {boot}"), 2)
        start = self._tape.row()
        self._tilt_error = [_TILT_ERROR_SIGMA_RAD * start[0], _TILT_ERROR_SIGMA_RAD * start[1]]
        self._tilt_bend = [0.0, 0.0]
        self.roll_rad = self.pitch_rad = self.yaw_rad = 0.0
        self.rate_radps: Vector = (0.0, 0.0, 0.0)
        self.bias_radps = 0.0
        self.innovation_rad = 0.0
        self.compass_variance = 0.0
        self.learnt_rad = 0.0
        self._doubt = _STEADY

    def align(self, roll_rad: float, pitch_rad: float, compass_yaw_rad: float | None) -> None:
        """Take over the compass's yaw at once, as at power-up; north where there is none."""
        self._tilt(roll_rad, pitch_rad)
        if compass_yaw_rad is None or not math.isfinite(compass_yaw_rad):
            compass_yaw_rad = 0.0
        self.yaw_rad = compass_yaw_rad
        self.bias_radps = 0.0
        self.innovation_rad = 0.0

    def take_yaw(self, yaw_rad: float) -> None:
        """Take a yaw over at once; the bias stays as it was learnt, and is blamed for little at first."""
        self.yaw_rad, self.innovation_rad = yaw_rad, 0.0
        self._doubt = (_STEADY[0], 0.0, self._doubt[2])

    def predict(
        self,
        dt_s: float,
        gyro: Vector,
        true: tuple[float, float, float],
        acceleration_mps2: tuple[float, float],
        accelerometer_mps2: tuple[float, float] = (0.0, 0.0),
    ) -> None:
        """Carry the attitude on with the gyro.

        Tilt is observed well by gravity and GPS, but for what a wrong yaw makes of the acceleration (ahead
        and to the right), and what the accelerometer is off by (along body x and y), which looks like a lean.
        `true` is roll, pitch and yaw.
        """
        roll, pitch, yaw = true
        ahead, right = acceleration_mps2
        off = self.yaw_rad - yaw
        c, s = math.cos(off) - 1.0, math.sin(off)
        b, share = self._tilt_bend, dt_s / _TILT_BEND_TIME_S
        x, y = accelerometer_mps2
        b[0] += share * ((right * c - ahead * s - y) / STANDARD_GRAVITY_MPS2 - b[0])
        b[1] += share * ((x - ahead * c - right * s) / STANDARD_GRAVITY_MPS2 - b[1])
        n = self._tape.row()
        keep = 1.0 - dt_s / _TILT_ERROR_TIME_S
        push = _TILT_ERROR_SIGMA_RAD * math.sqrt(2.0 * dt_s / _TILT_ERROR_TIME_S)
        e = self._tilt_error
        e[0], e[1] = e[0] * keep + push * n[0], e[1] * keep + push * n[1]
        self._tilt(roll, pitch)
        p, q, r = gyro[0], gyro[1], gyro[2] - self.bias_radps
        self.rate_radps = (p, q, r)
        yaw_rate = (q * math.sin(self.roll_rad) + r * math.cos(self.roll_rad)) / math.cos(self.pitch_rad)
        self.yaw_rad = wrap_angle(self.yaw_rad + yaw_rate * dt_s)

    def correct(
        self,
        dt_s: float,
        compass_yaw_rad: float | None,
        learns_within_rad: float = 0.0,
        surer: float = 1.0,
        wandering: float = 1.0,
    ) -> None:
        """Be pulled towards the compass's yaw; None or nan where there is no compass to believe.

        The direction of the Earth's field is learnt, within an angle. A reading's noise is as shipped over
        `surer`, that of the gyro's bias `wandering` times as much.
        """
        yaw_gain = bias_gain = 0.0
        self.learnt_rad = max(-learns_within_rad, min(learns_within_rad, self.learnt_rad))
        if compass_yaw_rad is None or not math.isfinite(compass_yaw_rad):
            self.innovation_rad = self.compass_variance = 0.0
        else:
            self.innovation_rad = wrap_angle(compass_yaw_rad + self.learnt_rad - self.yaw_rad)
            yaw_gain, bias_gain = self._gains(dt_s, _READING_RAD / surer, wandering * _BIAS_RADPS)
        pull = max(-_INNOVATION_MAX_RAD, min(_INNOVATION_MAX_RAD, self.innovation_rad))
        self.yaw_rad = wrap_angle(self.yaw_rad + yaw_gain * pull)
        self.learnt_rad -= (_FIELD_PULL_PER_S * pull + self.learnt_rad / _FIELD_FORGOTTEN_S) * dt_s
        bias = self.bias_radps + bias_gain * pull
        self.bias_radps = max(-BIAS_MAX_RADPS, min(BIAS_MAX_RADPS, bias))
        target = abs(self.innovation_rad) / _VARIANCE_SCALE_RAD
        self.compass_variance += (target - self.compass_variance) * dt_s / _VARIANCE_TIME_S

    def rest(self, dt_s: float, rate_radps: float) -> None:
        """Learn the bias from a vehicle that is known to stand: what its gyro tells is all bias."""
        yaw, both, bias = self._doubt
        gain = bias * dt_s / _GYRO_RADPS**2
        self.bias_radps += gain * (rate_radps - self.bias_radps)
        self._doubt = (yaw, both * (1.0 - gain), bias * (1.0 - gain))

    def _gains(self, dt_s: float, reading_rad: float, bias_radps: float) -> tuple[float, float]:
        """Carry the doubt of yaw and bias over a step and a reading; return the reading's gains."""
        yaw, both, bias = self._doubt
        yaw += dt_s * (_YAW_RAD**2 - 2.0 * both + dt_s * bias)
        both, bias = both - dt_s * bias, bias + dt_s * bias_radps**2
        variance = yaw + reading_rad**2
        yaw_gain, bias_gain = yaw / variance, both / variance
        self._doubt = (yaw * (1.0 - yaw_gain), both * (1.0 - yaw_gain), bias - bias_gain * both)
        return yaw_gain, bias_gain

    def _tilt(self, roll_rad: float, pitch_rad: float) -> None:
        self.roll_rad = roll_rad + self._tilt_error[0] + self._tilt_bend[0]
        self.pitch_rad = pitch_rad + self._tilt_error[1] + self._tilt_bend[1]
