"""Does one of a few stops stand beside something magnetic? Leave it out where the rest then agrees.

Steel beside a stop adds a field to the compass that fades on the turns to the stops before and after. With
few stops a fit bends the iron to it, and no single stretch lies far out. Without the stop and these turns the
rest has to agree within its noise; where it does so for one stop alone, that stop was disturbed.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from mavcompass.calibration.motion.findings import LEAST_CIRCLE_RAD, circle_seen_rad
from mavcompass.calibration.motion.fit import level_headings
from mavcompass.calibration.motion.observed import Motion
from mavcompass.calibration.motion.sections import Sections
from mavcompass.errors import PoorCalibration
from mavcompass.frames import wrap_pi

_STOP_S = 2.0
# Fewer do not tell which; of more, one bends little.
_FEWEST, _MOST = 4, 8
# A model error that bends the heading by less may be chance, or the tilt's.
_WORTH_IT_RAD = math.radians(0.5)
# What is left without the stop is explained by noise, or nearly; by another stop as well, if it is as near.
_EXPLAINED, _ALIKE = 0.3, 0.1


@dataclass(frozen=True, slots=True, eq=False)
class Disturbed:
    """Hold a motion less its disturbed stop.

    Attributes:
        motion: the rest, by the likeliest of the stops. at_s: the stops that may be the disturbed one.
        open_rad: how far the headings lie apart that follow from one or the other, rms.
    """

    motion: Motion
    at_s: tuple[float, ...]
    open_rad: float

    def words(self) -> str:
        """Say it in a sentence."""
        return (
            f"{self._place()}: without that stop, and the turns to and from it, the rest agrees. It was left"
            " out."
        )

    def reason(self, limit_deg: float) -> str:
        """Say why it cannot be believed, or "" where it makes little difference which stop it was."""
        if math.degrees(self.open_rad) <= limit_deg:
            return ""
        return (
            f"{self._place()}, and the recording does not tell where. Record again with one more stop, at the"
            " first heading."
        )

    def _place(self) -> str:
        times = " or ".join(f"{at_s:.0f} s" for at_s in self.at_s)
        return f"Something magnetic stood near the vehicle where it stopped at {times}"


def without_disturbed_stop(motion: Motion) -> Disturbed | None:
    """Leave out the stop that contradicts the rest; None where none does, or none alone."""
    error, stops = motion.fit.model_mgauss, _stops(motion.sections)
    if error <= _WORTH_IT_RAD * motion.fit.horizontal_mgauss or not _FEWEST <= len(stops) <= _MOST:
        return None
    found: list[tuple[float, float, Motion]] = []
    for at_s, left_out in stops:
        rest = motion.sections.chosen(np.delete(np.arange(len(motion.sections)), left_out))
        if circle_seen_rad(rest.turned_rad) < LEAST_CIRCLE_RAD:
            continue
        try:
            later = motion.on(rest)
        except PoorCalibration:
            continue
        if later.fit.model_mgauss < _EXPLAINED * error:
            found.append((later.fit.model_mgauss, at_s, later))
    if not found:
        return None
    least, _, best = min(found, key=lambda one: one[0])
    found = [one for one in found if one[0] <= least + _ALIKE * error]
    headings = [level_headings(motion.sections, rest.fit) for _, _, rest in found]
    apart = [wrap_pi(one - headings[0]) for one in headings]
    open_rad = math.sqrt(float(np.var(apart, axis=1).max()))
    return Disturbed(best, tuple(at_s for _, at_s, _ in found), open_rad)


def _stops(sections: Sections) -> list[tuple[float, NDArray[np.intp]]]:
    """List the stops: their middles in time, and the sections from the stop before to the one after."""
    stops: list[tuple[int, int]] = []
    first = 0
    while first < len(sections):
        last = first + int(sections.repeats[first])
        if sections.end_s[last - 1] - sections.start_s[first] >= _STOP_S:
            stops.append((first, last))
        first = last
    ends = [0, *(last for _, last in stops)]
    starts = [*(first for first, _ in stops[1:]), len(sections)]
    return [
        (0.5 * float(sections.start_s[first] + sections.end_s[last - 1]), np.arange(before, after))
        for (first, last), before, after in zip(stops, ends, starts, strict=False)
    ]
