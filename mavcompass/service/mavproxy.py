# A MAVProxy module: `module load mavcompass` in MAVProxy, with this package installed beside it.
#
# Copyright (C) 2026 The mavcompass authors
#
# This file, and only this file of mavcompass, is free software: you can redistribute it and/or modify it
# under the terms of the GNU General Public License as published by the Free Software Foundation, either
# version 3 of the License, or (at your option) any later version, because it works inside MAVProxy, which
# is under that licence. It is distributed in the hope that it will be useful, but WITHOUT ANY WARRANTY;
# without even the implied warranty of MERCHANTABILITY or FITNESS FOR A PARTICULAR PURPOSE. See
# https://www.gnu.org/licenses/ for the GNU General Public License.
#
# SPDX-License-Identifier: GPL-3.0-or-later
"""Calibrate and check a vehicle's compass from MAVProxy's command line.

module load mavcompass
mavcompass check
mavcompass calibrate
mavcompass yes
"""

from __future__ import annotations

import time
from dataclasses import fields
from typing import Any

from MAVProxy.modules.lib import mp_module

from mavcompass.errors import MavCompassError
from mavcompass.messages import Incoming, Message
from mavcompass.procedure.check import CheckReport, CheckSettings, check
from mavcompass.procedure.script import Answer, Ask, Event, Machine, Send, Show, Stop, Tick
from mavcompass.procedure.settings import CalibrateSettings
from mavcompass.report.document import live_document
from mavcompass.vehicle.calibrating import calibration_machine
from mavcompass.vehicle.dialects import make_dialect
from mavcompass.vehicle.lock import VehicleLock
from mavcompass.vehicle.wire import decode

_SOURCE = "MAVProxy's link"
_TICK_S = 0.05
_HEADER_BYTES = {b"\xfd": 10, b"\xfe": 6}
_USAGE = "mavcompass calibrate [hand|vehicle] [write] | check [turn] | yes | no | stop | status"


class MavCompassModule(mp_module.MPModule):  # type: ignore[misc]  # MAVProxy ships no types
    """Run mavcompass's procedures on MAVProxy's link.

    Attributes:
        document: the machine-readable result of the last calibration or check.
    """

    def __init__(self, mpstate: Any) -> None:
        super().__init__(mpstate, "mavcompass", "compass calibration in four turns", public=True)
        self.document: dict[str, Any] | None = None
        self._machine: Machine[Any] | None = None
        self._lock = VehicleLock(_SOURCE)
        self._next_tick_s = 0.0
        self._question = ""
        self._streamrates: tuple[int, int] | None = None
        words = ["calibrate (hand|vehicle)", "check (turn)", "yes", "no", "stop", "status"]
        self.add_command("mavcompass", self.command, "calibrate and check the compass", words)

    def command(self, words: list[str]) -> None:
        """Take a line that the person typed."""
        match words:
            case ["calibrate", *options] if set(options) <= {"hand", "vehicle", "write"}:
                motion: Any = next((word for word in options if word != "write"), "auto")
                settings = CalibrateSettings(
                    instances=(),
                    motion=motion,
                    writing="yes" if "write" in options else "ask",
                    system=self._target(),
                    year=time.gmtime().tm_year + 0.5,
                )
                self._begin(calibration_machine(_SOURCE, settings))
            case ["check", *options] if set(options) <= {"turn"}:
                checking = CheckSettings(turn="auto" if options else "none", system=self._target())
                self._begin(Machine(lambda context: check(context, make_dialect, checking)))
            case ["yes" | "no" as answer] if self._question:
                self._question = ""
                self._step(Answer(time.monotonic(), answer == "yes"))
            case ["stop"] if self._machine is not None:
                self._step(Stop(time.monotonic(), "Stopped from MAVProxy."))
            case ["status"]:
                self._say("running" if self._machine is not None else "idle")
            case _:
                self._say(_USAGE)

    def mavlink_packet(self, packet: Any) -> None:
        """Take a message that MAVProxy heard."""
        if self._machine is None:
            return
        frame = bytes(packet.get_msgbuf() or b"")
        header = _HEADER_BYTES.get(frame[:1])
        if header is None:
            return
        # Not packet.get_payload(): that one counts from version 1's header in every version.
        message = decode(packet.get_msgId(), frame[header : header + frame[1]])
        if message is not None:
            sender = (packet.get_srcSystem(), packet.get_srcComponent())
            self._step(Incoming(time.monotonic(), *sender, message))

    def idle_task(self) -> None:
        """Let time pass for the procedure."""
        now_s = time.monotonic()
        if self._machine is not None and now_s >= self._next_tick_s:
            self._next_tick_s = now_s + _TICK_S
            self._step(Tick(now_s))

    def unload(self) -> None:
        """Stop safely."""
        if self._machine is not None:
            self._step(Stop(time.monotonic(), "The module was unloaded."))
        self._end()
        self.remove_command("mavcompass")

    # --- the procedure ------------------------------------------------------------------------------

    def _target(self) -> int | None:
        return int(self.settings.target_system) or None

    def _begin(self, machine: Machine[Any]) -> None:
        if self._machine is not None:
            self._say("something is under way; mavcompass stop ends it")
            return
        self._machine, self.document = machine, None
        machine.context.hold = self._lock.hold
        # MAVProxy asks for its own stream rates again and again, which would undo ours.
        self._streamrates = (self.settings.streamrate, self.settings.streamrate2)
        self.settings.streamrate = self.settings.streamrate2 = -1

    def _step(self, event: Event) -> None:
        machine = self._machine
        if machine is None:
            return
        for action in machine.step(event):
            match action:
                case Send(message):
                    self._send(message)
                case Show():
                    self._say(action.text)
                case Ask(question, about, details):
                    self._question = question
                    self._say("\n".join([*about, *details, question, "mavcompass yes, or mavcompass no"]))
        if machine.done:
            self._end()
            self._tell(machine)

    def _end(self) -> None:
        self._machine, self._question = None, ""
        self._lock.release()
        if self._streamrates is not None:
            self.settings.streamrate, self.settings.streamrate2 = self._streamrates
            self._streamrates = None

    def _send(self, message: Message) -> None:
        values = {field.name: getattr(message, field.name) for field in fields(message)}
        wire = {k: v.encode() if isinstance(v, str) else v for k, v in values.items()}
        getattr(self.master.mav, f"{message.wire_name().lower()}_send")(**wire)

    def _tell(self, machine: Machine[Any]) -> None:
        """Say how it ended."""
        error = machine.error
        if error is not None:
            self._say(
                str(error) if isinstance(error, MavCompassError) else f"{type(error).__name__}: {error}"
            )
            return
        report: Any = machine.result
        if isinstance(report, CheckReport):
            self.document = report.to_json()
            for item in report.items:
                if item.verdict != "pass":
                    self._say(f"{item.verdict.upper()}  {item.text} {item.remedy}")
            self._say(report.summary())
            return
        self.document = live_document(_SOURCE, report, "four-positions")
        for message in report.messages:
            self._say(message)
        if report.heading is not None:
            self._say(report.heading.summary())
        self._say("calibrated, written and read back" if report.written else "nothing was written")

    def _say(self, words: str) -> None:
        self.console.writeln(f"mavcompass: {words}")


def init(mpstate: Any) -> MavCompassModule:
    """Make the module; MAVProxy calls this."""
    return MavCompassModule(mpstate)
