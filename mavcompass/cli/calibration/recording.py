"""Solve a recording."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from mavcompass import api
from mavcompass.calibration import Limits, calibrate_compasses
from mavcompass.cli.calibration.wanted import NOT_ACCEPTED, Wanted
from mavcompass.cli.calibration.words import say_result
from mavcompass.errors import BadRecording, PoorCalibration
from mavcompass.report.document import recording_document
from mavcompass.track import Track


def solve_recording(wanted: Wanted, in_force_file: Path | None, orientation: bool = False) -> int:
    """Solve every compass wanted of a recording; return the exit code."""
    source, output = wanted.source, wanted.output
    track = _read(source, in_force_file)
    if missing := [i for i in wanted.instances if i not in track.compasses]:
        raise BadRecording(
            f"{source} has no compass {missing[0]}; it has {', '.join(map(str, track.compasses)) or 'none'}.",
            "Choose with --compass.",
        )
    chosen = wanted.instances or tuple(track.compasses)
    try:
        found = calibrate_compasses(
            track,
            wanted.method,
            chosen,
            limits=Limits(heading_deg=wanted.max_error_deg),
            turn=orientation,
        )
    except PoorCalibration as error:
        wanted.output.write_json(wanted.refused(error, chosen, track))
        raise
    results = list(found.values())
    for note in track.notes:
        output.say(f"Note: {note}")
    for result in results:
        say_result(output, result)
    document = recording_document(source, track, results, wanted.method)
    output.write_json(document)
    accepted = all(result.accepted for result in results)
    if accepted and wanted.params_out is not None:
        _require_known_correction(track, chosen)
        wanted.write_params(document)
    if wanted.report_file is not None:
        from mavcompass.report.calibration import write_recording_report

        write_recording_report(track, results, wanted.report_file)
        output.say(f"Report: {wanted.report_file}")
    return 0 if accepted else NOT_ACCEPTED


def _read(source: str, in_force_file: Path | None) -> Track:
    track = api.read_track(source)
    if in_force_file is None:
        return track
    from mavcompass.compass_parameters import with_parameters_in_force
    from mavcompass.vehicle.parameters.files import read_parameter_file

    return with_parameters_in_force(track, read_parameter_file(in_force_file))


def _require_known_correction(track: Track, instances: Sequence[int]) -> None:
    """Refuse to write parameters that would be relative to unknown ones.

    Only ArduPilot reports corrected fields; what PX4 and bare sensors record is raw.
    """
    unknown = [i for i in instances if not track.compasses[i].correction_known]
    if unknown and track.autopilot == "ardupilot":
        raise BadRecording(
            f"The recording does not tell which parameters were in force for compass {unknown[0]}, and"
            " ArduPilot's readings have them inside: the new values would be wrong by the old ones.",
            "Save the vehicle's parameters of that day to a file and give it with --in-force FILE.",
        )
