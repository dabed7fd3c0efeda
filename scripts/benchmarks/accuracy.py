"""Calibrate the same recordings by mavcompass and by the tools people use today; judge by the truth.

    scripts/bench accuracy [-- --data FOLDER --files NAME... --timeout S --magyc PYTHON]

For each ArduPilot recording of the shared data: heading rms against the simulator's true yaw while the
vehicle dwells, before and after, and the time from start to result. Peers are pymavlink's magfit_WMM (with
and without its elliptical terms) and magfit, run as they are installed, and magyc, which needs another
numpy and so gets an environment of its own (made once; --magyc names one that is there). A peer that fails
or runs into the time limit is listed with what it said. The truth judges all and is an input of none.

Seconds: ours is the median of five, file to result; a pymavlink tool's is its process, file to result (Python
starts in a tenth of that); magyc's is the method alone, because the samples are read for it.
"""

from __future__ import annotations

import argparse
import json
import os
import re
import statistics
import subprocess
import sys
import tempfile
import time
import venv
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from mavcompass.calibration.observation.wire import effective_count
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
    parser.add_argument("--magyc", type=Path, default=None, help="a Python that has magyc")
    options = parser.parse_args(argv)
    files = options.files or [f"{name}.{end}" for name in RECORDINGS for end in ("BIN", "tlog")]
    magyc = options.magyc or python_with_magyc()
    table: list[dict[str, Any]] = []
    print(f"{'file':24} {'tool':26} {'seconds':>8} {'heading rms, deg':>17}")
    for name in files:
        path = options.data / "ardupilot-4.6.3" / name
        judge = Judge(path)
        rows = [{"tool": BEFORE, "seconds": 0.0, "heading_rms_deg": judge.rms_deg(IN_FORCE)}]
        rows.append(ours(path, judge))
        rows += [peer(path, judge, tool, options.timeout) for tool in PEERS]
        if magyc is not None:
            rows += [magyc_peer(magyc, judge, method, options.timeout) for method in MAGYC]
        for row in rows:
            table.append({"file": name, **row})
            rms = row["heading_rms_deg"]
            shown = f"{rms:17.3f}" if rms is not None else f"{'-':>17}"
            print(
                f"{name:24} {row['tool']:26} {row['seconds']:8.2f} {shown}  {row.get('said', '')}", flush=True
            )
    return {"table": table, "checks": checks(table)}


def checks(table: Sequence[dict[str, Any]]) -> list[dict[str, Any]]:
    """Compare ours with every peer that gave a result, or ran into the time limit, on the same file."""
    faster, better = [], []
    for own in (row for row in table if row["tool"] == OURS):
        for row in table:
            if row["file"] != own["file"] or row["tool"] in (OURS, BEFORE):
                continue
            if row["tool"] in ITERATIVE and (row["heading_rms_deg"] is not None or row.get("late")):
                faster.append(row["seconds"] / own["seconds"])
            if row["heading_rms_deg"] is not None:
                better.append(row["heading_rms_deg"] / own["heading_rms_deg"])
    if not better:
        return []
    times = [{"what": "least speed-up over an iterative peer", "value": min(faster), "at_least": 100.0}]
    return [
        {"what": "best peer's heading rms / ours, worst file", "value": min(better), "at_least": 1.0},
        *(times if faster else []),
    ]


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

    seconds = []
    for _ in range(6):
        start = time.perf_counter()
        result = calibrate_track(with_parameters(read_track(path)))
        seconds.append(time.perf_counter() - start)
    said = f"claims {result.heading_sigma_deg:.3f}" if result.accepted else "; ".join(result.reasons)
    return {
        "tool": OURS,
        "seconds": statistics.median(seconds[1:]),  # the first one imports
        "heading_rms_deg": judge.rms_deg(result.correction),
        "said": said,
    }


BEFORE, OURS = "(before)", "mavcompass four-positions"
PEERS: dict[str, list[str]] = {
    "magfit_WMM": ["magfit_WMM.py"],
    "magfit_WMM --elliptical": ["magfit_WMM.py", "--elliptical"],
    "magfit": ["magfit.py"],
}
MAGYC = ("magyc_ls", "magyc_nls", "magyc_bfg", "ellipsoid_fit")
ITERATIVE = ("magfit_WMM", "magfit_WMM --elliptical", "magfit", "magyc_ls", "magyc_nls", "magyc_bfg")


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
            return {**row, "seconds": timeout, "said": "ran into the time limit", "late": True}
    row["seconds"] = time.perf_counter() - start
    correction = correction_in(done.stdout)
    if correction is None:
        lines = (done.stdout + done.stderr).strip().splitlines()
        return {**row, "said": next((line for line in reversed(lines) if line.strip()), "nothing")[:90]}
    return {**row, "heading_rms_deg": judge.rms_deg(correction)}


def python_with_magyc() -> Path | None:
    """Return the Python of magyc's own environment, made on first use; None where it cannot be made."""
    folder = PROJECT / "build" / "peers" / "magyc"
    python = folder / "bin" / "python"
    if not python.exists():
        print("Installing magyc into an environment of its own, once.", flush=True)
        venv.create(folder, with_pip=True)
    if subprocess.run([python, "-c", "import magyc"], capture_output=True).returncode == 0:
        return python
    done = subprocess.run([python, "-m", "pip", "install", "-q", "magyc"], capture_output=True, text=True)
    if done.returncode != 0:
        print(f"magyc is left out, it cannot be installed: {done.stderr.strip()[-200:]}")
        return None
    return python


def magyc_peer(python: Path, judge: Judge, method: str, timeout: float) -> dict[str, Any]:
    """Run one of magyc's methods on the compass readings of the same file, with the gyro's rates."""
    compass, gyro = judge.track.compasses[1], judge.track.gyro_radps
    assert gyro is not None, "the recording has no gyro"
    raw_mgauss = judge.track.raw_field(1)
    fresh, _ = effective_count(raw_mgauss)
    seen_s = compass.time_s[fresh]
    rates = np.stack([np.interp(seen_s, gyro.time_s, axis) for axis in gyro.values.T], axis=1)
    row: dict[str, Any] = {"tool": method, "heading_rms_deg": None, "seconds": timeout}
    with tempfile.TemporaryDirectory() as folder:
        samples = Path(folder) / "samples.npz"
        np.savez(samples, time_s=seen_s, mag_mgauss=raw_mgauss[fresh], gyro_radps=rates)
        script = Path(__file__).with_name("_peer_magyc.py")
        try:
            done = subprocess.run(
                [python, script, method, samples], capture_output=True, text=True, timeout=timeout
            )
        except subprocess.TimeoutExpired:
            return {**row, "said": "ran into the time limit", "late": True}
    if done.returncode != 0:
        return {**row, "seconds": 0.0, "said": (done.stderr.strip().splitlines() or ["nothing"])[-1][:90]}
    found = json.loads(done.stdout.strip().splitlines()[-1])
    row["seconds"] = found["seconds"]
    try:
        correction = FieldCorrection.from_matrix(
            -np.array(found["hard_iron_mgauss"]), np.linalg.inv(found["soft_iron"])
        )
    except (ValueError, np.linalg.LinAlgError) as error:
        return {**row, "said": f"unusable: {error}"[:90]}
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
