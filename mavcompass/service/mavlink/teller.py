"""Tell ground stations over MAVLink, and answer what they command."""

from __future__ import annotations

import logging
import math
from collections.abc import Sequence

from mavcompass import messages as mav
from mavcompass.enums import MavResult
from mavcompass.errors import MavCompassError
from mavcompass.messages import Incoming
from mavcompass.service.config import ServiceConfig
from mavcompass.service.mavlink import component
from mavcompass.service.view import GONE_S, VehicleView
from mavcompass.service.watch import Finding
from mavcompass.service.work.clock import Schedule, utc_now
from mavcompass.service.work.tasks import Busy, CalibrationRequest, Desk, Task
from mavcompass.vehicle.link import Link

_log = logging.getLogger(__name__)

_PROGRESS_EVERY_S = 0.2
# A report is sent several times: nobody acknowledges it, and links lose messages.
_REPORT_TIMES, _REPORT_EVERY_S = 8, 1.0


class Teller:
    """Keep what was told already."""

    def __init__(self, config: ServiceConfig, desk: Desk, due: Schedule) -> None:
        self._config = config
        self._desk = desk
        self._due = due
        self._announced: set[tuple[str, int]] = set()
        self._stage = (0, False)
        self._times = 0

    def tell(self, link: Link, view: VehicleView, findings: Sequence[Finding], now_s: float) -> None:
        """Send what is due now."""
        self._announce(link, findings)
        self._heading(link, view, now_s)
        task = self._desk.current
        if task is not None and task.state != "waiting":
            self._task(link, view, task, now_s)

    def _announce(self, link: Link, findings: Sequence[Finding]) -> None:
        """Tell the pilot of findings that are new."""
        for finding in findings:
            if (finding.id, finding.instance) not in self._announced:
                _log.warning("%s %s", finding.text, finding.remedy)
                if self._config.mavlink.statustext:
                    link.send(component.finding_text(finding))
        self._announced = {(finding.id, finding.instance) for finding in findings}

    def _heading(self, link: Link, view: VehicleView, now_s: float) -> None:
        rate_hz = self._config.mavlink.heading_hz
        if not rate_hz or not self._due.is_due("heading", now_s, 1.0 / rate_hz):
            return
        first = view.compasses.get(1)
        heading = None if first is None else first.latest
        if heading is not None and now_s - heading.time_s < 1.0:
            angle_rad = heading.magnetic_rad if heading.true_rad is None else heading.true_rad
            for value in component.heading_values(
                heading.boot_s, math.degrees(angle_rad), math.degrees(heading.sigma_rad)
            ):
                link.send(value)

    def _task(self, link: Link, view: VehicleView, task: Task, now_s: float) -> None:
        """Send a calibration's progress while it runs, and its report when there is one."""
        is_calibration = isinstance(task.request, CalibrationRequest)
        compasses = self._compasses(task, view) if is_calibration else ()
        if not task.finished and task.state != "asking":
            if self._due.is_due("progress", now_s, _PROGRESS_EVERY_S):
                _send(link, component.progress(task, compasses))
            return
        if (stage := (task.number, task.finished)) != self._stage:
            self._stage, self._times = stage, 0
            self._due.hurry("report")
            if task.results:
                _send(link, component.progress(task, compasses))
            if task.finished and self._config.mavlink.statustext:
                _send(link, component.outcome_texts(task))
        there = now_s - view.heard_s < GONE_S  # a report sent into a cut link is lost
        if is_calibration and there and self._times < _REPORT_TIMES:
            if self._due.is_due("report", now_s, _REPORT_EVERY_S):
                self._times += 1
                _send(link, component.reports(task, compasses))

    def _compasses(self, task: Task, view: VehicleView) -> tuple[int, ...]:
        assert isinstance(task.request, CalibrationRequest)
        return task.request.compasses or self._config.vehicle.compasses or view.instances()

    # --- commands -----------------------------------------------------------------------------------

    def hear_command(
        self, link: Link, view: VehicleView | None, heard: Incoming, offered: Sequence[int]
    ) -> None:
        """Answer a command that is addressed to this component; pass over anything else.

        `offered` are the compasses for which something better was learnt.
        """
        command = component.as_long(heard.message)
        address = (link.identity.spoken_system, link.identity.component)
        if command is None or (command.target_system, command.target_component) != address:
            return
        task = self._desk.current
        compasses = () if view is None else self._config.vehicle.compasses or view.instances()
        accepts = self._config.mavlink.accept_commands
        reply = component.answer(command, task, compasses, accepts, offered)
        result = reply.result if reply.order is None else self._obey(reply.order, reply.result, task)
        link.send(mav.CommandAck(command.command, result, 0, 0, heard.system, heard.component))

    def _obey(self, order: component.Order, result: MavResult, task: Task | None) -> MavResult:
        if order.request is not None:
            if not order.request.compasses:
                return MavResult.TEMPORARILY_REJECTED  # the vehicle is not known yet
            try:
                self._desk.submit(order.request, "mavlink", utc_now())
            except MavCompassError as error:
                return MavResult.TEMPORARILY_REJECTED if isinstance(error, Busy) else MavResult.DENIED
        elif task is not None and order.verb == "accept":
            return result if task.give_answer(True) else MavResult.TEMPORARILY_REJECTED
        elif task is not None and not task.give_answer(False):
            task.stop.reason = "Cancelled by the ground station."
        return result


def _send(link: Link, messages: Sequence[mav.Message]) -> None:
    for message in messages:
        link.send(message)
