"""Calibrate the same recordings by mavcompass and by the tools people use today; judge by the truth.

    scripts/bench accuracy [-- --data FOLDER --files NAME... --timeout S --json FILE]

For each ArduPilot recording of the shared data: heading rms against the simulator's true yaw while the
vehicle dwells, before and after, and the time from start to result with one process each. Peers are
pymavlink's magfit_WMM (with and without its elliptical terms) and magfit, run as they are installed; a
peer that fails or runs into the time limit is listed with what it said. The truth judges all and is
an input of none.
"""

from __future__ import annotations

import argparse
import json
import os
import re
import subprocess
import sys
import tempfile
import time
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from mavcompass.correction import FieldCorrection
from mavcompass.frames import matrix_to_euler, quaternion_to_matrix, wrap_pi
from mavcompass.logs import read_track
from mavcompass.track import InForce, Track

PROJECT = Path(__file__).resolve().parents[2]
RECORDINGS = ("rover_plain", "rover_dist", "rover_dist_use2", "copter_dist_use2")
# In force in these recordings; their telemetry logs begin after the parameters were listed.
IN_FORCE = FieldCorrection((5.0, 13.0, -18.0))
FIELD_LAG_S = 0.09
_NUMBER = r"(-?\d+(?:\.\d+)?(?:e-?\d+)?)"
_VECTOR = rf"Vector3\({_NUMBER}, {_NUMBER}, {_NUMBER}\)"


QUICK = ("--files", "rover_dist.BIN", "--timeout", "60")


def main(argv: Sequence[str] | None = None) -> dict[str, Any]:
    """Run the comparison, print the table and return it."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    shared = os.environ.get("MAVCOMPASS_SHARED_DATA") or PROJECT.parent / "shared" / "data"
    parser.add_argument("--data", type=Path, default=Path(shared))
    parser.add_argument("--files", nargs="*", default=None, help="e.g. rover_dist.BIN; default: all")
    parser.add_argument("--timeout", type=float, default=300.0, help="seconds for each peer")
    parser.add_argument("--json", type=Path, default=None)
    options = parser.parse_args(argv)
    files = options.files or [f"{name}.{end}" for name in RECORDINGS for end in ("BIN", "tlog")]
    table: list[dict[str, Any]] = []
    print(f"{'file':24} {'tool':26} {'seconds':>8} {'heading rms, deg':>17}")
    for name in files:
        path = options.data / "ardupilot-4.6.3" / name
        judge = Judge(path)
        rows = [{"tool": "(before)", "seconds": 0.0, "heading_rms_deg": judge.rms_deg(IN_FORCE)}]
        rows.append(ours(path, judge))
        rows += [peer(path, judge, tool, options.timeout) for tool in PEERS]
        for row in rows:
            table.append({"file": name, **row})
            rms = row["heading_rms_deg"]
            shown = f"{rms:17.3f}" if rms is not None else f"{'-':>17}"
            print(
                f"{name:24} {row['tool']:26} {row['seconds']:8.2f} {shown}  {row.get('said', '')}", flush=True
            )
    if options.json:
        options.json.write_text(json.dumps(table, indent=1) + "\n")
    return {"table": table}


class Judge:
    """Hold a recording's truth: heading errors of a correction during the dwells."""

    def __init__(self, path: Path) -> None:
        from mavcompass.calibration import find_dwells
        from mavcompass.heading import heading_of_track

        self._heading = heading_of_track
        self.track = with_parameters(read_track(path))
        truth = self.track.truth_q
        assert truth is not None, "the recording has no simulator's truth"
        yaw = matrix_to_euler(quaternion_to_matrix(truth.values))[2]
        self._truth_time, self._truth_yaw = truth.time_s, np.unwrap(yaw)
        self._windows = [(d.start_s, d.end_s) for d in find_dwells(self.track)]

    def rms_deg(self, correction: FieldCorrection) -> float:
        """Return the rms heading error over the dwells, each counting alike."""
        heading = self._heading(self.track, correction)
        assert heading.true_rad is not None
        truth = np.interp(heading.time_s - FIELD_LAG_S, self._truth_time, self._truth_yaw)
        error = np.degrees(wrap_pi(heading.true_rad - truth))
        squares = [
            float(np.mean(error[slice(*np.searchsorted(heading.time_s, window))] ** 2))
            for window in self._windows
        ]
        return float(np.sqrt(np.mean(squares)))


def with_parameters(track: Track) -> Track:
    """Tell a telemetry log what was in force where it does not say it itself."""
    compass = track.compasses[1]
    if compass.correction_known:
        return track
    known = replace(compass, in_force=(InForce(-np.inf, IN_FORCE),), correction_known=True)
    return replace(track, compasses={**track.compasses, 1: known})


def ours(path: Path, judge: Judge) -> dict[str, Any]:
    """Calibrate with mavcompass in this process, reading included, and without the start of Python."""
    from mavcompass.calibration import calibrate_track

    start = time.perf_counter()
    result = calibrate_track(with_parameters(read_track(path)))
    seconds = time.perf_counter() - start
    said = f"claims {result.heading_sigma_deg:.3f}" if result.accepted else "; ".join(result.reasons)
    return {
        "tool": "mavcompass four-positions",
        "seconds": seconds,
        "heading_rms_deg": judge.rms_deg(result.correction),
        "said": said,
    }


PEERS: dict[str, list[str]] = {
    "magfit_WMM": ["magfit_WMM.py"],
    "magfit_WMM --elliptical": ["magfit_WMM.py", "--elliptical"],
    "magfit": ["magfit.py"],
}


def peer(path: Path, judge: Judge, tool: str, timeout: float) -> dict[str, Any]:
    """Run one of pymavlink's tools and judge the correction that it prints."""
    script, *arguments = PEERS[tool]
    command = [sys.executable, str(Path(sys.executable).parent / script), *arguments, str(path)]
    row: dict[str, Any] = {"tool": tool, "heading_rms_deg": None}
    start = time.perf_counter()
    with tempfile.TemporaryDirectory() as folder:
        try:
            done = subprocess.run(
                command,
                cwd=folder,
                capture_output=True,
                text=True,
                timeout=timeout,
                env={**os.environ, "MPLBACKEND": "Agg"},
            )
        except subprocess.TimeoutExpired:
            return {**row, "seconds": timeout, "said": "ran into the time limit"}
    row["seconds"] = time.perf_counter() - start
    correction = correction_in(done.stdout)
    if correction is None:
        lines = (done.stdout + done.stderr).strip().splitlines()
        return {**row, "said": next((line for line in reversed(lines) if line.strip()), "nothing")[:90]}
    return {**row, "heading_rms_deg": judge.rms_deg(correction)}


def correction_in(text: str) -> FieldCorrection | None:
    """Read the correction off a peer's output; None where it gave none."""
    full = re.search(rf"New: {_VECTOR} diag: {_VECTOR} offdiag: {_VECTOR}.*? scale: {_NUMBER}", text, re.S)
    if full is not None:
        n = [float(v) for v in full.groups()]
        return FieldCorrection((n[0], n[1], n[2]), (n[3], n[4], n[5]), (n[6], n[7], n[8]), n[9])
    final = re.search(rf"Final\s*: {_VECTOR}", text)
    if final is not None:
        x, y, z = (float(v) for v in final.groups())
        return FieldCorrection((x, y, z))
    return None


if __name__ == "__main__":
    main()
