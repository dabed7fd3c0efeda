"""Does one command calibrate every kind of vehicle? All simulated vehicles, many seeds, compasses badly bent.

    python scripts/campaigns/vehicles.py [--seeds 20] [--share 1.0] [--vehicle rover]... [--quality lossy]...
                                         [--effects 3] [--workers 2]

The steering compass is wrong by `share` of the horizontal field, in a direction drawn by the seed: it bends
the autopilot's own yaw while it turns; over links of these qualities, and with up to so many effects of the
catalogue, at their typical size and either sign. Judged by the simulator's truth. "claimed" is the sigma of
those that were accepted, and behind it the share of them whose rms error is within 1 and 1.96 of it: live,
and of the recording that was made meanwhile.
"""

from __future__ import annotations

import itertools
import math
import random
import statistics
import sys
from collections.abc import Iterable
from dataclasses import dataclass
from functools import partial
from typing import NamedTuple

from campaign import Several, borrow, ended, folder, options, rms, share, tried

from mavcompass.calibration.calibrate import calibrate_track
from mavcompass.calibration.result import CalibrationResult
from mavcompass.errors import MavCompassError
from mavcompass.procedure.settings import CalibrateSettings
from mavcompass.simulation.effects.effect import Distortion, Setting
from mavcompass.simulation.effects.registry import catalogue
from mavcompass.simulation.heading_error import heading_error_rms_deg
from mavcompass.simulation.physics.profiles import PROFILES
from mavcompass.simulation.vehicle import SimulatedAutopilot
from mavcompass.vehicle.calibrating import calibrate_on
from mavcompass.vehicle.links.faults import Faults, FaultyLink
from mavcompass.vehicle.links.simulated import SimulatedLink

borrow("procedure")
from bent_vehicles import bent_compasses  # noqa: E402

TARGET_DEG = 0.5
QUALITIES = {
    "clean": Faults(),
    "radio": Faults(loss=0.05, latency_s=0.1, reorder=0.02),
    "lossy": Faults(loss=0.3, duplicate=0.05, reorder=0.1, latency_s=0.3),
}


class Claim(NamedTuple):
    """Hold what a door would leave of the heading error, and what it claims; nan where it refuses."""

    error_deg: float = math.nan
    sigma_deg: float = math.nan


REFUSED = Claim()


@dataclass(frozen=True)
class Run:
    """Hold one run: what was left of the heading error, what was claimed, what went wrong."""

    before_deg: float
    after_deg: float
    vehicle_s: float
    positions: int = 0
    live: Claim = REFUSED
    recorded: Claim = REFUSED
    trouble: str = ""


def bent_vehicle(kind: str, seed: int, share: float, effects: int = 0) -> SimulatedAutopilot:
    """Make a vehicle whose first compass is wrong by a share of the horizontal field, and has effects."""
    mgauss = share * SimulatedAutopilot(kind, seed=seed).world.horizontal_mgauss
    toward = random.Random(f"bent {seed}").uniform(0.0, 2.0 * math.pi)
    setups = bent_compasses(kind, seed, mgauss, toward, 20.0)
    drawn = drawn_effects(random.Random(f"effects {kind} {seed}"), effects) if effects else ()
    return SimulatedAutopilot(kind, seed=seed, compasses=setups, effects=drawn)


def drawn_effects(rng: random.Random, most: int) -> list[Distortion]:
    """Draw one effect of the catalogue to so many, at their typical size; what has either sign, by chance."""
    settings = []
    for name in rng.sample(sorted(catalogue()), rng.randint(1, most)):
        signed = {
            p.name: p.default * (rng.choice((-1.0, 1.0)) if p.low == -p.high and not p.integer else 1.0)
            for p in catalogue()[name].parameters
        }
        settings.append(Setting.of(catalogue()[name], signed))
    return [Distortion(settings)]


def run(seed: int, kind: str, share: float, quality: str, effects: int) -> Run:
    """Calibrate one vehicle, and its recording."""
    vehicle = bent_vehicle(kind, seed, share, effects)
    before_deg = heading_error_rms_deg(vehicle)
    link = FaultyLink(SimulatedLink(vehicle), QUALITIES[quality], seed)
    settings = CalibrateSettings(writing="yes")
    with folder() as undo:
        try:
            report = calibrate_on(link, f"sim:{kind}", settings, undo_directory=undo)
        except MavCompassError as error:
            return Run(before_deg, heading_error_rms_deg(vehicle), vehicle.time_s, trouble=str(error))

    def claimed(result: CalibrationResult) -> Claim:
        if not result.accepted:
            return REFUSED
        return Claim(heading_error_rms_deg(vehicle, 1, result.correction), result.heading_sigma_deg)

    try:
        # What was written meanwhile is in the recording, too.
        turned = report.track.between(-math.inf, report.windows[-1].end_s)
        recorded = claimed(calibrate_track(turned))
    except MavCompassError:
        recorded = REFUSED
    trouble = "" if report.accepted else "; ".join(report.results[0].reasons or report.messages)
    return Run(
        before_deg,
        heading_error_rms_deg(vehicle),
        report.duration_s,
        len(report.windows),
        claimed(report.results[0]),
        recorded,
        trouble or ("undone" if report.undone else ""),
    )


def main() -> int:
    """Run the campaign and print the table."""
    wanted = options(
        __doc__,
        seeds=20,
        first_seed=100,
        share=1.0,
        vehicle=Several([*PROFILES]),
        quality=(Several(QUALITIES), "of the link; clean"),
        effects=0,
        workers=1,
    )
    print("vehicle, link           runs  within  before deg  after deg median / max  positions  on it, s")
    table = {}
    kinds = wanted.vehicle or [name for name, kind in PROFILES.items() if kind.takes_targets]
    for kind, quality in itertools.product(kinds, wanted.quality or ("clean",)):
        seeds = range(wanted.first_seed, wanted.first_seed + wanted.seeds)
        one = partial(run, kind=kind, share=wanted.share, quality=quality, effects=wanted.effects)
        table[f"{kind}, {quality}"] = runs = [*tried(one, seeds, workers=wanted.workers)]
        show(f"{kind}, {quality}", seeds, runs)
    every = [one for runs in table.values() for one in runs]
    beyond = [cover(door, [getattr(one, door) for one in every]) for door in ("live", "recorded")]
    return ended(wanted.json, table, wrong=any(beyond))


def show(name: str, seeds: Iterable[int], runs: list[Run]) -> None:
    """Print one line, and below it what went wrong."""
    good = [r for r in runs if not r.trouble and r.after_deg <= TARGET_DEG]
    print(
        f"{name:22} {len(runs):5} {len(good):7} {statistics.mean(r.before_deg for r in runs):11.1f}"
        f" {statistics.median(r.after_deg for r in runs):17.2f} / {max(r.after_deg for r in runs):.2f}"
        f" {statistics.mean(r.positions for r in runs):9.1f}"
        f" {statistics.median(r.vehicle_s for r in runs):17.1f}",
        flush=True,
    )
    for seed, one in zip(seeds, runs, strict=True):
        if one.trouble or one.after_deg > TARGET_DEG:
            print(f"    seed {seed}: {one.after_deg:.2f} deg left. {one.trouble}")


def cover(door: str, claims: Iterable[Claim]) -> int:
    """Print what a door claimed beside what was so; return how many are beyond four of their sigmas."""
    accepted = [claim for claim in claims if not math.isnan(claim.sigma_deg)]
    ratios = [claim.error_deg / claim.sigma_deg for claim in accepted]
    within, beyond = [sum(x < limit for x in ratios) for limit in (1.0, 1.96)], sum(x > 4.0 for x in ratios)
    print(
        f"{door:9} accepted {len(accepted)}: rms {rms(c.error_deg for c in accepted):.2f} deg, claimed"
        f" {rms(c.sigma_deg for c in accepted):.2f}; within 1 sigma {share(within[0], len(accepted))},"
        f" 1.96 {share(within[1], len(accepted))}; beyond 4: {beyond}"
    )
    return beyond


if __name__ == "__main__":
    sys.exit(main())
