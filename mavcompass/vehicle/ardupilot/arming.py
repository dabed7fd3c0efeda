"""Keep ArduPilot's arming checks from refusing a vehicle for the calibration that it is to be given.

Seen in its source (4.5.7): one bit of ARMING_CHECK stands for all that the compass is asked
(`compass_checks`), bit 0 for all checks there are. Where it may not arm it names every reason, each in a
text. From 4.7 on ARMING_SKIPCHK names what is not to be asked.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Mapping, Sequence

from mavcompass.procedure.script import Script

_NAMED = re.compile(r"(?:Pre)?Arm: ?(.*)")
# Of the compass, those that a calibration cures; not "not healthy", "calibration running", "requires reboot".
_OF_ITS_CALIBRATION = re.compile(
    r"Check mag field|Compass(?:es)? (?:\d )?not calibrated|Compass offsets too high|Compasses inconsistent"
)
_ALL, _COMPASS = 1, 1 << 2
# Bits 1 to 20, all that 4.5 to 4.6 know; one that is unknown means nothing.
_EACH = (1 << 21) - 2

Read = Callable[[Sequence[str]], Script[dict[str, float]]]


def exemption(said: Sequence[str], read: Read) -> Script[Mapping[str, float]]:
    """Return the parameters that leave the compass out, where these texts name its calibration alone."""
    reasons = [named[1] for text in said if (named := _NAMED.match(text))]
    if not reasons or not all(_OF_ITS_CALIBRATION.match(reason) for reason in reasons):
        return {}
    held = yield from read(("ARMING_CHECK", "ARMING_SKIPCHK"))
    if "ARMING_SKIPCHK" in held:
        return {"ARMING_SKIPCHK": float(int(held["ARMING_SKIPCHK"]) | _COMPASS)}
    if "ARMING_CHECK" not in held:
        return {}
    asked = int(held["ARMING_CHECK"])
    return {"ARMING_CHECK": float((_EACH if asked & _ALL else asked) & ~_COMPASS)}
