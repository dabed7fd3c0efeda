"""What of a motion is left out, because the rest agrees without it: all before a change, or one stop.

When did the iron change? A recording in which something was moved is good for what it is since then.

Does one of a few stops stand beside something magnetic? Steel there adds a field to the compass that fades on
the turns to the stops before and after. With few stops a fit bends the iron to it, and no single stretch
lies far out. Without the stop and these turns the rest has to agree within its noise; where it does so for
one stop alone, that stop was disturbed.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from mavcompass.calibration.motion.fit import level_headings, residual_of
from mavcompass.calibration.motion.observed import Motion
from mavcompass.calibration.motion.sections import LEAST_CIRCLE_RAD, Sections
from mavcompass.calibration.recorded import Recorded
from mavcompass.calibration.result import Change
from mavcompass.errors import PoorCalibration
from mavcompass.frames import FloatArray, circle_covered_rad, wrap_pi

# A model error that bends the heading by less is not looked into: it may be chance, or the tilt's.
WORTH_IT_RAD = math.radians(0.5)
# A stretch is taken for what is left of the iron's change where its error is smaller by this factor.
_BETTER = 0.4
# So many times what it leaves of itself a change leaves of what was before.
_STANDS_OUT = 2.0
_EVEN_CUTS = 8
_JUMPS = 4
# Between a change and the first reading that counts.
_SETTLE_S = 1.0
# What passes by is gone sooner.
_NO_PASSING_S = 10.0
_STOP_S = 2.0
# Fewer do not tell which; of more, one bends little.
_FEWEST, _MOST = 4, 8
# What is left without the stop is explained by noise, or nearly; by another stop as well, if it is as near.
_EXPLAINED, _ALIKE = 0.3, 0.1


# --- a change of the iron ---------------------------------------------------------------------------


def last_stretch(motion: Motion) -> tuple[Motion, Change | None]:
    """Return the motion since the iron last changed, and what changed; all of it and None without."""
    kept_out = _since_the_beginning_was_kept_out(motion)
    if kept_out is not None:
        return kept_out
    worth_it = WORTH_IT_RAD * motion.fit.horizontal_mgauss
    if motion.fit.error.mgauss < worth_it:
        return motion, None
    best, start_s = motion, -math.inf
    for candidate_s in _candidates(motion):
        later = _anew(motion, candidate_s)
        if later is None or later.fit.error.mgauss >= _BETTER * best.fit.error.mgauss:
            continue
        before = residual_of(motion.sections.between(-math.inf, candidate_s), later.fit)
        if _size(before) < _STANDS_OUT * _size(later.fit.residual_mgauss):
            continue
        best, start_s = later, candidate_s
        if best.fit.error_mgauss < worth_it:
            break
    return (motion, None) if best is motion else _told(motion, best, start_s)


def _told(motion: Motion, later: Motion, start_s: float) -> tuple[Motion, Change]:
    moved_mgauss = _size(residual_of(motion.sections.between(-math.inf, start_s), later.fit))
    change = Change(_dated(motion, later, moved_mgauss), moved_mgauss)
    return replace(later, recorded=since(motion.recorded, start_s)), change


def _size(residual_mgauss: FloatArray) -> float:
    return float(np.median(np.linalg.norm(residual_mgauss, axis=1))) if len(residual_mgauss) else 0.0


def _since_the_beginning_was_kept_out(motion: Motion) -> tuple[Motion, Change] | None:
    """Cut off a beginning of which the fit kept out all, as if something passed by; None without."""
    first_sound = int(np.argmax(motion.fit.sound > 0.5))
    if first_sound == 0:
        return None
    start_s = float(motion.sections.end_s[first_sound - 1]) + _SETTLE_S
    if start_s - float(motion.sections.start_s[0]) < _NO_PASSING_S:
        return None
    later = _anew(motion, start_s)
    return None if later is None else _told(motion, later, start_s)


def _anew(motion: Motion, start_s: float) -> Motion | None:
    """Fit a motion from some time on; None where too few sections or headings are left."""
    try:
        later = motion.on(motion.sections.between(start_s, math.inf))
    except PoorCalibration:
        return None
    return later if circle_covered_rad(later.fit.headings_rad) >= LEAST_CIRCLE_RAD else None


def _dated(motion: Motion, later: Motion, moved_mgauss: float) -> float:
    """Return since when the sections agree with the fit of the last of them; before it most are off."""
    off = np.linalg.norm(residual_of(motion.sections, later.fit), axis=1) > 0.5 * moved_mgauss
    explained = np.concatenate([[0], np.cumsum(np.where(off, 1, -1))])[:-1]
    return float(motion.sections.start_s[int(np.argmax(explained))])


def since(recorded: Recorded, start_s: float) -> Recorded:
    """Cut a recording to what was after a time."""
    return replace(recorded, track=recorded.track.between(start_s, math.inf))


def _candidates(motion: Motion) -> list[float]:
    """List times at which the iron may have changed, in order: where it jumped, and evenly spread ones."""
    sections = motion.sections
    start, end = float(sections.start_s[0]), float(sections.end_s[-1])
    even = start + (end - start) * np.arange(1, _EVEN_CUTS) / _EVEN_CUTS
    return sorted([*_jumps(motion), *(float(t) for t in even)])


def _jumps(motion: Motion) -> FloatArray:
    """Return the times at which the residual jumps most between neighbouring sections, and stays."""
    residual, time = motion.fit.residual_mgauss, motion.sections.start_s
    if len(residual) < 6:
        return np.empty(0)
    before = residual[:-3] + residual[1:-2]
    after = residual[2:-1] + residual[3:]
    size = np.linalg.norm(after - before, axis=1)
    return np.asarray(time[np.argsort(-size)[:_JUMPS] + 2] + _SETTLE_S)


# --- a disturbed stop -------------------------------------------------------------------------------


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

    def said(self, limit_deg: float) -> tuple[str, bool]:
        """Say it in a sentence, and whether it cannot be believed since it matters which stop it was."""
        matters = math.degrees(self.open_rad) > limit_deg
        times = " or ".join(f"{at_s:.0f} s" for at_s in self.at_s)
        why = (
            ", and the recording does not tell where. Record again with one more stop, at the first heading."
            if matters
            else ": without that stop, and the turns to and from it, the rest agrees. It was left out."
        )
        return f"Something magnetic stood near the vehicle where it stopped at {times}{why}", matters


def without_disturbed_stop(motion: Motion) -> Disturbed | None:
    """Leave out the stop that contradicts the rest; None where none does, or none alone.

    What stands lies as it is said to: there what seems an attitude is a field.
    """
    error, stops = motion.fit.error_mgauss, _stops(motion.sections)
    if error <= WORTH_IT_RAD * motion.fit.horizontal_mgauss or not _FEWEST <= len(stops) <= _MOST:
        return None
    found: list[tuple[float, float, Motion]] = []
    for at_s, left_out in stops:
        rest = motion.sections.chosen(np.delete(np.arange(len(motion.sections)), left_out))
        if circle_covered_rad(rest.turned_rad) < LEAST_CIRCLE_RAD:
            continue
        try:
            later = motion.on(rest)
        except PoorCalibration:
            continue
        if later.fit.error_mgauss < _EXPLAINED * error:
            found.append((later.fit.error_mgauss, at_s, later))
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
