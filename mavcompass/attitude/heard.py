"""What a live vehicle says of its roll and pitch, message by message."""

from __future__ import annotations

import math

from mavcompass import messages as mav
from mavcompass.attitude.level import RECEIVER_LAG_S, Level
from mavcompass.messages import telemetry
from mavcompass.units import MPS2_PER_MILLI_G, RADPS_PER_MILLIRADPS

# No fix is older; some send the time of day with their position.
_OTHER_CLOCK_S = 2.0
# No vehicle is faster; and no finite number that a wire may bring beyond it does harm.
_FASTEST_MPS = 400.0


def hear(level: Level, message: mav.Message) -> None:
    """Take one message of a vehicle; those that tell nothing of its level are passed over."""
    if isinstance(message, mav.ScaledImu2 | mav.ScaledImu3):
        return  # of another sensor, or of none
    if isinstance(message, mav.RawImu | mav.ScaledImu):
        g, w = MPS2_PER_MILLI_G, RADPS_PER_MILLIRADPS
        time_s = message.time_usec * 1e-6 if isinstance(message, mav.RawImu) else message.time_boot_ms * 1e-3
        level.update(
            time_s,
            (_uncut(message.xacc) * g, _uncut(message.yacc) * g, _uncut(message.zacc) * g),
            (_uncut(message.xgyro) * w, _uncut(message.ygyro) * w, _uncut(message.zgyro) * w),
        )
    elif isinstance(message, mav.Attitude):
        if math.isfinite(message.roll) and math.isfinite(message.pitch):
            level.hear_attitude(message.time_boot_ms * 1e-3, message.roll, message.pitch)
    elif isinstance(message, mav.GpsRawInt):
        north, east, _ = telemetry.ground_velocity_mps(message).tolist()
        moment_s = message.time_usec * 1e-6
        if abs(moment_s - level.time_s) > _OTHER_CLOCK_S:
            moment_s = level.time_s
        if math.hypot(north, east) < _FASTEST_MPS:  # which nan is not
            level.hear_velocity(moment_s - RECEIVER_LAG_S, north, east)


def _uncut(number: int) -> float:
    """Put a number that was cut toward zero into the middle of its step."""
    return number + 0.5 * ((number > 0) - (number < 0))
