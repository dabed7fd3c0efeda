"""The public functions of the package; `import mavcompass` offers them without importing this.

What they return shows itself in a notebook; a path is taken wherever a Track is.
"""

from __future__ import annotations

import tempfile
from collections.abc import Callable, Sequence
from html import escape
from pathlib import Path
from typing import TYPE_CHECKING, Any

from mavcompass.correction import FieldCorrection
from mavcompass.track import Track

if TYPE_CHECKING:
    from mavcompass.calibration.result import CalibrationResult
    from mavcompass.gap.result import Diagnosis
    from mavcompass.heading.one_compass import HeadingResult
    from mavcompass.vehicle.connection import Vehicle


Recorded = Track | str | Path


def read_track(path: str | Path) -> Track:
    """Read a recording (.tlog, .bin, .log, .ulg, .csv, .mcap, .db3) into a Track.

    Raises BadRecording where nothing useful can be read, UsageError where there is no such file.
    """
    from mavcompass.logs import read_track as read

    return read(Path(path))


def calibrate(
    track: Recorded,
    method: str = "auto",
    instance: int = 1,
    max_heading_error_deg: float = 2.0,
    true_heading_rad: float | None = None,
    true_heading_sigma_rad: float | None = None,
) -> CalibrationResult:
    """Calibrate one compass of a recording.

    Args:
        track: or the path of a recording.
        method: auto (what the recording can bear), four-positions, four-positions-textbook, min-max,
            sensitivity-bias, sphere, ellipsoid, world-field, touch-up or one-point.
        instance: which compass, from 1.
        max_heading_error_deg: what is accepted at most.
        true_heading_rad, true_heading_sigma_rad: for one-point, where the vehicle stands; without it a second
            antenna's.

    A calibration that is not good enough comes back with `accepted` False and its reasons.
    Raises PoorCalibration where there is no solution at all, UsageError for an unknown method.
    """
    from mavcompass.calibration import calibrate_track
    from mavcompass.calibration.result import CalibrationResult, Limits, summary, true_heading

    _shows(CalibrationResult, lambda result: [summary(result), *result.reasons, *result.warnings])
    limits = Limits(heading_deg=max_heading_error_deg)
    given = true_heading(true_heading_rad, true_heading_sigma_rad)
    return calibrate_track(_track(track), method, instance, limits=limits, true_heading=given)


def heading(track: Recorded, correction: FieldCorrection | None = None, instance: int = 1) -> HeadingResult:
    """Compute the tilt-compensated heading, magnetic and true, with sigma, for every reading.

    `correction` is applied to the raw field; without it the autopilot's own stays in force.
    Raises BadRecording for a compass that the track does not have.
    """
    from mavcompass.heading.evidence import heading_of_track
    from mavcompass.heading.one_compass import HeadingResult

    _shows(HeadingResult, _heading_in_words)
    return heading_of_track(_track(track), correction, instance)


def diagnose_gap(
    track: Recorded, baseline: Recorded | None = None, withhold: Sequence[str] = (), instance: int = 1
) -> Diagnosis:
    """Diagnose the gap between the simulator and a recording: where, why, and how far it shrinks.

    Args:
        baseline: a recording of the same vehicle with nothing wrong; gives the noise floor, and tells how far
            the calibration in force is to be trusted.
        withhold: effects that must not be named (for checking the diagnosis itself).
    """
    from mavcompass.gap import diagnose_gap as diagnose
    from mavcompass.gap.result import Diagnosis
    from mavcompass.report.gap_words import summary

    _shows(Diagnosis, summary)
    before = None if baseline is None else _track(baseline)
    return diagnose(_track(track), baseline=before, withhold=tuple(withhold), instance=instance)


def connect(source: str) -> Vehicle:
    """Connect to a vehicle at udpin:HOST:PORT, tcp:HOST:PORT, sim:rover, ...; a context manager.

    Raises UsageError for a wrong address, NoVehicle where no autopilot is heard.
    """
    from mavcompass.vehicle.connection import connect as open_vehicle

    return open_vehicle(source)


def _track(recorded: Recorded) -> Track:
    return recorded if isinstance(recorded, Track) else read_track(recorded)


# --- in a notebook ----------------------------------------------------------------------------------


def to_pandas(track: Track, instance: int = 1) -> Any:
    """Return one compass of a track, raw, and what else fits, as a DataFrame with the columns of a Track CSV.

    Raises KeyError for a compass that the track does not have, ImportError where pandas is not installed.
    """
    import pandas

    from mavcompass.logs.formats.csv.writer import write_track_csv

    with tempfile.TemporaryDirectory() as folder:
        file = Path(folder) / "track.csv"
        write_track_csv(track, file, instance)
        return pandas.read_csv(file, index_col="time_s")


def from_pandas(frame: Any) -> Track:
    """Make a track of a DataFrame with the columns of a Track CSV; time_s may be its index.

    Raises BadRecording where nothing useful can be read.
    """
    with tempfile.TemporaryDirectory() as folder:
        file = Path(folder) / "frame.csv"
        frame.to_csv(file, index=frame.index.name == "time_s")
        return read_track(file)


def _track_in_words(track: Track) -> list[str]:
    lines = [f"{track.source or 'Track'}: {track.autopilot} {track.vehicle}"]
    for instance, compass in sorted(track.compasses.items()):
        lines.append(f"compass {instance}: {len(compass.time_s)} readings")
    for name in ("acc_mps2", "gyro_radps", "attitude_rad", "position_ned_m", "current_a", "throttle"):
        if (series := getattr(track, name)) is not None:
            lines.append(f"{name}: {len(series)} samples")
    return [*lines, *track.notes]


def _heading_in_words(found: HeadingResult) -> list[str]:
    import numpy as np

    last = np.degrees([found.magnetic_rad[-1], found.sigma_rad[-1]])
    said = f"{len(found.time_s)} headings, {'magnetic' if found.true_rad is None else 'magnetic and true'}"
    return [said, f"last: {last[0]:.1f} ± {last[1]:.1f} deg magnetic"]


def _shows(kind: type, in_words: Callable[[Any], Sequence[str]]) -> None:
    """Let what is returned show itself in a notebook, in the words that a terminal has for it."""

    def as_html(self: Any) -> str:
        first, *rest = in_words(self)
        return f"<b>{escape(first)}</b><br>" + "<br>".join(map(escape, rest))

    kind._repr_html_ = as_html  # type: ignore[attr-defined]


_shows(Track, _track_in_words)
Track.to_pandas, Track.from_pandas = to_pandas, staticmethod(from_pandas)  # type: ignore[attr-defined]
