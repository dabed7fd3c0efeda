"""What a person wants of a calibration, what is said of it, and one of a recording."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

from mavcompass import api
from mavcompass.calibration import Limits, calibrate_compasses
from mavcompass.calibration.result import CalibrationResult, TrueHeading, summary
from mavcompass.cli.options import Output
from mavcompass.cli.terminal.colour import styled
from mavcompass.errors import BadRecording, PoorCalibration
from mavcompass.report.document import recording_document
from mavcompass.track import Track

if TYPE_CHECKING:
    from mavcompass.procedure.nameplate import Nameplate

NOT_ACCEPTED = 5
# Written and proven, but the autopilot still steers by another heading.
STEERS_OFF = 8


@dataclass(frozen=True, slots=True)
class Wanted:
    """Hold the options that both kinds share, and write the files they name."""

    source: str
    method: str
    instances: tuple[int, ...]
    max_error_deg: float
    params_out: Path | None
    report_file: Path | None
    output: Output
    true_heading: TrueHeading | None = None

    def refused(
        self, error: PoorCalibration, instances: tuple[int, ...], track: Track | None = None
    ) -> dict[str, object]:
        """Put together the document of a calibration that could not be solved."""
        from mavcompass.report.document import refused_document

        return refused_document(self.source, self.method, instances, str(error), track)

    def of_system(self, system: int) -> Wanted:
        """Return the same for one of several vehicles: its files are named by its system id."""

        def named(path: Path | None) -> Path | None:
            return None if path is None else path.with_name(f"{path.stem}-system{system}{path.suffix}")

        return replace(self, params_out=named(self.params_out), report_file=named(self.report_file))

    def write_params(self, document: dict[str, Any], vehicle: Nameplate | None = None) -> None:
        """Write the parameters of an accepted calibration where a file was named, and whose they are."""
        if self.params_out is None:
            return
        from mavcompass.vehicle.parameters.files import write_parameter_file
        from mavcompass.vehicle.parameters.undo import marked

        values: dict[str, float] = {}
        for compass in document["compasses"]:
            values |= compass["parameters"]
        write_parameter_file(
            self.params_out,
            values,
            marked(vehicle, f"Compass calibration from {self.source}, by mavcompass."),
        )
        self.output.say(f"Parameters: {self.params_out}")


def say_result(output: Output, result: CalibrationResult) -> None:
    """Say one compass's result, with its reasons and warnings."""
    output.say(styled(summary(result), fg="green" if result.accepted else "red"))
    for reason in (*result.reasons, *result.warnings):
        output.say(f"  - {reason}")


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
            true_heading=wanted.true_heading,
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
