"""Calibrate a live vehicle: let it turn, solve, write, prove; or all of one link, one after the other."""

from __future__ import annotations

import sys
from dataclasses import replace

from mavcompass.cli.calibration.recording import NOT_ACCEPTED, STEERS_OFF, Wanted, say_result
from mavcompass.cli.options import Output
from mavcompass.cli.terminal.colour import styled
from mavcompass.cli.terminal.show import showing
from mavcompass.cli.terminal.speech import speaking
from mavcompass.errors import MavCompassError, PoorCalibration
from mavcompass.procedure.report import CalibrationReport
from mavcompass.procedure.script import Machine, Show
from mavcompass.procedure.settings import CalibrateSettings
from mavcompass.procedure.vehicle_state import find_vehicles
from mavcompass.procedure.writing import CANCELLED
from mavcompass.report.document import live_document
from mavcompass.vehicle.calibrating import calibrate_on
from mavcompass.vehicle.driver import run
from mavcompass.vehicle.link import Link
from mavcompass.vehicle.stopping import StopRequest

SCHEMA = "mavcompass.calibrations/1"


def calibrate_vehicle(link: Link, wanted: Wanted, settings: CalibrateSettings, speak: bool) -> int:
    """Calibrate a live vehicle; return the exit code."""
    try:
        document, code = calibrate_one(link, wanted, settings, speak)
    except PoorCalibration as error:
        wanted.output.write_json(wanted.refused(error, settings.instances or (1,)))
        raise
    wanted.output.write_json(document)
    return code


def calibrate_one(
    link: Link, wanted: Wanted, settings: CalibrateSettings, speak: bool, stop: StopRequest | None = None
) -> tuple[dict[str, object], int]:
    """Calibrate a live vehicle; return its document, written nowhere yet, and the exit code."""
    source, output = wanted.source, wanted.output
    before_deg = _true_error_deg(link, settings.instances)
    told_later = _told_later(output)
    person = getattr(link, "person", None)  # of an embedded simulator: follows what is shown
    with showing(told_later=told_later) as shown, speaking(shown, speak) as spoken:

        def show(what: Show) -> None:
            spoken(what)
            if person is not None:
                person(what)

        report = calibrate_on(
            link,
            source,
            settings,
            on_show=show,
            on_ask=shown.ask,
            stop=stop,
        )
    after_deg = _true_error_deg(link, settings.instances)
    for result in report.results:
        say_result(output, result)
    for message in report.messages:
        if message != CANCELLED:
            output.say(f"Note: {message}")
    document = live_document(source, report, wanted.method)
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
                output.say("And restart it. Or let it land: --land.")
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


def calibrate_all(link: Link, wanted: Wanted, settings: CalibrateSettings, speak: bool) -> int:
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
            refused = (
                mine.refused(error, settings.instances or (1,)) if isinstance(error, PoorCalibration) else {}
            )
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
