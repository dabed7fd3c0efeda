"""Carry out requests on the link, one at a time, while everything else goes on; diagnoses beside that."""

from __future__ import annotations

import logging
import threading
from collections.abc import Callable, Mapping
from dataclasses import replace
from datetime import datetime
from pathlib import Path
from typing import Any, Literal

from mavcompass.calibration.result import CalibrationResult
from mavcompass.compass_parameters import is_calibrated
from mavcompass.errors import MavCompassError, Refused
from mavcompass.messages import Incoming
from mavcompass.procedure.check import CheckReport, CheckSettings, check
from mavcompass.procedure.dialect import Dialect
from mavcompass.procedure.nameplate import Nameplate
from mavcompass.procedure.report import CalibrationReport
from mavcompass.procedure.script import Ask, Context, Machine, Script, Show
from mavcompass.procedure.writing import write_learnt
from mavcompass.service.config import ServiceConfig
from mavcompass.service.view import VehicleView
from mavcompass.service.watch import Finding
from mavcompass.service.work import clock
from mavcompass.service.work.clock import utc_now
from mavcompass.service.work.history import Entry, History
from mavcompass.service.work.learning import Learning
from mavcompass.service.work.north import NorthKeeper
from mavcompass.service.work.results import Recorder, Results, old_and_new, recording_path, sigma_deg
from mavcompass.service.work.tasks import (
    LEARNT,
    CalibrationRequest,
    CheckRequest,
    Desk,
    GapRequest,
    Task,
    UndoRequest,
)
from mavcompass.service.work.worker import DIAGNOSE_S, Worker, diagnose
from mavcompass.vehicle.calibrating import calibration_machine, solve
from mavcompass.vehicle.dialects import make_dialect
from mavcompass.vehicle.driver import PollAnswer, run
from mavcompass.vehicle.link import Link
from mavcompass.vehicle.parameters.transaction import restore_command
from mavcompass.vehicle.parameters.undo import UndoRecord, load_record, newest_record, read_kept, undo_saver
from mavcompass.vehicle.parameters.values import same_value
from mavcompass.vehicle.session import HeldParameters, WriteReport, write_values
from mavcompass.vehicle.stopping import StopRequest

_log = logging.getLogger(__name__)
# Parameters travel as 32 bit floats: what differs by no more is the same.
_SAME_SHARE = 1e-3


class Jobs:
    """Run procedures on the station's thread.

    Attributes:
        recorder: of the calibration under way, None otherwise. task: the one under way, None while idle.
    """

    def __init__(
        self,
        config: ServiceConfig,
        history: History,
        learning: Learning,
        hear: Callable[[Link, Incoming], None],
    ) -> None:
        self.recorder: Recorder | None = None
        self.task: Task | None = None
        self._view: VehicleView | None = None
        self._config = config
        self._source, self._undo_folder = config.vehicle.source, config.folder / "undo"
        self._history = history
        self._learning = learning
        self._hear = hear
        self._worker = Worker()
        self._results = Results(config, history, self._worker)
        self._north = NorthKeeper(config.folder / "north.json")

    def work(self, link: Link, view: VehicleView | None, task: Task) -> None:
        """Carry out a request to its end; whatever goes wrong is told in the task."""
        try:
            if view is None:
                raise MavCompassError("No vehicle was heard yet.", "Check the link, then ask again.")
            self.task, self._view = task, view
            self._do(link, view, task)
        except MavCompassError as error:
            self._results.failed(task, view, error)
        except Exception as error:
            _log.exception("unexpected error in a %s", task.request.kind)
            self._results.failed(task, view, error)
        finally:
            self.recorder = self.task = self._view = None
            self._worker.end()

    def meet(self, link: Link, view: VehicleView, stop: StopRequest) -> None:
        """Read who the vehicle is and what its compasses are set to."""

        def script(context: Context) -> Script[tuple[Nameplate, dict[str, float]]]:
            context.system, context.component = view.identity.system, view.identity.component
            dialect = make_dialect(view.identity.autopilot, self._source)
            parameters = yield from dialect.compass_parameters(context)
            return (yield from dialect.nameplate(context, parameters)), parameters

        try:
            vehicle, parameters = self._drive(link, Machine(script), None, stop)
        except MavCompassError as error:
            _log.info("the compass parameters could not be read yet: %s", error)
            return
        view.key = vehicle.key
        view.set_parameters(parameters)
        note_interrupted_write(self._history, vehicle, parameters, self._undo_folder)

    def judge_calibrations(self, view: VehicleView) -> tuple[Finding, ...]:
        """Compare what is in force with the history, and say how good it is and what true north rests on."""
        dialect = make_dialect(view.identity.autopilot)
        findings: list[Finding] = []
        for instance in view.instances():
            last = self._history.latest_calibration(view.key, view.device_id(instance))
            found = stale_findings(
                instance, dialect, view.parameters, last, clock.now(), self._config.watch.age_days
            )
            findings += found
            changed = any(finding.id in ("parameters", "uncalibrated") for finding in found)
            sigma = None if last is None or changed else sigma_deg(last, instance)
            view.set_calibration_sigma(instance, sigma)
            self._north.learn(view, instance)
        return tuple(findings)

    def _do(self, link: Link, view: VehicleView, task: Task) -> None:
        match task.request:
            case CalibrationRequest() as request:
                machine = self._calibration(view, task, request)
                self.recorder = recorder = Recorder()
                self._results.calibrated(task, view, self._carry_out(link, view, machine, task), recorder)
            case CheckRequest(turn=turn):
                self._results.checked(task, view, self._carry_out(link, view, self._check(view, turn), task))
            case UndoRequest() as request:
                undoing = self._undoing(view, self._results.undo_path(request))
                self._results.undone(task, view, self._carry_out(link, view, undoing, task))

    def _dialect(self, autopilot: str) -> Dialect:
        return make_dialect(autopilot, self._source)

    def _calibration(
        self, view: VehicleView, task: Task, request: CalibrationRequest
    ) -> Machine[CalibrationReport]:
        """Build a calibration that is solved by the worker, or what writes what was learnt on the way."""
        config = self._config.vehicle
        request = replace(request, compasses=request.compasses or config.compasses)
        settings = request.settings(view.identity.system, view.year, config.rate_hz)
        if request.method != LEARNT:
            self._worker.start()

            def solve_there(*problem: Any) -> tuple[CalibrationResult, ...]:
                task.results = self._worker.call(solve, *problem)
                return task.results

            return calibration_machine(self._source, settings, self._undo_folder, solve_there, clock.now)
        offered = {result.instance: result for result in self._learning.offers()}
        results = task.results = tuple(
            result for i, result in offered.items() if i in (request.compasses or offered)
        )
        if not results:
            raise Refused(
                "Nothing was learnt yet that would lower the heading error in force by the margin.",
                "Drive or fly on through all headings, or calibrate by four positions.",
            )
        save = undo_saver(self._source, self._undo_folder, clock.now)
        return Machine(lambda context: write_learnt(context, self._dialect, save, results, settings))

    def _check(self, view: VehicleView, turn: Literal["none", "vehicle", "hand"]) -> Machine[CheckReport]:
        north = {i: compass.north for i, compass in view.compasses.items() if compass.north is not None}
        rate_hz = self._config.vehicle.rate_hz
        settings = CheckSettings(turn, view.identity.system, rate_hz, view.year, north=north)
        return Machine(lambda context: check(context, self._dialect, settings))

    def _undoing(self, view: VehicleView, undo_file: Path) -> Machine[WriteReport]:
        """Build what puts back what an undo file holds, as a transaction of its own."""
        kept = read_kept(undo_file)

        def wanted(held: HeldParameters, vehicle: Nameplate) -> Mapping[str, float]:
            kept.refuse_other(vehicle)
            return kept.values

        save = undo_saver(self._source, self._undo_folder, clock.now)
        return Machine(
            lambda context: write_values(
                context,
                self._source,
                wanted,
                save,
                checked=False,
                consent=lambda held, plan: "",
                system=view.identity.system,
            )
        )

    def _carry_out(self, link: Link, view: VehicleView, machine: Machine[Any], task: Task) -> Any:
        """Run what a task asks for; what the parameters are is not known after it, however it ended."""
        try:
            return self._drive(link, machine, task, task.stop)
        finally:
            view.fresh = False

    def _drive(self, link: Link, machine: Machine[Any], task: Task | None, stop: StopRequest) -> Any:
        """Run a procedure; every message goes to the station, too."""

        def on_show(show: Show) -> None:
            if task is not None:
                task.show(show)
                if show.step == "written" and self._view is not None:
                    self._view.calibrated(task.results)

        def on_ask(question: Ask) -> PollAnswer:
            assert task is not None
            task.ask(question, tuple(map(old_and_new, task.results)) if question.details else ())
            return task.poll_answer

        return run(
            machine,
            link,
            on_show=on_show,
            on_message=lambda heard: self._hear(link, heard),
            on_ask=None if task is None else on_ask,
            stop=stop,
        )


def note_interrupted_write(
    history: History, vehicle: Nameplate, parameters: Mapping[str, float], undo_folder: Path
) -> None:
    """Offer the vehicle's last undo file that the history does not know, where it was made for what it holds.

    `parameters` are those in force of the compasses. What was to be put back at once leaves a file only where
    it was not, and the next calibration puts it back, too.
    """
    newest = newest_record(vehicle, undo_folder, history.undo_files())
    if newest is None:
        return
    record = load_record(newest)
    if record.for_now:
        what = f"A calibration was cut short: {', '.join(record.before)} may not be as before."
    elif _was_written(record, parameters):
        what = "A write was cut short: the vehicle may hold some new and some old values."
    else:
        return
    command = restore_command(record.source, newest, vehicle.system)
    document = {"error": what, "remedy": f"Undo it, here or with: {command}", "lines": []}
    _log.warning("%s %s", what, document["remedy"])
    try:
        history.add("calibration", utc_now(), vehicle.key, False, what, document, undo_file=str(newest))
    except MavCompassError as error:
        _log.warning("%s", error)


def _was_written(record: UndoRecord, now: Mapping[str, float]) -> bool:
    """Tell whether the vehicle holds values that were to be written, and for the rest the old ones."""
    changed = [name for name, old in record.before.items() if name in now and not same_value(now[name], old)]
    return bool(changed) and all(
        name in record.planned and same_value(now[name], record.planned[name]) for name in changed
    )


def stale_findings(
    instance: int,
    dialect: Dialect,
    parameters: Mapping[str, float],
    last: Entry | None,
    now: datetime,
    age_days: float,
) -> list[Finding]:
    """List why the calibration in force on one compass is not, or no longer, what was calibrated."""
    i, findings = instance, list[Finding]()
    if not is_calibrated(dialect.autopilot, parameters, i, dialect.correction(parameters, i)):
        text = f"The autopilot holds no calibration of compass {i}."
        findings.append(
            Finding("uncalibrated", i, "bad", f"Compass {i} is not calibrated", text, "Calibrate it.")
        )
    if last is None:
        return findings
    days = (now - datetime.fromisoformat(last.made_at)).total_seconds() / 86400.0
    if days > age_days:
        short = f"Compass {i}: calibrated {days:.0f} days ago"
        text = f"The calibration of compass {i} is {days:.0f} days old."
        findings.append(Finding("age", i, "warning", short, text, "Calibrate it again.", days, age_days))
    if changed := _changed(last, parameters, i):
        differ = "differs" if len(changed) == 1 else "differ"
        text = f"{', '.join(changed)} of compass {i} {differ} from what was calibrated {last.made_at[:10]}."
        remedy = "If that was not on purpose, put the calibration back or calibrate again."
        short = f"Compass {i}: calibration was changed"
        findings.append(Finding("parameters", i, "warning", short, text, remedy))
    return findings


def _changed(last: Entry, parameters: Mapping[str, float], instance: int) -> list[str]:
    """List the parameters that no longer hold what the last calibration left."""
    left: Mapping[str, float] = last.document.get("in_force", {}).get(str(instance), {})
    return [
        name
        for name, value in left.items()
        if name in parameters and abs(parameters[name] - value) > _SAME_SHARE * max(1.0, abs(value))
    ]


class Gaps:
    """Diagnose one recording at a time; the vehicle is not needed for it."""

    def __init__(self, config: ServiceConfig, history: History) -> None:
        self.desk = Desk()
        self._config = config
        self._history = history
        self._worker = Worker()

    def submit(self, entry: Entry) -> Task:
        """Begin with the recording of a calibration. Raises Busy, or MavCompassError without a recording."""
        path = recording_path(self._config.folder, entry.id)
        if not path.is_file():
            raise MavCompassError(
                f"Calibration {entry.id} has no recording any more.",
                "Choose a newer one, or calibrate again.",
            )
        task = self.desk.submit(GapRequest(str(path), entry.id), "http", utc_now())
        self.desk.take()
        threading.Thread(target=self._work, args=(task, entry), name="gap", daemon=True).start()
        return task

    def _work(self, task: Task, entry: Entry) -> None:
        assert isinstance(task.request, GapRequest)
        path = recording_path(self._config.folder, entry.id)
        report = self._config.folder / "reports" / f"gap-{entry.id}.html"
        task.show(Show("diagnose", "Replaying the recording through the simulation.", 0.1))
        try:
            document = self._worker.call(diagnose, path, report, timeout_s=DIAGNOSE_S)
            summary = f"{document.get('verdict', 'unknown')}: {_causes(document) or 'nothing is named'}"
            what = (entry.vehicle, True, summary, document, entry.compasses, str(report))
            number = self._history.add("gap", utc_now(), *what)
            task.finish(True, document, number)
        except Exception as error:
            if not isinstance(error, MavCompassError):
                _log.exception("unexpected error in a diagnosis")
            task.fail(error)
        finally:
            self._worker.end()

    def stop(self) -> None:
        """End a diagnosis that is under way."""
        self.desk.close("The service is stopping.")
        self._worker.close()


def _causes(document: dict[str, Any]) -> str:
    return ", ".join(str(cause.get("effect")) for cause in document.get("causes", ()))
