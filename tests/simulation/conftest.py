"""A ground station's chair in front of a simulated vehicle, in virtual time."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import TypeVar

import pytest

from mavcompass import messages as m
from mavcompass.simulation.autopilot.board import Outgoing
from mavcompass.simulation.vehicle import SimulatedAutopilot

M = TypeVar("M", bound=m.Message)


class Station:
    """Talk to a simulated vehicle as ground station 255/190 and remember what it says."""

    def __init__(self, vehicle: SimulatedAutopilot) -> None:
        self.vehicle = vehicle
        self.heard: list[Outgoing] = []

    def send(self, message: m.Message, system: int = 255, port: int = 0) -> None:
        self.vehicle.receive(message, system, 190, port)

    def wait(self, seconds: float) -> list[Outgoing]:
        new = self.vehicle.advance(self.vehicle.time_s + seconds)
        self.heard += new
        return new

    def ask(self, message: m.Message, kind: type[M], seconds: float = 0.2) -> list[M]:
        self.send(message)
        return self.of(kind, self.wait(seconds))

    def of(self, kind: type[M], outgoing: list[Outgoing] | None = None) -> list[M]:
        source = self.heard if outgoing is None else outgoing
        return [o.message for o in source if type(o.message) is kind]

    def command(self, number: int, *params: float) -> int:
        """Send a COMMAND_LONG and return the result of its COMMAND_ACK."""
        padded = (*params, *(0.0,) * (7 - len(params)))
        answers = self.ask(m.CommandLong(1, 1, number, 0, *padded), m.CommandAck)
        (ack,) = (a for a in answers if a.command == number)
        return ack.result

    def stream(self, number: int, hz: float) -> int:
        return self.command(511, number, round(1e6 / hz))

    def set(self, name: str, value: float) -> list[m.ParamValue]:
        return self.ask(m.ParamSet(1, 1, name, value), m.ParamValue)

    def read(self, name: str) -> float:
        (value,) = self.ask(m.ParamRequestRead(1, 1, name), m.ParamValue)
        return value.param_value

    def texts(self, outgoing: list[Outgoing] | None = None) -> list[str]:
        return [t.text for t in self.of(m.Statustext, outgoing)]

    def hold_heading(self, yaw_rad: float, seconds: float) -> list[Outgoing]:
        """Repeat a heading target four times a second, as a rover needs it."""
        new: list[Outgoing] = []
        for _ in range(round(seconds * 4)):
            self.send(m.SetPositionTargetLocalNed(0, 1, 1, 1, 0x9FF, yaw=yaw_rad))
            new += self.wait(0.25)
        return new

    @property
    def turned_deg(self) -> float:
        """The true yaw, degrees."""
        return math.degrees(self.vehicle.truth.yaw_rad)

    @property
    def ekf_error_deg(self) -> float:
        """How far the autopilot's yaw is off."""
        return degrees_between(self.vehicle.filter.yaw_rad, self.vehicle.truth.yaw_rad)


def degrees_between(a_rad: float, b_rad: float) -> float:
    return math.degrees((a_rad - b_rad + math.pi) % (2.0 * math.pi) - math.pi)


@pytest.fixture
def station() -> Callable[..., Station]:
    """Make a station before a new simulated vehicle: station("rover", seed=3)."""

    def build(vehicle: str = "rover", **options: object) -> Station:
        return Station(SimulatedAutopilot(vehicle, **options))  # type: ignore[arg-type]

    return build
