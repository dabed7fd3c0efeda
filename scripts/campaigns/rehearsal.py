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

import argparse
import itertools
import json
import math
import tempfile
from collections import defaultdict
from collections.abc import Iterable, Iterator, Sequence
from pathlib import Path

import numpy as np

from mavcompass.blas import single_thread
from mavcompass.correction import FieldCorrection
from mavcompass.errors import BadRecording, PoorCalibration, Refused
from mavcompass.gap import diagnose_gap
from mavcompass.gap.left.floor import rms, rms_deg
from mavcompass.gap.rehearsal import Expected
from mavcompass.gap.rehearsal.draws import Draws
from mavcompass.gap.rehearsal.kind import kind_of
from mavcompass.gap.rehearsal.rehearse import calibrations
from mavcompass.logs import read_track
from mavcompass.procedure.report import CalibrationReport
from mavcompass.procedure.settings import CalibrateSettings
from mavcompass.simulation.heading_error import heading_error_rms_deg, heading_errors_rad
from mavcompass.simulation.physics.compasses import draw_compasses
from mavcompass.simulation.vehicle import SimulatedAutopilot
from mavcompass.track import Track
from mavcompass.vehicle.calibrating import calibrate_on
from mavcompass.vehicle.links.simulated import SimulatedLink

KINDS = ("rover", "copter", "boat", "px4-copter")
EFFECTS = ((), ("motor_current:x=1.5,y=-0.8",), ("noise_excess:sigma_mgauss=12",))
_NOTHING_WRITTEN = (PoorCalibration.exit_code, Refused.exit_code)
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
        return f"{diagnosis.verdict} {','.join(sorted(diagnosis.effects))}", errors.level, errors.tilted
    raise BadRecording("None of the vehicle's recordings can be diagnosed.", "Name others.")


def recorded(folders: Sequence[Path]) -> Iterator[tuple[str, Iterable[Track], list[Reached]]]:
    """Yield each vehicle's name, its flights, and what its calibrations reached."""
    groups: dict[str, list[tuple[Path, Reached]]] = defaultdict(list)
    for folder in sorted(folders):
        truth = json.loads((folder / "truth.json").read_text(encoding="utf-8"))
        judged = truth.get("heading_rms_deg") or {}
        result = truth.get("live_result") or {}
        level, tilted = (
            judged.get("level", result.get("level_rms_deg")),
            judged.get("tilt15", result.get("tilt15_rms_deg")),
        )
        if level is None or tilted is None or truth.get("exit_code") in _NOTHING_WRITTEN:
            continue
        vehicle = folder.name.partition("-")[2] or folder.name
        for option in ("-reboot", "-disarmed"):
            vehicle = vehicle.removesuffix(option)
        groups[vehicle].append((folder, (level, tilted)))
    for vehicle, runs in sorted(groups.items()):
        logs = [folder / name for folder, _ in runs for name in ("flight.BIN", "flight.ulg")]
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
    horizontal_mgauss = SimulatedAutopilot(kind, seed=iron).world.horizontal_mgauss
    compasses = draw_compasses(iron, horizontal_mgauss, "old")
    vehicle = SimulatedAutopilot(kind, seed=seed, compasses=compasses, effects=effects)
    with tempfile.TemporaryDirectory() as folder:
        settings = CalibrateSettings(writing="yes")
        report = calibrate_on(SimulatedLink(vehicle), f"sim:{kind}", settings, undo_directory=Path(folder))
    return vehicle, report


def judged(vehicle: SimulatedAutopilot, report: CalibrationReport) -> Reached:
    """Return the rms heading error of what was found, level and leaning by 15 degrees in eight directions."""
    correction: FieldCorrection = report.results[0].correction
    lean = math.radians(15.0)
    errors = [
        heading_errors_rad(vehicle, 1, correction, lean * math.cos(toward), lean * math.sin(toward))
        for toward in np.arange(8) * math.pi / 4.0
    ]
    return heading_error_rms_deg(vehicle, 1, correction), rms_deg(np.array(errors))


def main() -> None:
    """Print the table: told, reached, and how often the one covers the other."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("recordings", nargs="*", type=Path)
    parser.add_argument("--embedded", type=int, default=0, metavar="N", help="vehicles of each kind")
    parser.add_argument("--again", type=int, default=3, help="whole procedures on each of them")
    parser.add_argument("--draws", type=int, default=1000)
    arguments = parser.parse_args()
    groups = [recorded(arguments.recordings), embedded(arguments.embedded, arguments.again)]
    covered: list[int] = [0, 0]
    ratios: tuple[list[float], list[float]] = ([], [])
    runs, vehicles = 0, 0
    for vehicle, tracks, reached in itertools.chain(*groups):
        verdict, *expected = told(tracks, arguments.draws)
        vehicles, runs = vehicles + 1, runs + len(reached)
        line = f"{vehicle:28} {verdict:24}"
        for place, one in enumerate(expected):
            values = [run[place] for run in reached]
            inside = sum(value <= one.at_most95_deg for value in values)
            covered[place] += inside
            ratios[place].extend(value / one.rms_deg for value in values)
            line += f" | {one.rms_deg:.2f} (below {one.at_most95_deg:.2f}), reached "
            line += f"{min(values):.2f} to {max(values):.2f}: {inside}/{len(values)}"
        print(line, flush=True)
    print(f"{vehicles} vehicles, {runs} calibrations")
    for place, where in enumerate(("level", "leaning")):
        whole = rms(np.array(ratios[place]))
        print(f"  {where}: {covered[place]} below the bound; rms of reached over told: {whole:.2f}")


if __name__ == "__main__":
    main()
