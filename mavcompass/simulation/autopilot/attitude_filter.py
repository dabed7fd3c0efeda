"""The flight controller's own opinion of its attitude, which a bad compass bends.

Yaw is carried by the gyro and pulled to the compass selected at power-up, slowly and with a bounded
pull, as a filter does whose field and bias states share the blame. The constants follow recordings of
real firmware: with a compass 30 to 60 degrees off the yaw creeps by 1.7 to 3 degrees per second, a
small disagreement is worked off over ten seconds, and a part of it goes into the gyro's bias.
"""

from __future__ import annotations

import math

from mavcompass.correction import Vector
from mavcompass.simulation.physics.noise import NoiseTape, generator
from mavcompass.units import RAD_PER_DEG, STANDARD_GRAVITY_MPS2

YAW_PULL_PER_S = 0.08
YAW_PULL_MAX_RADPS = 1.8 * RAD_PER_DEG
BIAS_PULL_PER_S2 = 0.0015
BIAS_MAX_RADPS = 0.5 * RAD_PER_DEG
_TILT_ERROR_SIGMA_RAD = 0.1 * RAD_PER_DEG
_TILT_ERROR_TIME_S = 40.0
# A yaw that is off turns the acceleration that the filter holds against its velocities.
_TILT_BEND_TIME_S = 10.0
# What is told as the compass's variance is the disagreement in units of three sigmas of the yaw noise.
_VARIANCE_SCALE_RAD = 3.0 * 0.5
# After a yaw was taken over the gyro's bias is blamed for little, and fully after so long.
_BLAME_TIME_S = 40.0
_VARIANCE_TIME_S = 2.0


def wrap_angle(angle_rad: float) -> float:
    """Bring one angle into [-pi, pi)."""
    return (angle_rad + math.pi) % (2.0 * math.pi) - math.pi


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
        self._blame = 1.0

    def align(self, roll_rad: float, pitch_rad: float, compass_yaw_rad: float | None) -> None:
        """Take over the compass's yaw at once, as at power-up; north where there is none."""
        self._tilt(roll_rad, pitch_rad)
        if compass_yaw_rad is None or not math.isfinite(compass_yaw_rad):
            compass_yaw_rad = 0.0
        self.yaw_rad = compass_yaw_rad
        self.bias_radps = 0.0
        self.innovation_rad = 0.0

    def take_yaw(self, yaw_rad: float) -> None:
        """Take a yaw over at once; the bias stays as it has been learnt."""
        self.yaw_rad, self.innovation_rad, self._blame = yaw_rad, 0.0, 0.0

    def predict(
        self,
        dt_s: float,
        gyro: Vector,
        true: tuple[float, float, float],
        acceleration_mps2: tuple[float, float],
    ) -> None:
        """Carry the attitude on with the gyro.

        Tilt is observed well by gravity and GPS, but for what a wrong yaw makes of the acceleration (ahead
        and to the right). `true` is roll, pitch and yaw.
        """
        roll, pitch, yaw = true
        ahead, right = acceleration_mps2
        off = self.yaw_rad - yaw
        c, s = math.cos(off) - 1.0, math.sin(off)
        b, share = self._tilt_bend, dt_s / _TILT_BEND_TIME_S
        b[0] += share * ((right * c - ahead * s) / STANDARD_GRAVITY_MPS2 - b[0])
        b[1] += share * (-(ahead * c + right * s) / STANDARD_GRAVITY_MPS2 - b[1])
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

    def correct(self, dt_s: float, compass_yaw_rad: float | None) -> None:
        """Be pulled towards the compass's yaw; None or nan where there is no compass to believe."""
        if compass_yaw_rad is None or not math.isfinite(compass_yaw_rad):
            self.innovation_rad = self.compass_variance = 0.0
        else:
            self.innovation_rad = wrap_angle(compass_yaw_rad - self.yaw_rad)
        limit = YAW_PULL_MAX_RADPS / YAW_PULL_PER_S
        pull = max(-limit, min(limit, self.innovation_rad))
        self.yaw_rad = wrap_angle(self.yaw_rad + YAW_PULL_PER_S * pull * dt_s)
        self._blame = min(1.0, self._blame + dt_s / _BLAME_TIME_S)
        bias = self.bias_radps - BIAS_PULL_PER_S2 * self._blame * pull * dt_s
        self.bias_radps = max(-BIAS_MAX_RADPS, min(BIAS_MAX_RADPS, bias))
        target = abs(self.innovation_rad) / _VARIANCE_SCALE_RAD
        self.compass_variance += (target - self.compass_variance) * dt_s / _VARIANCE_TIME_S

    def _tilt(self, roll_rad: float, pitch_rad: float) -> None:
        self.roll_rad = roll_rad + self._tilt_error[0] + self._tilt_bend[0]
        self.pitch_rad = pitch_rad + self._tilt_error[1] + self._tilt_bend[1]
