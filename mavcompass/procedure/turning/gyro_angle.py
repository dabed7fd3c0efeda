"""How far the vehicle has turned, live, by its gyro: what steers and proves every turn.

The autopilot's yaw is not used: it comes from the compass under test.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field

from mavcompass import messages as mav
from mavcompass.messages.telemetry import acceleration_mps2, angular_rate_radps, imu_time_s

# Longer silences are not bridged: the turn in them is unknown.
_LONGEST_GAP_S = 1.0
_GRAVITY_TIME_S = 0.5


@dataclass(slots=True)
class GyroAngle:
    """Integrate the rate of turn about the vertical; `hear` is a listener of a Context.

    Attributes:
        angle_rad: turned since the start, clockwise seen from above is positive.
        rate_radps: the latest rate about the vertical, bias taken out.
        bias_radps: what the gyro says at rest; set by `note_rest`.
        broken_s: vehicle time up to which, last, a turn was not heard; -inf where there was no such silence.
        samples: IMU messages heard.
    """

    angle_rad: float = 0.0
    rate_radps: float = 0.0
    bias_radps: float = 0.0
    broken_s: float = -math.inf
    samples: int = 0
    latest_s: float = -math.inf
    _down: tuple[float, float, float] = (0.0, 0.0, 1.0)
    _source: type[mav.Message] | None = field(default=None)

    @property
    def tilt_rad(self) -> float:
        """Return how far the vehicle's own down is from the vertical."""
        return math.acos(max(-1.0, min(1.0, self._down[2])))

    def hear(self, heard: mav.Incoming) -> None:
        """Take one message; only one kind of IMU message is listened to."""
        message = heard.message
        if type(message) not in (mav.RawImu, mav.ScaledImu):
            return
        if self._source is None:
            self._source = type(message)
        if type(message) is not self._source:
            return
        time_s = float(imu_time_s(message))
        step_s = time_s - self.latest_s
        if step_s <= 0.0:
            return  # late or twice
        raw_rate = self._rate_about_vertical(message, step_s)
        rate = raw_rate - self.bias_radps
        if math.isfinite(step_s):
            if step_s <= _LONGEST_GAP_S:
                self.angle_rad += 0.5 * (rate + self.rate_radps) * step_s
            else:
                self.broken_s = time_s
        self.rate_radps, self.latest_s = rate, time_s
        self.samples += 1

    def note_rest(self, bias_radps: float) -> None:
        """Set the bias found while the vehicle stood still."""
        self.bias_radps = bias_radps

    def _rate_about_vertical(self, message: mav.Message, step_s: float) -> float:
        ax, ay, az = acceleration_mps2(message).tolist()
        norm = math.sqrt(ax * ax + ay * ay + az * az)
        if norm > 1.0:
            # At rest the accelerometer points up; a slow average keeps it there while moving.
            blend = min(1.0, step_s / _GRAVITY_TIME_S)
            down = [d + blend * (-a / norm - d) for d, a in zip(self._down, (ax, ay, az), strict=True)]
            length = math.sqrt(sum(d * d for d in down)) or 1.0
            self._down = (down[0] / length, down[1] / length, down[2] / length)
        wx, wy, wz = angular_rate_radps(message).tolist()
        dx, dy, dz = self._down
        return float(wx * dx + wy * dy + wz * dz)
