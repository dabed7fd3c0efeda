"""Keep PX4's arming checks from refusing a vehicle for the calibration that it is to be given.

Seen in its source (August 2024): COM_ARM_MAG_ANG is how far apart compasses may point (-1: not asked),
COM_ARM_MAG_STR whether the field's strength and dip forbid arming (1) or warn (2). That a compass has no
calibration at all, or that the heading is not stable, no parameter sets aside.
"""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence

_NAMED = re.compile(r"Preflight Fail: ?(.*)")
_SETS_ASIDE = (
    (re.compile(r"Compass(?:es)? .*inconsistent"), {"COM_ARM_MAG_ANG": -1.0}),
    (re.compile(r"Strong magnetic interference"), {"COM_ARM_MAG_STR": 2.0}),
)


def exemption(said: Sequence[str]) -> Mapping[str, float]:
    """Return the parameters that leave the compass out, where these texts name its calibration alone."""
    wanted: dict[str, float] = {}
    for reason in [named[1] for text in said if (named := _NAMED.match(text))]:
        cures = [values for pattern, values in _SETS_ASIDE if pattern.match(reason)]
        if not cures:
            return {}
        wanted |= cures[0]
    return wanted
