"""The public functions of the package; `import mavcompass` offers them without importing this."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from mavcompass.correction import FieldCorrection
from mavcompass.track import Track

if TYPE_CHECKING:
    from mavcompass.calibration.result import CalibrationResult
    from mavcompass.heading.stream import HeadingResult
    from mavcompass.vehicle.connection import Vehicle


def read_track(path: str | Path) -> Track:
    """Read a recording (.tlog, .bin, .log, .ulg, .csv) into a Track.

    Raises BadRecording where nothing useful can be read, UsageError where there is no such file.
    """
    from mavcompass.logs import read_track as read

    return read(Path(path))


def calibrate(
    track: Track, method: str = "auto", instance: int = 1, max_heading_error_deg: float = 2.0
) -> CalibrationResult:
    """Calibrate one compass of a recording.

    Args:
        method: auto (what the recording can bear), four-positions, four-positions-textbook, min-max,
            sensitivity-bias, sphere, ellipsoid or world-field.
        instance: which compass, from 1.
        max_heading_error_deg: what is accepted at most.

    A calibration that is not good enough comes back with `accepted` False and its reasons.
    Raises PoorCalibration where there is no solution at all, UsageError for an unknown method.
    """
    from mavcompass.calibration import calibrate_track
    from mavcompass.calibration.verdict import Limits

    limits = Limits(heading_deg=max_heading_error_deg)
    return calibrate_track(track, method=method, instance=instance, limits=limits)


def heading(track: Track, correction: FieldCorrection | None = None, instance: int = 1) -> HeadingResult:
    """Compute the tilt-compensated heading, magnetic and true, with sigma, for every reading.

    `correction` is applied to the raw field; without it the autopilot's own stays in force.
    Raises BadRecording for a compass that the track does not have.
    """
    from mavcompass.heading.stream import heading_of_track

    return heading_of_track(track, correction, instance)


def diagnose_gap(
    track: Track, baseline: Track | None = None, withhold: Sequence[str] = (), instance: int = 1
) -> Any:
    """Diagnose the gap between the simulator and a recording: where, why, and how far it shrinks.

    Args:
        baseline: a recording of the same vehicle with nothing wrong; gives the noise floor, and tells how far
            the calibration in force is to be trusted.
        withhold: effects that must not be named (for checking the diagnosis itself).
    """
    from mavcompass.gap import diagnose_gap as diagnose

    return diagnose(track, baseline=baseline, withhold=tuple(withhold), instance=instance)


def connect(source: str) -> Vehicle:
    """Connect to a vehicle at udpin:HOST:PORT, tcp:HOST:PORT, sim:rover, ...; a context manager.

    Raises UsageError for a wrong address, NoVehicle where no autopilot is heard.
    """
    from mavcompass.vehicle.connection import connect as open_vehicle

    return open_vehicle(source)
