"""When did the iron change? A recording in which something was moved is good for what it is since then."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np

from mavcompass.calibration.motion.findings import LEAST_CIRCLE_RAD, circle_seen_rad
from mavcompass.calibration.motion.fit import residual_of
from mavcompass.calibration.motion.observed import Motion
from mavcompass.calibration.recorded import Recorded
from mavcompass.errors import PoorCalibration
from mavcompass.frames import FloatArray

# A model error that bends the heading by less than this is not looked into.
_WORTH_IT_RAD = math.radians(0.5)
# A stretch is taken for what is left of the iron's change where its error is smaller by this factor.
_BETTER = 0.4
_EVEN_CUTS = 8
_JUMPS = 4
# Between a change and the first reading that counts.
_SETTLE_S = 1.0
# What passes by is gone sooner.
_NO_PASSING_S = 10.0
# A smaller difference may be an error of the attitude.
_IRON_MGAUSS = 15.0


@dataclass(frozen=True, slots=True)
class Change:
    """Say that what was recorded before a time does not fit the rest, and by how much the iron differed."""

    time_s: float
    moved_mgauss: float

    @property
    def is_iron(self) -> bool:
        """Tell whether iron aboard was moved; else it may be manoeuvres, or something that passed."""
        return self.moved_mgauss > _IRON_MGAUSS

    def words(self) -> str:
        """Say it in a sentence."""
        if self.is_iron:
            return (
                f"The iron changed by about {self.moved_mgauss:.0f} mG at {self.time_s:.0f} s: only what was "
                "recorded after it counts."
            )
        return (
            f"What was recorded before {self.time_s:.0f} s does not fit the rest (hard manoeuvres, or "
            "something magnetic nearby): only what came after counts."
        )


def last_stretch(motion: Motion) -> tuple[Motion, Change | None]:
    """Return the motion since the iron last changed, and what changed; all of it and None without."""
    kept_out = _since_the_beginning_was_kept_out(motion)
    if kept_out is not None:
        return kept_out
    worth_it = _WORTH_IT_RAD * motion.fit.horizontal_mgauss
    if motion.fit.model_mgauss < worth_it:
        return motion, None
    found: tuple[Motion, float] | None = None
    for start in _candidates(motion):
        later = _anew(motion, start)
        if later is None:
            continue
        best = motion.fit.model_mgauss if found is None else found[0].fit.model_mgauss
        if best < worth_it:
            break
        if later.fit.model_mgauss < _BETTER * best:
            found = later, start
    if found is None:
        return motion, None
    return _told(motion, *found)


def _told(motion: Motion, later: Motion, start_s: float) -> tuple[Motion, Change]:
    before = motion.sections.between(-math.inf, start_s)
    moved = np.linalg.norm(residual_of(before, later.fit), axis=1) if len(before) else np.zeros(1)
    change = Change(_dated(motion, later, float(np.median(moved))), float(np.median(moved)))
    return replace(later, recorded=since(motion.recorded, start_s)), change


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
        later = motion.since(start_s)
    except PoorCalibration:
        return None
    return later if circle_seen_rad(later.fit.headings_rad) >= LEAST_CIRCLE_RAD else None


def _dated(motion: Motion, later: Motion, moved_mgauss: float) -> float:
    """Return since when the sections agree with the fit of the last of them; before it most are off."""
    off = np.linalg.norm(residual_of(motion.sections, later.fit), axis=1) > 0.5 * moved_mgauss
    explained = np.concatenate([[0], np.cumsum(np.where(off, 1, -1))])[:-1]
    return float(motion.sections.start_s[int(np.argmax(explained))])


def calm_since_s(motion: Motion) -> float | None:
    """Return the end of the last disturbed section; None where there is none."""
    disturbed = np.flatnonzero(motion.fit.sound < 0.5)
    return float(motion.sections.end_s[disturbed[-1]]) + _SETTLE_S if disturbed.size else None


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
    order = np.argsort(-size)[:_JUMPS]
    return np.asarray(time[order + 2] + _SETTLE_S)
