"""Complete a telemetry log by the autopilot's own log of the same power-up, where it lies beside it.

A ground station that was connected late, or a recorder that asked for no parameters, leaves a telemetry
log without the correction that is inside its readings. The autopilot's log always has it.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

from mavcompass.compass_parameters import ardupilot_name
from mavcompass.errors import MavCompassError
from mavcompass.logs.common.parameter_steps import Change, ardupilot_steps, unknown_correction
from mavcompass.logs.formats.dataflash.reader import read_parameters
from mavcompass.track import MagSeries, Track

_SUFFIXES = (".bin", ".log")
# Two logs of one power-up agree on the Unix time of the boot to within a link's delay.
_SAME_BOOT_S = 2.0


def complete(track: Track, path: Path) -> Track:
    """Return the track with parameters from a companion log, or as it is.

    A companion has the same name but for the suffix, and was started at the same second: that of another
    flight is not taken. Only ArduPilot's tracks whose corrections are unknown are completed.
    """
    if track.autopilot != "ardupilot" or track.utc_offset_s is None:
        return track
    lacking = [instance for instance, compass in track.compasses.items() if not compass.correction_known]
    for beside in logs_beside(path) if lacking else ():
        try:
            history, utc_offset_s = read_parameters(beside)
        except (MavCompassError, OSError):
            continue
        if utc_offset_s is not None and abs(utc_offset_s - track.utc_offset_s) < _SAME_BOOT_S:
            return _completed(track, history, lacking, beside)
    return track


def logs_beside(path: Path) -> list[Path]:
    """List the autopilot's logs of the same name."""
    return sorted(
        other
        for other in path.parent.iterdir()
        if other.stem == path.stem and other.suffix.lower() in _SUFFIXES and other != path and other.is_file()
    )


def _completed(track: Track, history: Sequence[Change], lacking: list[int], beside: Path) -> Track:
    parameters = {change.name: change.value for change in history} | dict(track.parameters)
    compasses = dict(track.compasses)
    for instance in lacking:
        compasses[instance] = _corrected(compasses[instance], history, parameters)
    known = [instance for instance in lacking if compasses[instance].correction_known]
    if not known:
        return track
    numbers = ", ".join(str(instance) for instance in known)
    told = {unknown_correction(instance) for instance in known}
    notes = [note for note in track.notes if note not in told]
    notes.append(
        f"The parameters of compass {numbers} are not in the recording; they were taken from {beside.name} "
        "beside it, the autopilot's own log of the same power-up."
    )
    return replace(track, compasses=compasses, parameters=parameters, notes=tuple(notes))


def _corrected(compass: MagSeries, history: Sequence[Change], parameters: dict[str, float]) -> MagSeries:
    steps, known = ardupilot_steps(history, compass.instance)
    if not known:
        return compass
    device_id = parameters.get(ardupilot_name("DEV_ID", compass.instance))
    return replace(
        compass,
        in_force=steps,
        correction_known=True,
        device_id=compass.device_id if device_id is None else int(device_id),
    )
