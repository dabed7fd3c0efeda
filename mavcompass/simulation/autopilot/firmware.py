"""What every firmware does alike, and the parts that it is put together from."""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from dataclasses import dataclass
from typing import Protocol

from mavcompass import messages as m
from mavcompass.enums import MavResult
from mavcompass.simulation.autopilot.board import Board, Status
from mavcompass.simulation.autopilot.compasses import Compasses
from mavcompass.simulation.autopilot.guidance import Radio
from mavcompass.simulation.autopilot.parameters import ParameterServer
from mavcompass.simulation.autopilot.reports import Reports
from mavcompass.simulation.autopilot.telemetry import Telemetry
from mavcompass.simulation.physics.motion import Drive


@dataclass(frozen=True, slots=True)
class Sender:
    """Name the station that sent a message, and the port it came in by."""

    system: int
    component: int
    port: int


class Arming(Protocol):
    """Be in charge of the motors."""

    def disarm(self) -> None:
        """Stop the motors."""


class Modes(Protocol):
    """Change modes."""

    def enter(self, name: str) -> bool:
        """Change mode; False where it is refused."""


class Steering(Protocol):
    """Turn mode, targets and sticks into motion."""

    def control(self, dt_s: float) -> Drive:
        """Say what the chassis shall do until the next tick."""


class Commands(Protocol):
    """Answer commands."""

    def answer(self, command: m.CommandLong, port: int) -> MavResult:
        """Carry out a command; what the firmware does not know is UNSUPPORTED."""


class Firmware(ABC):
    """Behave as one autopilot's software; a subclass puts the parts together and adds what differs."""

    board: Board
    status: Status
    parameters: ParameterServer
    compasses: Compasses
    radio: Radio
    arming: Arming
    modes: Modes
    steering: Steering
    reports: Reports
    telemetry: Telemetry
    commands: Commands

    @abstractmethod
    def boot(self, armed: bool) -> None:
        """Power up; `armed` begins in the middle of a mission instead."""

    @abstractmethod
    def hear(self, message: m.Message, sender: Sender) -> None:
        """Act on a message that only this firmware knows what to do with."""

    @abstractmethod
    def attend(self) -> None:
        """Do what is due at a tick: time-outs, periodic texts, parameter lists."""

    @abstractmethod
    def battery_failsafe(self) -> None:
        """React to an empty battery."""

    def handle(self, message: m.Message, sender: Sender) -> None:
        """Act on a message that is for this vehicle; one that means nothing here is ignored."""
        system = getattr(message, "target_system", getattr(message, "target", 0))
        component = getattr(message, "target_component", 0)
        if system not in (0, self.board.system) or component not in (0, self.board.component):
            return
        match message:
            case m.ParamRequestRead():
                self.parameters.read(message, sender.port)
            case m.ParamSet():
                if self.parameters.set(message):
                    self.compasses.parameters_changed()
            case m.ParamRequestList():
                self.parameters.start_list(sender.port)
            case m.CommandLong():
                self.acknowledge(message.command, self.commands.answer(message, sender.port), sender)
            case m.CommandInt():
                result = self.commands.answer(_as_long(message), sender.port)
                self.acknowledge(message.command, result, sender)
            case _:
                self.hear(message, sender)

    def acknowledge(self, command: int, result: MavResult, sender: Sender) -> None:
        """Answer a command, and reboot if that is what it asked for."""
        ack = m.CommandAck(command, result, 0, 0, sender.system, sender.component)
        self.board.send(ack, sender.port)
        if self.status.reboot_wanted:
            self.status.reboot_wanted = False
            self.board.reboot()

    def use_compasses(self, dt_s: float) -> None:
        """Correct the new readings and let the filter have the one that steers."""
        self.compasses.read()
        self.board.filter.correct(dt_s, self.compasses.yaw())

    def align(self) -> None:
        """Take over the attitude at power-up."""
        body = self.board.body
        self.compasses.boot()
        self.compasses.read()
        self.board.filter.align(body.roll_rad, body.pitch_rad, self.compasses.yaw())

    def pilot_moves_stick(self, channel: int, pwm: int, for_s: float) -> None:
        """Hold a stick."""
        self.radio.hold(channel, pwm, self.board.boot_time_s + for_s)


def _as_long(command: m.CommandInt) -> m.CommandLong:
    """Read a COMMAND_INT as the COMMAND_LONG of the same meaning (places in degrees)."""
    return m.CommandLong(
        command.target_system,
        command.target_component,
        command.command,
        0,
        command.param1,
        command.param2,
        command.param3,
        command.param4,
        command.x * 1e-7,
        command.y * 1e-7,
        command.z if math.isfinite(command.z) else 0.0,
    )
