"""Compare a simulator's recording with a vehicle's: which effects each lacks, and how far that gap closed.

The simulator's recording teaches what the simulator makes of a healthy vehicle: its noise, its lag, the iron
and the calibration that it flies with. What the vehicle's recording shows beyond that, the simulator lacks.
Seen the other way round, the vehicle lacks what the simulator's recording shows beyond the vehicle's: too
much noise, a lag. Flown again with what was found, the simulator is asked anew: what it promised, and what
it reached.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, replace
from typing import Literal

import numpy as np

from mavcompass.blas import single_thread
from mavcompass.frames import FloatArray
from mavcompass.gap.diagnose import Replayed, diagnose_gap
from mavcompass.gap.export import follows_places, settings_of
from mavcompass.gap.replay.nominal import Replay, replay
from mavcompass.gap.replay.rows import shared_period_s
from mavcompass.gap.residual.floor import heading_error_rad, rms
from mavcompass.gap.result import Cause, Closing, Diagnosis
from mavcompass.gap.tables import usual
from mavcompass.printable import plain
from mavcompass.simulation.effects import catalogue, get
from mavcompass.simulation.effects.effect import Distortion
from mavcompass.track import Track

SCHEMA = "mavcompass.gap-compare/1"
Lacks = Literal["simulator", "vehicle"]
_EXPLAINED = ("named", "ambiguous", "named_with_remainder")


@dataclass(frozen=True, slots=True)
class Difference:
    """Hold an effect that one of the two has and the other lacks."""

    cause: Cause
    lacks: Lacks


@dataclass(frozen=True, slots=True)
class Achieved:
    """Hold how far the gap closed when the simulator was flown again, in the field.

    Attributes:
        path: the simulator's recording. again: the vehicle beside the simulator as it was flown again.
        shrink: 1 - (left^2 - floor^2) / (gap^2 - floor^2), as promised ones are counted; its 95 % interval.
        heading_shrink: the same in the heading; nan where that gap is no larger than its floor is known.
    """

    path: str
    again: Diagnosis
    shrink: float
    ci95: tuple[float, float]
    heading_shrink: float


@dataclass(frozen=True, slots=True)
class Comparison:
    """Hold both directions of a comparison, and what flying again achieved.

    Attributes:
        vehicle: the vehicle beside the simulator; simulator: the simulator beside the vehicle.
        differences: what each lacks, the largest first.
        achieved: one for each recording of the simulator flown again.
        held: the shrink that those effects promise which the simulator can hold; None where it is not told.
    """

    vehicle: Diagnosis
    simulator: Diagnosis
    differences: tuple[Difference, ...]
    achieved: tuple[Achieved, ...] = ()
    held: float | None = None

    @property
    def told(self) -> Diagnosis:
        """Return the direction that explains the gap: the vehicle's unless only the simulator's does."""
        lacking = {difference.lacks for difference in self.differences}
        return self.simulator if lacking == {"vehicle"} else self.vehicle

    def to_json(self) -> dict[str, object]:
        """Return the document `mavcompass.gap-compare/1`, plain values only."""
        told = self.told.to_json()
        field = self.told.field
        return {
            "schema": SCHEMA,
            "simulator": self.simulator.to_json()["log"],
            "vehicle": self.vehicle.to_json()["log"],
            "verdict": self.told.verdict,
            "differences": [_difference(d) for d in self.differences],
            "where": told["where"],
            "gap": told["gap"],
            "unknown": told["unknown"],
            "not_testable": told["not_testable"],
            "promised": {
                "shrink": field.shrink,
                "ci95": list(field.shrink_ci95),
                "by_what_the_simulator_holds": self.held,
            },
            "achieved": _achieved(self.achieved[-1]) if self.achieved else None,
            "flights": [_achieved(one) for one in self.achieved],
            "seconds": self.vehicle.seconds
            + self.simulator.seconds
            + sum(one.again.seconds for one in self.achieved),
        }


@single_thread()
def compare(
    simulator: Track,
    vehicle: Track,
    again: Sequence[Track] = (),
    instance: int = 1,
    progress: Callable[[str], None] = lambda doing: None,
) -> Comparison:
    """Tell what a simulator lacks beside a vehicle, and the vehicle beside it; judge flights `again`.

    Trajectory, place and rates may differ. Raises BadRecording where there is too little to compare.
    """
    progress("the vehicle beside the simulator")
    replayed: Replayed = {}
    forth = diagnose_gap(vehicle, simulator, instance=instance, progress=progress, replayed=replayed)
    progress("the simulator beside the vehicle")
    _give(forth, simulator, replayed)
    back = diagnose_gap(
        simulator, vehicle, instance=instance, progress=progress, among=_backwards(forth), replayed=replayed
    )
    comparison = Comparison(forth, back, _differences(forth, back))
    return flown_again(comparison, simulator, vehicle, again, progress)


@single_thread()
def flown_again(
    comparison: Comparison,
    simulator: Track,
    vehicle: Track,
    again: Sequence[Track],
    progress: Callable[[str], None] = lambda doing: None,
) -> Comparison:
    """Judge the simulator's flights with what was found in it, on the vehicle's recording that it was for.

    Raises BadRecording where there is too little to compare.
    """
    achieved = list(comparison.achieved)
    for track in again:
        progress("the simulator flown again")
        forth = comparison.vehicle
        closer = None
        # What follows from places a baseline keeps for itself, as its floor.
        if not follows_places(forth):
            closer = diagnose_gap(vehicle, track, instance=forth.compass, progress=progress)
        if closer is None or (forth.effects and not _believed(closer)):
            closer = _by_what_it_has(forth, simulator, vehicle, track, progress)
        achieved.append(_reached(track.source, forth, closer))
    return replace(comparison, achieved=tuple(achieved))


def _believed(beside: Diagnosis) -> bool:
    """Tell whether a flight's calibration is near enough to its iron to teach what could contradict it."""
    return beside.in_force is None or beside.in_force.sigma_heading_deg < math.degrees(
        usual.flown.believed_rad
    )


def _by_what_it_has(
    forth: Diagnosis, simulator: Track, vehicle: Track, track: Track, progress: Callable[[str], None]
) -> Diagnosis:
    """Judge a flight by the effects that are found in it, as they would act on the vehicle's motion.

    What is left is what the vehicle's causes leave, and by how much the simulator's act otherwise.
    """
    among = forth.effects | {e.id for e in catalogue().values() if e.kind == "random"}
    has = diagnose_gap(track, simulator, instance=forth.compass, progress=progress, among=among)
    period_s = shared_period_s([vehicle, simulator], forth.compass)
    late_s = replay(simulator, forth.compass, period_s=period_s).late_s
    replayed, drawn = replay(vehicle, forth.compass, period_s=period_s, late_s=late_s), forth.picture
    assert drawn is not None

    left = drawn.after_mgauss + _made(forth, replayed) - _made(has, replayed)
    # A named scatter is in what is measured; of it only counts how much more or less the simulator has.
    whole = rms(left[drawn.test])
    scatter2 = max(rms(drawn.after_mgauss[drawn.test]) ** 2 - forth.field.after**2, 0.0)
    other2 = abs(_scatter2(has) - _scatter2(forth))
    field = math.sqrt(max(whole**2 - scatter2, 0.0) + other2)
    turned = heading_error_rad(replayed, replayed.nominal_mgauss + left, replayed.nominal_mgauss)
    return replace(
        forth,
        field=replace(forth.field, nominal=field),
        heading=replace(forth.heading, nominal=math.degrees(rms(turned[drawn.test]))),
        picture=replace(drawn, before_mgauss=left * (field / max(whole, 1e-9))),
        seconds=has.seconds,
    )


def _made(diagnosis: Diagnosis, replayed: Replay) -> FloatArray:
    """Return what the causes make of the field on a recording's motion, (N, 3)."""
    # Of a flight with what was found in another, the likeliest of that is what it has.
    causes = (c for c in diagnosis.causes or diagnosis.look_alikes if get(c.effect).kind == "mean")
    return Distortion(settings_of(causes)).run(replayed.signals, None).reading.mag_mgauss


def _give(forth: Diagnosis, simulator: Track, replayed: Replayed) -> None:
    """Give the simulator's replay what it was found to lack, so that only what the vehicle lacks is left."""
    if forth.verdict not in ("named", "ambiguous"):
        return
    for key, (track, own) in replayed.items():
        if track is simulator:
            more = _made(forth, own) - own.signals.reading.mag_mgauss
            measured = replace(own.measured, mag_mgauss=own.measured.mag_mgauss + more)
            replayed[key] = (track, replace(own, measured=measured))


def _scatter2(diagnosis: Diagnosis) -> float:
    """Return the variance of the scatter that is named, mG^2."""
    return sum(cause.removes_mgauss**2 for cause in diagnosis.causes if get(cause.effect).kind == "random")


def _backwards(forth: Diagnosis) -> frozenset[str] | None:
    """Name what is to be weighed the other way round; None for everything, where nothing was explained.

    Amounts alone tell anything new; what was found is there for what is not quite the same.
    """
    if forth.verdict not in ("named", "ambiguous"):
        return None
    return forth.effects | {e.id for e in catalogue().values() if all(p.low >= 0.0 for p in e.parameters)}


def _differences(forth: Diagnosis, back: Diagnosis) -> tuple[Difference, ...]:
    """Collect what each lacks; what shows both ways, with either sign, is counted as the simulator's."""
    found = [Difference(cause, "simulator") for cause in _causes(forth)]
    known = forth.effects | {alias for e in forth.effects for alias in get(e).aliases}
    alone = not found
    more = (c for c in _causes(back) if alone or (_amount(c) and c.effect not in known))
    found += [Difference(cause, "vehicle") for cause in more]
    return tuple(sorted(found, key=lambda d: -d.cause.removes_mgauss))


def _causes(diagnosis: Diagnosis) -> Iterable[Cause]:
    return diagnosis.causes if diagnosis.verdict in _EXPLAINED else ()


def _amount(cause: Cause) -> bool:
    """Tell whether a cause is an amount, which cannot be negative: there may only be more of it."""
    parameters = {p.name: p for p in get(cause.effect).parameters}
    return all(parameters[name].low >= 0.0 for name in cause.parameters)


def _reached(path: str, before: Diagnosis, again: Diagnosis) -> Achieved:
    """Measure how far the gap closed on the held-out parts of the vehicle's recording."""
    gap, left = _squares(before), _squares(again)
    size = min(len(gap), len(left))
    both = np.hstack([gap[:size], left[:size]])
    both = both[(both[:, 1] > 0.0) & (both[:, 3] > 0.0)]
    interval = (math.nan, math.nan)
    if len(both) >= usual.flown.fewest:
        picks = np.random.default_rng(usual.shrink.seed).integers(
            len(both), size=(usual.shrink.resamples, len(both))
        )
        total = both[picks].sum(axis=1).T
        excess2 = total[0] / total[1] - before.field.floor**2
        shrink = 1.0 - (_off(total[2] / total[3], again.field.floor**2) / excess2)[excess2 > 0.0]
        if shrink.size:
            low, high = np.quantile(shrink, [0.025, 0.975]).tolist()
            interval = (min(max(low, -1.0), 1.0), min(high, 1.0))
    whole2 = before.field.nominal**2 - before.field.floor**2
    stays2 = float(_off(np.array(again.field.nominal**2), again.field.floor**2))
    of_field = 1.0 - stays2 / whole2 if whole2 > 0.0 else 0.0
    return Achieved(path, again, of_field, interval, _heading_shrink(before.heading, again.heading))


def _off(left2: FloatArray, floor2: float) -> FloatArray:
    """Return by how much the squared residual lies off the floor's, mG^2.

    Above it something is missing. Well below it the simulator has too much noise, which must not count as a
    gap that closed; a floor holds something for the model itself, and is not known to a tenth.
    """
    noise2 = usual.flown.floor_known * floor2 - usual.compass.discrepancy_mgauss**2
    return np.maximum(np.maximum(left2 - floor2, noise2 - left2), 0.0)


def _heading_shrink(before: Closing, again: Closing) -> float:
    """Return the share of the excess over the floor that is gone; each beside the floor of its flight."""
    excess = before.nominal**2 - before.floor**2
    left = max(again.nominal**2 - again.floor**2, 0.0)
    return 1.0 - left / excess if usual.flown.floor_known * before.nominal**2 > before.floor**2 else math.nan


def _squares(diagnosis: Diagnosis) -> FloatArray:
    """Return sum and count of the squared held-out residual without effects, by block of time, (B, 2)."""
    picture = diagnosis.picture
    assert picture is not None
    block = np.floor(picture.time_s[picture.test] / usual.shrink.block_s).astype(np.int64)
    square = np.sum(picture.before_mgauss[picture.test] ** 2, axis=1)
    return np.stack([np.bincount(block, square), 3.0 * np.bincount(block)], axis=1)


def _difference(difference: Difference) -> dict[str, object]:
    cause = plain(difference.cause)
    del cause["separation"]
    rms = {"field_rms_mgauss": cause.pop("removes_mgauss"), "heading_rms_deg": cause.pop("removes_deg")}
    return {**cause, "lacks": difference.lacks, **rms}


def _achieved(achieved: Achieved) -> dict[str, object]:
    return {
        "path": achieved.path,
        "shrink": achieved.shrink,
        "ci95": list(achieved.ci95),
        "heading_shrink": plain(achieved.heading_shrink),
        "field_rms_mgauss": {"left": achieved.again.field.nominal, "floor": achieved.again.field.floor},
        "heading_rms_deg": {"left": achieved.again.heading.nominal, "floor": achieved.again.heading.floor},
    }
