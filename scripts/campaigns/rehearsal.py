"""Is the heading error that `gap rehearse` tells the one that a whole calibration then leaves?

    python scripts/campaigns/rehearsal.py RECORDINGS...      of real firmware, with a calibration in them
    python scripts/campaigns/rehearsal.py --embedded 2       the whole procedure on simulated vehicles

A recording is a folder with `flight.BIN` or `flight.ulg`, and `truth.json`, which holds the heading error
that the live calibration of that flight was judged to have: `live_result` with `level_rms_deg` and
`tilt15_rms_deg`, or `heading_rms_deg` with `level` and `tilt15`. Folders of one vehicle share the part of
their name after the first `-`, up to `-reboot` or `-disarmed`; one flight of each is rehearsed, and what is
told is held against all its calibrations but those that were refused.

Embedded, a vehicle of each kind is calibrated once; that recording is diagnosed and rehearsed. Then the whole
dialogue with the simulated firmware runs on the same compasses again, with other seeds: other noise, sway,
ground and start. Judged by the simulator's truth, whose field is the world model's without an anomaly.
"""

from __future__ import annotations

import itertools
import json
import math
import sys
from collections import defaultdict
from collections.abc import Iterable, Iterator, Sequence
from pathlib import Path

import numpy as np
from campaign import ended, folder, options, share

from mavcompass.blas import single_thread
from mavcompass.correction import FieldCorrection
from mavcompass.errors import BadRecording, PoorCalibration, Refused
from mavcompass.gap import diagnose_gap
from mavcompass.gap.rehearsal import Expected
from mavcompass.gap.rehearsal.draws import Draws
from mavcompass.gap.rehearsal.kind import kind_of
from mavcompass.gap.rehearsal.rehearse import calibrations
from mavcompass.gap.residual.floor import rms
from mavcompass.logs import read_track
from mavcompass.procedure.report import CalibrationReport
from mavcompass.procedure.settings import CalibrateSettings
from mavcompass.simulation.heading_error import heading_error_rms_deg, heading_errors_rad
from mavcompass.simulation.vehicle import SimulatedAutopilot
from mavcompass.track import Track
from mavcompass.vehicle.calibrating import calibrate_on
from mavcompass.vehicle.links.simulated import SimulatedLink

KINDS = ("rover", "copter", "boat", "px4-copter")
EFFECTS = ((), ("motor_current:x=1.5,y=-0.8",), ("noise_excess:sigma_mgauss=12",))
_NOTHING_WRITTEN = (PoorCalibration.exit_code, Refused.exit_code)
PLACES = ("level", "leaning")
Reached = tuple[float, float]  # level and tilted, rms in degrees


def told(tracks: Iterable[Track], draws: int) -> tuple[str, Expected, Expected]:
    """Rehearse the first recording that can be diagnosed; return the verdict and the errors told."""
    for track in tracks:
        try:
            with single_thread():
                diagnosis = diagnose_gap(track)
                kind = kind_of(track, diagnosis)
                errors = calibrations(kind, Draws(kind, 1), draws).errors
        except BadRecording:  # the log of a flight with a restart in it may end before it began
            continue
        return f"{diagnosis.verdict} {','.join(sorted(diagnosis.effects))}", errors.level, errors.tilt_15
    raise BadRecording("None of the vehicle's recordings can be diagnosed.", "Name others.")


def recorded(folders: Sequence[Path]) -> Iterator[tuple[str, Iterable[Track], list[Reached]]]:
    """Yield each vehicle's name, its flights, and what its calibrations reached."""
    groups: dict[str, list[tuple[Path, Reached]]] = defaultdict(list)
    for place in sorted(folders):
        truth = json.loads((place / "truth.json").read_text(encoding="utf-8"))
        judged = truth.get("heading_rms_deg") or {}
        result = truth.get("live_result") or {}
        level, tilted = (
            judged.get("level", result.get("level_rms_deg")),
            judged.get("tilt15", result.get("tilt15_rms_deg")),
        )
        if level is None or tilted is None or truth.get("exit_code") in _NOTHING_WRITTEN:
            continue
        vehicle = place.name.partition("-")[2] or place.name
        for option in ("-reboot", "-disarmed"):
            vehicle = vehicle.removesuffix(option)
        groups[vehicle].append((place, (level, tilted)))
    for vehicle, runs in sorted(groups.items()):
        logs = [place / name for place, _ in runs for name in ("flight.BIN", "flight.ulg")]
        tracks = (read_track(log) for log in reversed(logs) if log.exists())
        yield vehicle, tracks, [reached for _, reached in runs]


def embedded(vehicles: int, again: int) -> Iterator[tuple[str, Iterable[Track], list[Reached]]]:
    """Yield the same for vehicles of the simulation: the whole procedure, `again` times each."""
    for kind in KINDS:
        for number in range(vehicles):
            effects = EFFECTS[number % len(EFFECTS)]
            seed = 300 + number
            first, report = calibrated(kind, seed, seed, effects)
            reached = [judged(first, report)]
            for other in range(again - 1):
                vehicle, repeated = calibrated(kind, seed, 1000 + 10 * seed + other, effects)
                reached.append(judged(vehicle, repeated))
            yield f"{kind} {seed} {','.join(effects) or '-'}", [report.track], reached


def calibrated(
    kind: str, iron: int, seed: int, effects: Sequence[str]
) -> tuple[SimulatedAutopilot, CalibrationReport]:
    """Calibrate a vehicle with the compasses of one seed in the circumstances of another."""
    compasses = SimulatedAutopilot(kind, seed=iron).board.compass_setups
    vehicle = SimulatedAutopilot(kind, seed=seed, compasses=compasses, effects=effects)
    with folder() as undo:
        settings = CalibrateSettings(writing="yes")
        report = calibrate_on(SimulatedLink(vehicle), f"sim:{kind}", settings, undo_directory=undo)
    return vehicle, report


def judged(vehicle: SimulatedAutopilot, report: CalibrationReport) -> Reached:
    """Return the rms heading error of what was found, level and leaning by 15 degrees in eight directions."""
    correction: FieldCorrection = report.results[0].correction
    lean = math.radians(15.0)
    errors = [
        heading_errors_rad(vehicle, 1, correction, lean * math.cos(toward), lean * math.sin(toward))
        for toward in np.arange(8) * math.pi / 4.0
    ]
    return heading_error_rms_deg(vehicle, 1, correction), math.degrees(rms(np.array(errors)))


def main() -> int:
    """Print the table: told, reached, and how often the one covers the other."""
    wanted = options(
        __doc__,
        recordings=list,
        embedded=(0, "vehicles of each kind"),
        again=(3, "whole procedures on each of them"),
        draws=1000,
    )
    groups = [recorded(wanted.recordings), embedded(wanted.embedded, wanted.again)]
    table = []
    for vehicle, tracks, reached in itertools.chain(*groups):
        verdict, *expected = told(tracks, wanted.draws)
        line = f"{vehicle:28} {verdict:24}"
        for where, one, values in zip(PLACES, expected, zip(*reached, strict=True), strict=True):
            inside = sum(value <= one.interval95[1] for value in values)
            row = {"vehicle": vehicle, "where": where, "told": one, "reached": values, "inside": inside}
            table.append(row)
            line += f" | {one.rms:.2f} (below {one.interval95[1]:.2f}), reached "
            line += f"{min(values):.2f} to {max(values):.2f}: {inside}/{len(values)}"
        print(line, flush=True)
    for where in PLACES:
        rows = [row for row in table if row["where"] == where]
        ratios = [value / row["told"].rms for row in rows for value in row["reached"]]
        inside = share(sum(row["inside"] for row in rows), len(ratios))
        print(f"  {where}: {inside} below the bound; rms of reached over told: {rms(np.array(ratios)):.2f}")
    return ended(wanted.json, table, wrong=False)


if __name__ == "__main__":
    sys.exit(main())
