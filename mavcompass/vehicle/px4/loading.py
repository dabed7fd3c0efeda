"""Have PX4 load a calibration that was written while it flew, and take its compass's heading over.

Seen in its source and on its firmware (August 2024). `VehicleMagnetometer` loads CAL_MAGn_* only while
disarmed, when some parameter changes; each change of the calibration that it sees has the estimator reset its
heading to the compass's. And on disarming it first stores the calibration that it flew with, moved toward the
bias that its estimator learnt in flight, over whatever was written meanwhile.

The reset lasts where the estimator's tilt and gyro bias are good. Right after a landing they were seen not to
be, and the heading slid off by ten degrees in two seconds: then it is loaded again. Where the heading was
more than some 17 degrees off the compass's (EKF2_HEAD_NOISE), the estimator believes no compass any more
and resets nothing while it stands (`mag_heading_consistent`) unless it has no receiver's velocity to hold the
compass against: EKF2_GPS_CTRL is 0 while a calibration is loaded.
"""

from __future__ import annotations

import re
from collections.abc import Mapping
from dataclasses import replace

from mavcompass.errors import LinkError, Refused, WriteFailed
from mavcompass.procedure.script import Context, Script, pause
from mavcompass.vehicle.parameters import protocol
from mavcompass.vehicle.parameters.values import holds

RECEIVERS = "EKF2_GPS_CTRL"
HOW = "PX4's own reset when it loads a calibration on the ground"

# What PX4 takes for another calibration is a change by more than 0.005 gauss, or by 0.01 of the diagonal or
# of what is beside it. Less stays as it was in force, up to a degree of heading.
# So it is moved by more than twice that: from what is in force, and back.
_ANOTHER = {"XOFF": 0.011, "XSCALE": 0.021, "XODIAG": 0.021}
_MOVED = re.compile(r"CAL_MAG\d_(XOFF|XSCALE|XODIAG)")
# By then the changed calibration has been loaded. PX4 stores what was changed 0.3 s after the first change;
# in SITL it was seen to hang for good where a value changed while it compared what it had stored.
_SEEN_S = 0.1


def load(context: Context, written: Mapping[str, float]) -> Script[str]:
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
    return HOW if moved else ""
