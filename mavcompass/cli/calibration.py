"""Calibrate a recording, or a live vehicle (or all of one link), and say and write what came of it."""

from __future__ import annotations

import sys
from collections.abc import Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

from mavcompass import api
from mavcompass.calibration import Limits, calibrate_compasses
from mavcompass.calibration.result import CalibrationResult, summary
from mavcompass.cli.options import Output
from mavcompass.cli.terminal.lines import showing_progress, styled
from mavcompass.errors import BadRecording, MavCompassError, PoorCalibration
from mavcompass.procedure.report import CalibrationReport
from mavcompass.procedure.script import Machine, Show
from mavcompass.procedure.settings import CalibrateSettings
from mavcompass.procedure.vehicle_state import find_vehicles
from mavcompass.procedure.writing import CANCELLED
from mavcompass.report.document import live_document, recording_document, refused_document
from mavcompass.track import Track
from mavcompass.vehicle.calibrating import calibrate_on
from mavcompass.vehicle.driver import run
from mavcompass.vehicle.stopping import StopRequest

if TYPE_CHECKING:
    from mavcompass.procedure.nameplate import Nameplate
    from mavcompass.vehicle.link import Link

NOT_ACCEPTED = 5
# Written and proven, but the autopilot still steers by another heading.
STEERS_OFF = 8
SCHEMA = "mavcompass.calibrations/1"
# Tried where another method refused.
_OTHERS = ("four-positions", "world-field", "ellipsoid")


@dataclass(frozen=True, slots=True)
class Results:
    """Hold where what was calibrated is named, said and written: a source, an output, files if any."""

    source: str
    output: Output
    params_out: Path | None = None
    report_file: Path | None = None

    def of_system(self, system: int) -> Results:
        """Return the same for one of several vehicles: its files are named by its system id."""

        def named(path: Path | None) -> Path | None:
            return None if path is None else path.with_name(f"{path.stem}-system{system}{path.suffix}")

        return replace(self, params_out=named(self.params_out), report_file=named(self.report_file))

    def refused(
        self,
        settings: CalibrateSettings,
        error: PoorCalibration,
        instances: Sequence[int] = (),
        track: Track | None = None,
    ) -> dict[str, object]:
        """Put together the document of a calibration that could not be solved."""
        chosen = instances or settings.instances or (1,)
        return refused_document(self.source, settings.method, chosen, str(error), track)

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


def solve_recording(wanted: Results, settings: CalibrateSettings, in_force_file: Path | None) -> int:
    """Solve every compass wanted of a recording; return the exit code."""
    source, output = wanted.source, wanted.output
    track = _read(source, in_force_file)
    if missing := [i for i in settings.instances if i not in track.compasses]:
        raise BadRecording(
            f"{source} has no compass {missing[0]}; it has {', '.join(map(str, track.compasses)) or 'none'}.",
            "Choose with --compass.",
        )
    chosen = settings.instances or tuple(track.compasses)
    limits = Limits(heading_deg=settings.max_heading_error_deg)
    try:
        with showing_progress(Path(source).name) as progress:
            progress("calibrating")
            found = calibrate_compasses(
                track,
                settings.method,
                chosen,
                limits=limits,
                turn=settings.orientation,
                true_heading=settings.true_heading,
            )
    except PoorCalibration as error:
        output.write_json(wanted.refused(settings, error, chosen, track))
        raise
    results = _with_others(track, list(found.values()), settings.method, limits)
    for note in track.notes:
        output.say(f"Note: {note}")
    for result in results:
        say_result(output, result)
    document = recording_document(source, track, results, settings.method)
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


def _with_others(
    track: Track, results: list[CalibrationResult], method: str, limits: Limits
) -> list[CalibrationResult]:
    """Name, beside what a method that was chosen refuses, the methods that would accept the recording."""
    refused = tuple(result.instance for result in results if not result.accepted)
    said: dict[int, list[str]] = {i: [] for i in refused}
    for name in _OTHERS if refused and method != "auto" else ():
        if name == method:
            continue
        with suppress(PoorCalibration):
            for i, other in calibrate_compasses(track, name, refused, limits=limits).items():
                if other.accepted:
                    within = f"heading within {other.heading_sigma_deg:.1f} deg"
                    said[i].append(f"--method {name} would accept this recording: {within}.")
    return [replace(one, warnings=(*one.warnings, *said.get(one.instance, ()))) for one in results]


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


# --- a live vehicle --------------------------------------------------------------------------------


def calibrate_vehicle(link: Link, wanted: Results, settings: CalibrateSettings, speak: bool) -> int:
    """Calibrate a live vehicle; return the exit code."""
    try:
        document, code = calibrate_one(link, wanted, settings, speak)
    except PoorCalibration as error:
        wanted.output.write_json(wanted.refused(settings, error))
        raise
    wanted.output.write_json(document)
    return code


def calibrate_one(
    link: Link, wanted: Results, settings: CalibrateSettings, speak: bool, stop: StopRequest | None = None
) -> tuple[dict[str, object], int]:
    """Calibrate a live vehicle; return its document, written nowhere yet, and the exit code."""
    source, output = wanted.source, wanted.output
    before_deg = _true_error_deg(link, settings.instances)
    told_later = _told_later(output)
    person = getattr(link, "person", None)  # of an embedded simulator: follows what is shown
    from mavcompass.cli.terminal.show import showing, speaking

    with showing(told_later=told_later) as shown, speaking(shown, speak) as spoken:

        def show(what: Show) -> None:
            spoken(what)
            if person is not None:
                person(what)

        report = calibrate_on(link, source, settings, on_show=show, on_ask=shown.ask, stop=stop)
    after_deg = _true_error_deg(link, settings.instances)
    for result in report.results:
        say_result(output, result)
    for message in report.messages:
        if message != CANCELLED:
            output.say(f"Note: {message}")
    document = live_document(source, report, settings.method)
    if before_deg is not None and after_deg is not None:
        output.say(
            f"Heading error against the simulator's truth, rms over the circle:"
            f" {before_deg:.2f} deg before, {after_deg:.2f} deg after."
        )
        document["true_heading_error_deg"] = {"before": before_deg, "after": after_deg}
    if report.accepted:
        wanted.write_params(document, report.vehicle)
    if wanted.report_file is not None:
        from mavcompass.report.calibration import write_report

        write_report(report, wanted.report_file)
        output.say(f"Report: {wanted.report_file}")
    say_outcome(output, report)
    return document, _exit_code(report)


def _told_later(output: Output) -> tuple[str, ...]:
    """Name the steps whose outcome the same eyes see again, as the result: it is not shown twice."""
    apart = output.json_file == "-" or sys.stdout.isatty() != sys.stderr.isatty()
    return () if apart else ("solve", "written", "prove")


def _true_error_deg(link: Link, instances: tuple[int, ...]) -> float | None:
    """Return the heading error that an embedded simulator knows, of the first compass calibrated."""
    autopilot = getattr(link, "autopilot", None)
    if autopilot is None:
        return None
    from mavcompass.simulation.heading_error import heading_error_rms_deg
    from mavcompass.simulation.vehicle import SimulatedAutopilot

    if not isinstance(autopilot, SimulatedAutopilot):
        return None
    return heading_error_rms_deg(autopilot, instances[0] if instances else 1)


def _exit_code(report: CalibrationReport) -> int:
    if not report.accepted or report.undone:
        return NOT_ACCEPTED
    if report.plan is not None and report.plan.refusals:
        return NOT_ACCEPTED
    return STEERS_OFF if report.steers_off else 0


def say_outcome(output: Output, report: CalibrationReport) -> None:
    """Say what became of a vehicle's parameters."""
    outcome = report.outcome
    if report.written and outcome is not None:
        output.say("Written and read back.")
        for line in _mounting(report):
            output.say(line)
        if report.proof is not None:
            output.say(report.proof.summary())
        if outcome.undo_file is not None:
            output.say(f"To undo: {outcome.restore_command}")
        if report.heading is not None:
            said = report.heading.summary()
            output.say(styled(said, fg="red") if report.steers_off else said)
            if report.heading.not_loaded:
                output.say(f"Land and disarm it, then: {outcome.again_command}")
                output.say("Next time let it land by itself: --land.")
    elif report.undone:
        output.say("The old values are back on the vehicle: nothing has changed.")
    else:
        output.say(f"{CANCELLED} Nothing written." if CANCELLED in report.messages else "Nothing written.")
        if report.heading is not None and report.heading.known:
            output.say(report.heading.summary())


def _mounting(report: CalibrationReport) -> list[str]:
    """Say how a compass was set to be mounted, where that was written too."""
    found = [name for r in report.results for name in r.mounting.setting]
    changes = [] if report.plan is None else [c for c in report.plan.changes if c.name in found]
    return [f"Mounted otherwise than was set: {c.name} {c.old:g} -> {c.new:g}." for c in changes]


def calibrate_all(link: Link, wanted: Results, settings: CalibrateSettings, speak: bool) -> int:
    """Calibrate every vehicle that is heard; return the largest exit code of them.

    What befalls one vehicle does not keep the next from its turn; a person's stop does.
    Raises NoVehicle where none is heard.
    """
    output, stop = wanted.output, StopRequest()
    found = run(Machine(find_vehicles), link, stop=stop)
    documents: list[dict[str, object]] = []
    worst, lines = 0, []
    for vehicle in found:
        name = str(vehicle)
        output.say(styled(f"{name}:", bold=True))
        mine = wanted.of_system(vehicle.system)
        trouble: MavCompassError | None = None
        try:
            document, code = calibrate_one(link, mine, replace(settings, system=vehicle.system), speak, stop)
        except MavCompassError as error:
            trouble, code = error, error.exit_code
            refused = mine.refused(settings, error) if isinstance(error, PoorCalibration) else {}
            document = {**refused, "error": error.what, "remedy": error.remedy}
            output.say(styled(str(error), fg="red"))
        documents.append({"system": vehicle.system, "exit_code": code, **document})
        worst = max(worst, code)
        lines.append(f"{name}: {_ending(document, code, trouble)}")
        if stop.reason is not None:
            break
    output.write_json({"schema": SCHEMA, "source": wanted.source, "vehicles": documents})
    for line in lines:
        output.say(line)
    left = [str(vehicle.system) for vehicle in found[len(documents) :]]
    if left:
        output.say(f"Stopped; not calibrated: system {', '.join(left)}.")
    return worst


def _ending(document: dict[str, object], code: int, trouble: MavCompassError | None) -> str:
    if trouble is not None:
        return trouble.what
    compasses = document["compasses"]
    assert isinstance(compasses, list)
    accepted = all(compass["accepted"] for compass in compasses)
    done = "written and checked" if document["written"] else "not written"
    steers = " The autopilot's own heading is still off: see above." if code == STEERS_OFF else ""
    return f"{'calibrated' if accepted else 'not accepted'}, {done}.{steers}"
