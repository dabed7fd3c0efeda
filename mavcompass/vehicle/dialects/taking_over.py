"""Have an autopilot's estimator take the heading of a newly calibrated compass over.

ArduPilot's EKF3 does so without a restart. It pulls its yaw to the compass
weakly (EK3_YAW_M_NSE is half a radian): after a calibration it needs minutes, and swings past it, for a part
of the old error went into the gyro's bias. It takes the compass's yaw over at once when the compass becomes
its source of yaw (`SelectMagFusion`, yaw_source_reset). Switching to a set of sources that names no compass,
and back, does that; the choice of the set lives in memory only. A flying copter is not switched: it would be
without a position for that moment, and what its filter has learnt of the Earth's field in flight, which new
offsets leave as it is, pulls the yaw back at once. The bias, and all of it in flight, is seen to by the
filter's own noises for some seconds, see `prompt_ekf3`.

PX4 loads a calibration that was written while it flew. Seen in its source and on its firmware (August 2024):
`VehicleMagnetometer` loads CAL_MAGn_* only while disarmed, when some parameter changes; each change of the
calibration that it sees has the estimator reset its heading to the compass's. And on disarming it first
stores the calibration that it flew with, moved toward the bias that its estimator learnt in flight, over
whatever was written meanwhile.

The reset lasts where the estimator's tilt and gyro bias are good. Right after a landing they were seen not to
be, and the heading slid off by ten degrees in two seconds: then it is loaded again. Where the heading was
more than some 17 degrees off the compass's (EKF2_HEAD_NOISE), the estimator believes no compass any more and
resets nothing while it stands (`mag_heading_consistent`) unless it has no receiver's velocity to hold the
compass against: EKF2_GPS_CTRL is 0 while a calibration is loaded. And what a reset leaves open of the
compass's bias, by EKF2_MAG_NOISE, later takes the yaw along: it is 0.002 meanwhile.
"""

from __future__ import annotations

import re
from collections.abc import Mapping
from dataclasses import replace

from mavcompass.enums import MavCmd, MavResult
from mavcompass.errors import LinkError, Refused, WriteFailed
from mavcompass.procedure.commands import TRIES, command
from mavcompass.procedure.script import Context, Script, pause
from mavcompass.vehicle.parameters import protocol
from mavcompass.vehicle.parameters.values import holds

# --- ArduPilot ------------------------------------------------------------------------------------

EKF3_HOW = "switching its source of yaw off and on"

# With these the filter believes its compass, and its gyro's bias, which the turns under the old compass have
# bent, may wander (shipped: 0.5 rad and 0.001 rad/s^2, 40 s). Seen on ArduPilot 4.5.7, on the ground: a yaw
# that was only taken over went 1 to 4 deg off in the minute after it.
_PROMPT_HEADING = {"EK3_YAW_M_NSE": 0.05, "EK3_GBIAS_P_NSE": 0.1}
# Where it learns the field, in flight: what it has learnt of the Earth's goes back to the world model's,
# within 1 mG. New offsets zero what it has learnt of the compass (`readMagData`), to within EK3_MAG_M_NSE: so
# sure, it cannot put its yaw's error there. A reading counts as sure to 10 mG, the least that the firmware
# takes, and is not thrown away where it is far off (10 sigmas). Seen after a write, with iron of 310 mG: -16
# deg off, -0.6 after 6 s, and so it stays; with 120 mG and without these: 7 deg after 20 s, 3 after a minute.
_PROMPT_FIELD = {
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


def take_ekf3_yaw(context: Context, parameters: Mapping[str, float], flying: bool) -> Script[str]:
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
    return EKF3_HOW


def prompt_ekf3(parameters: Mapping[str, float], flying: bool) -> Mapping[str, float]:
    """Return the values at which EKF3 believes its compass; {} where it follows none."""
    by_compass = parameters.get("EK3_SRC1_YAW", _COMPASS) in (_COMPASS, _COMPASS_AS_FALLBACK)
    if not by_compass or parameters.get("AHRS_EKF_TYPE", _EKF3) != _EKF3:
        return {}
    learns = flying and parameters.get("EK3_MAG_CAL") != _HEADING_ONLY
    return _PROMPT_FIELD if learns else _PROMPT_HEADING


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


# --- PX4 ------------------------------------------------------------------------------------------

# What the reset leaves open of the compass's bias (as shipped 50 mG, 13 degrees) takes the yaw along while it
# stands: up to 19 degrees in a minute were seen. 2 mG are half a degree; at 1 mG PX4 begins anew.
_PROMPT_EKF2 = {"EKF2_GPS_CTRL": 0.0, "EKF2_MAG_NOISE": 0.002}
PX4_HOW = "PX4's own reset when it loads a calibration on the ground"

# What PX4 takes for another calibration is a change by more than 0.005 gauss, or by 0.01 of the diagonal or
# of what is beside it. Less stays as it was in force, up to a degree of heading.
# So it is moved by more than twice that: from what is in force, and back.
_ANOTHER = {"XOFF": 0.011, "XSCALE": 0.021, "XODIAG": 0.021}
_MOVED = re.compile(r"CAL_MAG\d_(XOFF|XSCALE|XODIAG)")
# By then the changed calibration has been loaded. PX4 stores what was changed 0.3 s after the first change;
# in SITL it was seen to hang for good where a value changed while it compared what it had stored.
_SEEN_S = 0.1


def prompt_ekf2(parameters: Mapping[str, float]) -> Mapping[str, float]:
    """Return the values at which an EKF2 on the ground believes its compass; {} where it does so already."""
    return {name: value for name, value in _PROMPT_EKF2.items() if parameters.get(name, value) > value}


def load_px4(context: Context, written: Mapping[str, float]) -> Script[str]:
    """Write CAL_MAG parameters again, moved by so much first and then as they are; return how that helps.

    A mounting alone, whose change resets no heading, is written again where PX4 has overwritten it.

    Only for a vehicle that is disarmed, and knows them. Raises WriteFailed where they could not be written,
    Refused for a stop, which leaves them written.
    """
    held = yield from protocol.read(context, tuple(written), "bytewise", exist=True)
    wanted = {name: replace(held[name], value=value) for name, value in written.items() if name in held}
    moved = {
        n: replace(p, value=p.value + _ANOTHER[which[1]])
        for n, p in wanted.items()
        if (which := _MOVED.fullmatch(n))
    }
    # Last comes what was moved: with it all beside it is loaded, that hardly changed itself.
    wanted = dict(sorted(wanted.items(), key=lambda item: item[0] in moved))
    overwritten = any(not holds(held[name], p.value, "bytewise") for name, p in wanted.items())
    if not moved and not overwritten:
        return ""
    if overwritten:
        context.show("write", "PX4 had put other values in place of the new ones; they are written again.")
    stopped: Refused | None = None
    try:
        if moved:
            yield from protocol.write(context, moved, "bytewise")
            yield from pause(context, _SEEN_S)
    except Refused as stop:
        stopped = stop
    while True:
        try:
            echoes_s = yield from protocol.write(context, wanted, "bytewise")
            yield from protocol.prove(context, wanted, "bytewise", echoes_s)
            break
        except Refused as stop:  # which comes once
            stopped = stop
        except LinkError as trouble:
            values = ", ".join(f"{name} {wanted[name].value:.6g}" for name in moved)
            raise WriteFailed(
                f"The new values were to be written again, and may be 11 mG and 0.02 off: {trouble.what}",
                f"Bring the link back and set: {values}.",
            ) from trouble
    if stopped is not None:
        raise stopped
    return PX4_HOW if moved else ""
