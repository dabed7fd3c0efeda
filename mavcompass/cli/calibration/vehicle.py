"""Calibrate a live vehicle: let it turn, solve, write, prove."""

from __future__ import annotations

import sys

from mavcompass.cli.calibration.wanted import NOT_ACCEPTED, STEERS_OFF, Wanted
from mavcompass.cli.calibration.words import say_outcome, say_result
from mavcompass.cli.options import Output
from mavcompass.cli.terminal.show import showing
from mavcompass.cli.terminal.speech import speaking
from mavcompass.errors import PoorCalibration
from mavcompass.procedure.calibrate import CalibrateSettings
from mavcompass.procedure.report import CalibrationReport
from mavcompass.procedure.script import Show
from mavcompass.report.document import live_document
from mavcompass.vehicle.calibrating import calibrate_on
from mavcompass.vehicle.link import Link
from mavcompass.vehicle.stopping import StopRequest


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
            wanted.method,
            wanted.max_error_deg,
            on_show=show,
            on_ask=shown.ask,
            stop=stop,
        )
    after_deg = _true_error_deg(link, settings.instances)
    for result in report.results:
        say_result(output, result)
    for message in report.messages:
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
