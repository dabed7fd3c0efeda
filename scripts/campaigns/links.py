"""How bad may a link be? Whole calibrations of simulated vehicles over links of all qualities.

    python scripts/campaigns/links.py [--runs 20] [--vehicle rover].. [--quality lossy].. [--json FILE]

Heading errors are against the simulator's truth, rms over the circle.
"""

from __future__ import annotations

import argparse
import json
import tempfile
from collections import Counter
from pathlib import Path

from mavcompass.errors import MavCompassError
from mavcompass.procedure.calibrate import CalibrateSettings
from mavcompass.simulation.heading_error import heading_error_rms_deg
from mavcompass.vehicle.calibrating import calibrate_on
from mavcompass.vehicle.links.faults import Faults, FaultyLink
from mavcompass.vehicle.links.simulated import SimulatedLink, simulated_autopilot
from mavcompass.vehicle.transport import VEHICLES

QUALITIES = {
    "clean": Faults(),
    "radio": Faults(loss=0.05, latency_s=0.1, reorder=0.02),
    "lossy": Faults(loss=0.3, duplicate=0.05, reorder=0.1, latency_s=0.3),
}
Row = dict[str, object]


def calibrate_over(quality: str, kind: str, seed: int) -> Row:
    """Run one calibration and say how it ended."""
    vehicle = simulated_autopilot(kind, seed)
    before_deg = heading_error_rms_deg(vehicle, 1)
    with (
        FaultyLink(SimulatedLink(vehicle), QUALITIES[quality], seed) as link,
        tempfile.TemporaryDirectory() as undo,
    ):
        start_s = link.now()
        try:
            report = calibrate_on(
                link, f"sim:{kind}", CalibrateSettings(writing="yes"), undo_directory=Path(undo)
            )
            told = "written" if report.written and not report.undone else "not accepted or undone"
        except MavCompassError as error:
            told = f"{type(error).__name__}: {error.what}"
        seconds = link.now() - start_s
    after_deg = heading_error_rms_deg(vehicle, 1)
    row: Row = {"quality": quality, "vehicle": kind, "seed": seed, "told": told, "seconds": seconds}
    return row | {"before_deg": before_deg, "after_deg": after_deg}


def main() -> None:
    """Run the campaign and print the table."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--runs", type=int, default=20)
    parser.add_argument("--first-seed", type=int, default=0)
    parser.add_argument("--vehicle", action="append", choices=VEHICLES)
    parser.add_argument("--quality", action="append", choices=QUALITIES)
    parser.add_argument("--json", type=Path)
    options = parser.parse_args()
    rows: list[Row] = []
    print("quality  vehicle          written  vehicle s (median)  heading error deg (median, max)")
    for quality in options.quality or QUALITIES:
        for kind in options.vehicle or VEHICLES:
            seeds = range(options.first_seed, options.first_seed + options.runs)
            found = [calibrate_over(quality, kind, seed) for seed in seeds]
            rows += found
            show(quality, kind, found)
    if options.json:
        options.json.write_text(json.dumps(rows, indent=1))


def show(quality: str, kind: str, found: list[Row]) -> None:
    """Print one line, and below it what kept the others from being written."""
    done = [row for row in found if row["told"] == "written"]
    seconds = sorted(float(str(row["seconds"])) for row in found)
    errors = sorted(float(str(row["after_deg"])) for row in done) or [float("nan")]
    middle = f"{seconds[len(seconds) // 2]:6.1f}"
    print(
        f"{quality:8} {kind:16} {len(done):3}/{len(found):<3} {middle:>14}"
        f" {errors[len(errors) // 2]:22.2f} {errors[-1]:6.2f}",
        flush=True,
    )
    for told, count in Counter(str(row["told"]) for row in found if row not in done).most_common():
        print(f"    {count} x {told}")


if __name__ == "__main__":
    main()
