"""What mavcompass makes of each shared recording: the golden results, and how they are made again.

    scripts/golden            compare, and say what differs
    scripts/golden --write    store today's results as the golden ones

One file per recording holds what was read, the calibration, and what a program on the link hears when the
recording is replayed as a live vehicle: of a flight that lasts longer, in its first five minutes.
"""

from __future__ import annotations

import argparse
import json
import math
import os
import sys
from collections import Counter
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np

from mavcompass.calibration import calibrate_track
from mavcompass.errors import LinkLost, MavCompassError
from mavcompass.heading import heading_of_track
from mavcompass.logs import read_track
from mavcompass.track import Track
from mavcompass.vehicle.replay import ReplayedLink

HERE = Path(__file__).resolve().parent
sys.path.insert(0, str(HERE.parent))

import stored_numbers  # noqa: E402

PROJECT = HERE.parents[1]
SUFFIXES = (".tlog", ".BIN", ".csv", ".ulg")
# Solvers and libraries differ in the last digits; a milligauss and a hundredth of a degree are what counts.
RELATIVE, ABSOLUTE = 1e-4, 2e-3
LONGEST_S = 300.0


def recordings(data: Path) -> Iterator[tuple[str, Path]]:
    """Yield the shared recordings with the names of their golden files.

    Cases of the gap diagnosis come by the dozen, with labels of their own.
    """
    for path in sorted(data.rglob("*")):
        if path.suffix in SUFFIXES and not any(part.startswith("gap-") for part in path.parts):
            yield f"{path.parent.name}.{path.name}.json", path


def results_of(path: Path) -> dict[str, Any]:
    """Read, calibrate and replay one recording."""
    try:
        track = read_track(path)
    except MavCompassError as error:
        return {"read": {"refused": type(error).__name__}}
    return {"read": _read(track), "calibrate": _calibrated(track), "replay": _replayed(path)}


def _read(track: Track) -> dict[str, Any]:
    compasses = {}
    for instance, compass in track.compasses.items():
        compasses[str(instance)] = {
            "readings": len(compass.reported),
            "first_s": float(compass.time_s[0]),
            "last_s": float(compass.time_s[-1]),
            "mean_raw_mgauss": np.nanmean(track.raw_field(instance), axis=0).tolist(),
            "corrections_in_force": len(compass.in_force),
            "correction_known": compass.correction_known,
        }
    gyro = track.gyro_radps
    return {
        "autopilot": track.autopilot,
        "vehicle": track.vehicle,
        "compasses": compasses,
        "gyro": None if gyro is None else len(gyro),
        "parameters": len(track.parameters),
        "heading": _headings(track),
    }


def _headings(track: Track) -> dict[str, Any] | None:
    try:
        heading = heading_of_track(track)
    except MavCompassError:
        return None
    return {"count": len(heading.time_s), "mean_of_magnetic": _mean_direction(heading.magnetic_rad)}


def _mean_direction(angles_rad: np.ndarray[Any, Any]) -> list[float]:
    known = angles_rad[np.isfinite(angles_rad)]
    return [float(np.cos(known).mean()), float(np.sin(known).mean())] if known.size else []


def _calibrated(track: Track) -> dict[str, Any]:
    begin_s = float(min(compass.time_s[0] for compass in track.compasses.values()))
    try:
        result = calibrate_track(track.between(-math.inf, begin_s + LONGEST_S))
    except MavCompassError as error:
        return {"refused": type(error).__name__, "exit_code": error.exit_code}
    if not result.accepted:  # its numbers mean nothing, and are as loose as the data
        return {"accepted": False, "reasons": len(result.reasons)}
    return {
        "accepted": True,
        "positions": len(result.positions),
        "offsets_mgauss": list(result.correction.offsets_mgauss),
        "diagonals": list(result.correction.diagonals),
        "off_diagonals": list(result.correction.off_diagonals),
        "scale": result.correction.scale,
        "heading_sigma_deg": result.heading_sigma_deg,
        "heading_change_deg": result.heading_change_deg,
    }


def _replayed(path: Path) -> dict[str, Any]:
    try:
        link = ReplayedLink.playing(path)
    except MavCompassError as error:
        return {"refused": type(error).__name__}
    heard: Counter[str] = Counter()
    last_s = math.nan
    end_s = link.now() + LONGEST_S
    try:
        while link.now() < end_s:
            incoming = link.receive(10.0)
            if incoming is not None:
                heard[type(incoming.message).__name__] += 1
                last_s = incoming.time_s
    except LinkLost:
        link.close()
    return {"messages": dict(sorted(heard.items())), "seconds": last_s}


def differences(golden: Any, found: Any) -> list[str]:
    """Return what differs between two results, beyond what solvers and libraries do."""
    return list(stored_numbers.differences(golden, found, "", RELATIVE, ABSOLUTE))


def main() -> int:
    """Compare with the golden results, or store new ones; exit code 1 where something differs."""
    parser = argparse.ArgumentParser(prog="scripts/golden", description=__doc__.splitlines()[0])
    parser.add_argument("--write", action="store_true", help="store today's results")
    shared = os.environ.get("MAVCOMPASS_SHARED_DATA") or PROJECT.parent / "shared" / "data"
    parser.add_argument("--data", type=Path, default=Path(shared))
    options = parser.parse_args()
    differ = 0
    for name, path in recordings(options.data):
        found = results_of(path)
        stored = HERE / name
        if options.write:
            stored.write_text(json.dumps(found, indent=1) + "\n")
            continue
        golden = json.loads(stored.read_text()) if stored.exists() else None
        lines = list(differences(golden, json.loads(json.dumps(found))))
        differ += bool(lines)
        print(f"{name}: {'as stored' if not lines else ''}", *lines, sep="\n  ")
    return 1 if differ else 0


if __name__ == "__main__":
    sys.exit(main())
