"""Have EKF3 take its compass's yaw over at once, without a parameter written and without a restart.

EKF3 pulls its yaw to the compass weakly (EK3_YAW_M_NSE is half a radian): after a calibration it needs
minutes, and swings past it, for a part of the old error went into the gyro's bias. It takes the compass's
yaw over at once when the compass becomes its source of yaw (`SelectMagFusion`, yaw_source_reset). Switching
to a set of sources that names no compass, and back, does that; the choice of the set lives in memory only.
A flying copter is not switched: it would be without a position for that moment, and what its filter has
learnt of the Earth's field in flight, which new offsets leave as it is, pulls the yaw back at once. There the
filter's own noises do it for some seconds, see `prompt_estimator`.
"""

from __future__ import annotations

from collections.abc import Mapping

from mavcompass.enums import MavCmd, MavResult
from mavcompass.errors import Refused
from mavcompass.procedure.commands import TRIES, command
from mavcompass.procedure.script import Context, Script, pause

HOW = "switching its source of yaw off and on"

# With these the filter believes its compass. What it has learnt of the Earth's field goes back to the world
# model's, within 1 mG. New offsets zero what it has learnt of the compass (`readMagData`), to within
# EK3_MAG_M_NSE: so sure, it cannot put its yaw's error there. A reading counts as sure to 10 mG, the least
# that the firmware takes, and is not thrown away where it is far off (10 sigmas). The gyro's bias, which the
# turns under the old compass have bent, may wander (shipped: 0.001 rad/s^2). Seen on ArduPilot 4.5.7 after a
# write, with iron of 310 mG: -16.3 deg off, -0.6 after 6 s, and so it stays; with 120 mG and without these:
# 7 deg after 20 s and 3 after a minute.
_PROMPT = {
    "EK3_MAG_EF_LIM": 1.0,
    "EK3_MAG_M_NSE": 0.001,
    "EK3_GBIAS_P_NSE": 0.03,
    "EK3_MAG_I_GATE": 1000.0,
}
_HEADING_ONLY = 2.0  # EK3_MAG_CAL: nothing is learnt of the field
_SETS = (1, 2, 3)
_EKF3, _COMPASS, _COMPASS_AS_FALLBACK, _NONE = 3.0, 1.0, 3.0, 0.0
# One step of the filter would do; several survive a busy processor.
_OFF_S = 0.1
# By then the compass's yaw is in force: a turn named relative to the yaw before it may go the other way
# round, and does so for seconds where its successor never comes.
_ON_S = 0.12
_TRIES_AFTER_A_STOP = 5


def take_compass_yaw(context: Context, parameters: Mapping[str, float], flying: bool) -> Script[str]:
    """Have the filter take its compass's yaw over; return how, "" where there is no gentle way now.

    Raises LinkError where the vehicle fell silent in between.
    """
    idle = None if flying else idle_set(parameters)
    if idle is None or (yield from _use(context, idle)) != MavResult.ACCEPTED:
        return ""
    try:
        yield from pause(context, _OFF_S)
        yield from _use(context, _SETS[0])
        yield from pause(context, _ON_S)
    except Refused:
        # A stop comes once, and the vehicle needs its sources; but what was written may have to go back, too.
        yield from _use(context, _SETS[0], _TRIES_AFTER_A_STOP)
        raise
    return HOW


def prompt_estimator(parameters: Mapping[str, float]) -> Mapping[str, float]:
    """Return the values at which a flying EKF3 believes its compass; {} where it follows or learns none."""
    by_compass = parameters.get("EK3_SRC1_YAW", _COMPASS) in (_COMPASS, _COMPASS_AS_FALLBACK)
    learns = parameters.get("EK3_MAG_CAL") != _HEADING_ONLY
    return _PROMPT if by_compass and learns and parameters.get("AHRS_EKF_TYPE", _EKF3) == _EKF3 else {}


def idle_set(parameters: Mapping[str, float]) -> int | None:
    """Choose a set of sources that names no yaw, where the first is beyond doubt the one in use.

    A second set with a position of its own may be the one that the pilot's switch has chosen, which
    nothing tells.
    """
    if parameters.get("AHRS_EKF_TYPE", _EKF3) != _EKF3:
        return None
    if parameters.get("EK3_SRC1_YAW") not in (_COMPASS, _COMPASS_AS_FALLBACK):
        return None
    others = [n for n in _SETS[1:] if f"EK3_SRC{n}_YAW" in parameters]
    if any(parameters.get(f"EK3_SRC{n}_POSXY", _NONE) != _NONE for n in others):
        return None
    return next((n for n in others if parameters[f"EK3_SRC{n}_YAW"] == _NONE), None)


def _use(context: Context, number: int, tries: int = TRIES) -> Script[MavResult]:
    what = "which sources its estimator uses"
    return (yield from command(context, MavCmd.SET_EKF_SOURCE_SET, float(number), what=what, tries=tries))
