"""Does one command calibrate every kind of vehicle? All simulated vehicles, many seeds, compasses badly bent.

    python scripts/campaigns/vehicles.py [--seeds 20] [--share 1.0] [--vehicle rover]... [--quality lossy]...
                                         [--workers 2]

The steering compass is wrong by `share` of the horizontal field, in a direction drawn by the seed: it bends
the autopilot's own yaw while it turns; over links of these qualities. Judged by the simulator's truth.
"claimed" is the sigma of those that were written, and behind it the share of them whose rms error is within 1
and 1.96 of it.
"""

from __future__ import annotations

import itertools
import math
import random
import statistics
import sys
from collections.abc import Iterable
from dataclasses import dataclass, replace
from functools import partial

from campaign import Several, ended, folder, options, tried

from mavcompass.errors import MavCompassError
from mavcompass.procedure.settings import CalibrateSettings
from mavcompass.simulation.heading_error import heading_error_rms_deg
from mavcompass.simulation.physics.compasses import draw_compasses
from mavcompass.simulation.physics.profiles import PROFILES
from mavcompass.simulation.vehicle import SimulatedAutopilot
from mavcompass.vehicle.calibrating import calibrate_on
from mavcompass.vehicle.links.faults import Faults, FaultyLink
from mavcompass.vehicle.links.simulated import SimulatedLink

TARGET_DEG = 0.5
QUALITIES = {
    "clean": Faults(),
    "radio": Faults(loss=0.05, latency_s=0.1, reorder=0.02),
    "lossy": Faults(loss=0.3, duplicate=0.05, reorder=0.1, latency_s=0.3),
}


@dataclass(frozen=True)
class Run:
    """Hold one run: what was left of the heading error, what was claimed, what went wrong."""

    before_deg: float
    after_deg: float
    sigma_deg: float
    positions: int
    vehicle_s: float
    trouble: str = ""


def bent_vehicle(kind: str, seed: int, share: float) -> SimulatedAutopilot:
    """Make a vehicle whose first compass is wrong by a share of the horizontal field."""
    horizontal_mgauss = SimulatedAutopilot(kind, seed=seed).world.horizontal_mgauss
    setups = list(draw_compasses(seed, horizontal_mgauss, "old"))
    toward = random.Random(f"bent {seed}").uniform(0.0, 2.0 * math.pi)
    iron = setups[0].model.iron
    x, y, z = iron.offsets_mgauss
    wrong = share * horizontal_mgauss
    bent = (x + wrong * math.cos(toward), y + wrong * math.sin(toward), z + 20.0)
    setups[0] = replace(setups[0], in_force=replace(iron, offsets_mgauss=bent))
    return SimulatedAutopilot(kind, seed=seed, compasses=setups)


def run(seed: int, kind: str, share: float, quality: str) -> Run:
    """Calibrate one vehicle."""
    vehicle = bent_vehicle(kind, seed, share)
    before_deg = heading_error_rms_deg(vehicle)
    link = FaultyLink(SimulatedLink(vehicle), QUALITIES[quality], seed)
    settings = CalibrateSettings(writing="yes")
    with folder() as undo:
        try:
            report = calibrate_on(link, f"sim:{kind}", settings, undo_directory=undo)
        except MavCompassError as error:
            return Run(before_deg, heading_error_rms_deg(vehicle), math.nan, 0, vehicle.time_s, str(error))
    trouble = "" if report.written else "; ".join(report.results[0].reasons or report.messages)
    return Run(
        before_deg,
        heading_error_rms_deg(vehicle),
        report.results[0].heading_sigma_deg,
        len(report.windows),
        report.duration_s,
        trouble,
    )


def rms(values: Iterable[float]) -> float:
    """Return the root mean square; nan of nothing."""
    squares = [value**2 for value in values]
    return math.sqrt(statistics.mean(squares)) if squares else math.nan


def main() -> int:
    """Run the campaign and print the table."""
    wanted = options(
        __doc__,
        seeds=20,
        first_seed=100,
        share=1.0,
        vehicle=Several([*PROFILES]),
        quality=(Several(QUALITIES), "of the link; clean"),
        workers=1,
    )
    print(
        "vehicle, link           runs  within  before deg  after deg median / max    rms  claimed  1, 1.96 s"
        "  positions  vehicle s median"
    )
    table = {}
    kinds = wanted.vehicle or [name for name, kind in PROFILES.items() if kind.takes_targets]
    for kind, quality in itertools.product(kinds, wanted.quality or ("clean",)):
        seeds = range(wanted.first_seed, wanted.first_seed + wanted.seeds)
        one = partial(run, kind=kind, share=wanted.share, quality=quality)
        table[f"{kind}, {quality}"] = runs = [*tried(one, seeds, workers=wanted.workers)]
        show(f"{kind}, {quality}", seeds, runs)
    return ended(wanted.json, table, wrong=False)


def show(name: str, seeds: Iterable[int], runs: list[Run]) -> None:
    """Print one line, and below it what went wrong."""
    good = [r for r in runs if not r.trouble and r.after_deg <= TARGET_DEG]
    written = [r for r in runs if not r.trouble]
    ratios = [r.after_deg / r.sigma_deg for r in written]
    covered = [100.0 * sum(x < limit for x in ratios) / max(len(ratios), 1) for limit in (1.0, 1.96)]
    print(
        f"{name:22} {len(runs):5} {len(good):7} {statistics.mean(r.before_deg for r in runs):11.1f}"
        f" {statistics.median(r.after_deg for r in runs):17.2f} / {max(r.after_deg for r in runs):.2f}"
        f" {rms(r.after_deg for r in written):6.2f} {rms(r.sigma_deg for r in written):8.2f}"
        f" {covered[0]:5.0f} {covered[1]:4.0f}"
        f" {statistics.mean(r.positions for r in runs):9.1f}"
        f" {statistics.median(r.vehicle_s for r in runs):17.1f}",
        flush=True,
    )
    for seed, one in zip(seeds, runs, strict=True):
        if one.trouble or one.after_deg > TARGET_DEG:
            print(f"    seed {seed}: {one.after_deg:.2f} deg left. {one.trouble}")


if __name__ == "__main__":
    sys.exit(main())
