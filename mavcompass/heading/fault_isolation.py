"""Several sources of one heading that may disagree: how far each is off, and which of them is at fault.

Each source i shows deviations c_i from a common heading: the constant A, and where it was seen on the
circle also B sin psi and C cos psi, as a compass adjuster writes them. A sound source has c_i = mu + noise
of its own sigma, with a common mu of which nothing is known; one at fault has any deviation. A hypothesis
is the set S of sound sources, and its weight, each deviation integrated over mu,

    w(S) = prod_S (1 - p) l_i  prod_(not S) p / R  .  1/R int prod_S N(c_i; mu, sigma_i) dmu            (J1)

with p the chance of its fault, R the room that a fault has, and l_i what the source shows by itself (its turn
against the gyro, its dip and strength against the Earth's), as a likelihood ratio of sound to faulty.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from functools import lru_cache
from itertools import combinations

import numpy as np
from numpy.typing import NDArray

from mavcompass.frames import FloatArray, wrap_pi
from mavcompass.printable import named

# Before anything is seen, one compass in fifty is mounted otherwise than set, or broken; of what is none one
# source in two hundred is wrong about the nose (antennas swapped, driven backwards all along).
FAULT, _FAULT_ELSEWHERE = 0.02, 0.005
# A fault has the whole circle for A, and 20 degrees each way for B and C: twice the iron that bends most.
_ROOM_RAD = (2.0 * math.pi, math.radians(40.0), math.radians(40.0))
# What a source shows by itself is this much wider in one fault of two; in the other it does not show it: a
# compass turned about the vertical sees dip and strength as it should. It may be the place that is at fault
# instead, or the gyro, in one case of 150: more it cannot say against a source.
_WIDER, _SHOWS, _LEAST_LOG = 10.0, 0.5, -5.0
# A source is blamed where it is rather at fault than sound, and another rather sound; where there is none,
# one that is sound with less than this chance leaves it open which it is.
RATHER_SOUND, DOUBTED = 0.6, 0.9


@dataclass(frozen=True, slots=True)
class HeadingSource:
    """Hold what one source of the heading shows.

    Attributes:
        name: "compass 2", "gps-yaw", ...
        deviation_rad: A, B and C, nan where they were not seen; only differences between sources count.
        sigma_rad: of each of these, where the source is sound.
        by_itself: what else it shows, in sigmas of a sound source, by what it is held against.
        fault: how likely it is to be at fault before anything is seen.
    """

    name: str
    deviation_rad: tuple[float, float, float]
    sigma_rad: float
    by_itself: Mapping[str, float] = field(default_factory=dict)
    fault: float = FAULT

    @classmethod
    def elsewhere(cls, name: str, a_rad: float, sigma_rad: float) -> HeadingSource:
        """Make a source that is no compass, of which A is known."""
        return cls(name, (a_rad, math.nan, math.nan), sigma_rad, fault=_FAULT_ELSEWHERE)

    @classmethod
    def at(cls, name: str, heading_deg: float, sigma_deg: float, **by_itself: float) -> HeadingSource:
        """Make a source of which one heading is known, degrees; nan in `by_itself` is what is not known."""
        return cls(name, (math.radians(heading_deg), math.nan, math.nan), math.radians(sigma_deg), by_itself)

    @property
    def log_ratio(self) -> float:
        """Return the log likelihood ratio, sound to faulty, of what it shows by itself."""
        known = [z for z in self.by_itself.values() if not math.isnan(z)]
        shown = (0.5 * z**2 * (1.0 - _WIDER**-2) - math.log(_WIDER) for z in known)
        hidden, seen = math.log(1.0 - _SHOWS), math.log(_SHOWS)
        return max(-sum(float(np.logaddexp(hidden, seen + one)) for one in shown), _LEAST_LOG)


@dataclass(frozen=True, slots=True, eq=False)
class FaultIsolation:
    """Hold which sources are sound.

    Attributes:
        sources: as given.
        sound: the probability of each being sound, (N,).
        error_rad: the rms error of each over the circle, by all hypotheses, its own sigma included, (N,).
        likeliest: the sources (from 0) that are sound by the likeliest hypothesis.
        log_evidence: log of the weights (J1) of all hypotheses by which the first source is sound.
    """

    sources: tuple[HeadingSource, ...]
    sound: FloatArray
    error_rad: FloatArray
    likeliest: tuple[int, ...]
    log_evidence: float = 0.0

    @property
    def blamed(self) -> tuple[int, ...]:
        """List the sources that are more likely at fault than sound, where another is not."""
        at_fault = np.flatnonzero(self.sound < 0.5)
        return tuple(int(i) for i in at_fault) if (self.sound > RATHER_SOUND).any() else ()

    @property
    def undecided(self) -> bool:
        """Tell whether some source is at fault and nothing tells which."""
        return not self.blamed and bool((self.sound < DOUBTED).any())

    def beyond_rad(self, index: int) -> float:
        """Return how far a source may be off beyond its own sigma, rms over the circle."""
        return math.sqrt(max(float(self.error_rad[index]) ** 2 - self.sources[index].sigma_rad ** 2, 0.0))

    def apart_rad(self, index: int) -> float:
        """Return a source's A less that of the other sound ones; of all others where there are none."""
        rest = [i for i, s in enumerate(self.sources) if i != index and not math.isnan(s.deviation_rad[0])]
        others = tuple(i for i in rest if i in self.likeliest) or tuple(rest)
        if not others:
            return 0.0
        centre, _ = _common([self.sources[i] for i in others], np.ones((1, len(others)), dtype=np.bool_))
        return float(wrap_pi(self.sources[index].deviation_rad[0] - centre[0, 0]))

    def others_sigma_rad(self, index: int) -> float:
        """Return one sigma of the heading by the other sound sources together."""
        others = [self.sources[i].sigma_rad ** -2.0 for i in self.likeliest if i != index]
        return sum(others) ** -0.5 if others else math.inf

    def why(self, index: int) -> str:
        """Say in a sentence what speaks against a source."""
        mine = self.sources[index]
        apart_deg = abs(math.degrees(self.apart_rad(index)))
        seen = [i for i in self.likeliest if not math.isnan(self.sources[i].deviation_rad[0])]
        others = [self.sources[i].name for i in seen if i != index]
        shows = [name for name, z in mine.by_itself.items() if abs(z) > 2.0]
        speak = "speaks" if len(shows) == 1 else "speak"
        also = f"; the {' and the '.join(shows)} {speak} against it, too" if shows else ""
        agree = f"{named(others)}{', which agree' if len(others) > 1 else ''}"
        if not others:
            return f"{mine.name.capitalize()} disagrees with {' and '.join(shows) or 'all others'}."
        return f"{mine.name.capitalize()} is {apart_deg:.0f} deg from {agree}{also}."


def isolate_faults(sources: Sequence[HeadingSource]) -> FaultIsolation:
    """Weigh every set of sources that may be sound (J1). Returns nothing to blame for one source or none."""
    sources, count = tuple(sources), len(sources)
    sigma = np.array([s.sigma_rad for s in sources])
    if count < 2:
        return FaultIsolation(sources, np.ones(count), sigma, tuple(range(count)))
    hypotheses, member = _hypotheses(count)
    centre, log_weight = _common(sources, member)
    sound = [math.log(1.0 - s.fault) + s.log_ratio for s in sources]
    log_weight += np.where(member, sound, [math.log(s.fault) for s in sources]).sum(axis=1)
    share = np.exp(log_weight - log_weight.max())
    log_evidence = float(log_weight.max() + np.log(share @ member[:, 0]))
    share /= share.sum()
    away = np.array([s.deviation_rad for s in sources]) - centre[:, np.newaxis]
    away[np.isnan(away)] = 0.0
    # The mean square over the circle, of one of those about the centre or of another (J2).
    apart2 = wrap_pi(away[..., 0]) ** 2 + 0.5 * (away[..., 1:] ** 2).sum(axis=-1)
    error2 = np.where(member, np.maximum(sigma**2, apart2), sigma**2 + apart2)
    likeliest = hypotheses[int(np.argmax(share))]
    return FaultIsolation(sources, share @ member, np.sqrt(share @ error2), likeliest, log_evidence)


@lru_cache(maxsize=16)
def _hypotheses(count: int) -> tuple[list[tuple[int, ...]], NDArray[np.bool_]]:
    """List the sets of sources that may be sound, H of them, and mark their members, (H, N)."""
    sets = [subset for size in range(1, count + 1) for subset in combinations(range(count), size)]
    return sets, np.array([[i in subset for i in range(count)] for subset in sets])


def _common(sources: Sequence[HeadingSource], member: NDArray[np.bool_]) -> tuple[FloatArray, FloatArray]:
    """Return sets' (H, N) mean deviations (H, 3), nan where none shows one, and the logs of their weights."""
    centre, log_weight = np.full((len(member), 3), math.nan), np.zeros(len(member))
    weight = np.array([s.sigma_rad**-2.0 for s in sources])
    for part, room in enumerate(_ROOM_RAD):
        shown = np.array([s.deviation_rad[part] for s in sources])
        if not (seen := ~np.isnan(shown)).any():
            continue
        held = member & seen
        some, count = held.any(axis=1), held.sum(axis=1)
        values = np.where(held, shown, 0.0)
        if part == 0:
            first = shown[held.argmax(axis=1)][:, np.newaxis]
            values = np.where(held, first + wrap_pi(shown - first), 0.0)
        mine = np.where(held, weight, 0.0)
        total = np.where(some, mine.sum(axis=1), 1.0)
        mean = (mine * values).sum(axis=1) / total
        spread = (mine * (values - mean[:, np.newaxis]) ** 2).sum(axis=1)
        centre[some, part] = mean[some]
        log_weight -= (seen.sum() - count) * math.log(room)
        known = np.where(held, np.log(weight), 0.0).sum(axis=1) - np.log(total) - spread
        log_weight += some * (0.5 * known - 0.5 * (count - 1) * math.log(2.0 * math.pi) - math.log(room))
    return centre, log_weight
