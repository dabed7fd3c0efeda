"""Have EKF3 take its compass's yaw over at once, without a parameter written and without a restart.

EKF3 pulls its yaw to the compass weakly (EK3_YAW_M_NSE is half a radian): after a calibration it needs
minutes, and swings past it, for a part of the old error went into the gyro's bias. It takes the compass's
yaw over at once when the compass becomes its source of yaw (`SelectMagFusion`, yaw_source_reset). Switching
to a set of sources that names no compass, and back, does that; the choice of the set lives in memory only.
A flying copter is left alone: it would be without a position for that moment, and what its filter has learnt
of the field in flight pulls the yaw back at once.
"""

from __future__ import annotations

from collections.abc import Mapping

from mavcompass.enums import MavCmd, MavResult
from mavcompass.errors import Refused
from mavcompass.procedure.commands import TRIES, command
from mavcompass.procedure.script import Context, Script, pause

HOW = "switching its source of yaw off and on"

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
