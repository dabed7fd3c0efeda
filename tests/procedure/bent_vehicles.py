"""Simulated vehicles whose compass is as wrong as a compass can be and still be cured."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import TypeVar

from mavcompass.messages import CommandLong, Incoming, Message
from mavcompass.procedure.report import CalibrationReport
from mavcompass.procedure.script import Context, Machine, Script, Show
from mavcompass.procedure.settings import CalibrateSettings
from mavcompass.procedure.vehicle_state import VehicleState, find_vehicle
from mavcompass.simulation.physics.noise import generator
from mavcompass.simulation.physics.sensors import CompassSetup
from mavcompass.simulation.vehicle import SimulatedAutopilot
from mavcompass.vehicle.calibrating import calibrate_on
from mavcompass.vehicle.driver import run
from mavcompass.vehicle.link import ONBOARD_COMPUTER, Identity, Link
from mavcompass.vehicle.links.simulated import SimulatedLink
from mavcompass.vehicle.stopping import StopRequest

T = TypeVar("T")
KINDS = ("rover", "ackermann-rover", "boat", "copter", "sub", "px4-copter")


def bent_compasses(
    kind: str, seed: int, mgauss: float, toward_rad: float, down_mgauss: float = 0.0
) -> list[CompassSetup]:
    """Return a vehicle's compasses, what is in force for the first wrong by so much."""
    first, *others = SimulatedAutopilot(kind, seed=seed).board.compass_setups
    x, y, z = first.model.iron.offsets_mgauss
    bent = (x + mgauss * math.cos(toward_rad), y + mgauss * math.sin(toward_rad), z + down_mgauss)
    return [replace(first, in_force=replace(first.model.iron, offsets_mgauss=bent)), *others]


def bent_vehicle(kind: str, seed: int, share: float = 1.0) -> SimulatedAutopilot:
    """Make a vehicle whose steering compass is wrong by `share` of the horizontal field."""
    mgauss = share * SimulatedAutopilot(kind, seed=seed).world.horizontal_mgauss
    toward = float(generator(seed, "bent").uniform(0.0, 2.0 * math.pi))
    return SimulatedAutopilot(kind, seed=seed, compasses=bent_compasses(kind, seed, mgauss, toward, 20.0))


def untouched(vehicle: SimulatedAutopilot) -> tuple[object, ...]:
    """Return everything that a calibration of compass 1 leaves as it was."""
    # STAT_RUNTIME counts seconds.
    ours = ("COMPASS_OFS_", "COMPASS_DIA_", "COMPASS_ODI_", "COMPASS_SCALE", "CAL_MAG0_", "STAT_")
    streams = vehicle.firmware.telemetry.streams(0)
    return (
        {name: value for name, value in vehicle.firmware.store.values.items() if not name.startswith(ours)},
        vehicle.firmware.reports.heartbeat().custom_mode,
        vehicle.firmware.reports.heartbeat().base_mode,
        {number: streams.interval_us(number) for number in vehicle.firmware.telemetry.available},
    )


def overheard(vehicle: SimulatedAutopilot) -> list[Message]:
    """Return a list that fills with the messages the vehicle is sent."""
    heard: list[Message] = []
    receive = vehicle.receive

    def witness(message: Message, *sender: int) -> None:
        heard.append(message)
        receive(message, *sender)

    vehicle.receive = witness  # type: ignore[method-assign, assignment]
    return heard


def commands(heard: list[Message]) -> set[int]:
    """Return the numbers of the commands among messages."""
    return {message.command for message in heard if isinstance(message, CommandLong)}


def calibrated(
    vehicle: SimulatedAutopilot,
    folder: Path,
    settings: CalibrateSettings | None = None,
    link: Link | None = None,
    shown: list[str] | None = None,
    stop: StopRequest | None = None,
    identity: Identity = ONBOARD_COMPUTER,
) -> CalibrationReport:
    """Calibrate a vehicle in virtual time, and write."""

    def show(what: Show) -> None:
        if shown is not None:
            shown.append(what.text)

    return calibrate_on(
        link or SimulatedLink(vehicle, identity=identity),
        "sim:test",
        settings or CalibrateSettings(writing="yes"),
        on_show=show,
        stop=stop,
        undo_directory=folder,
    )


def perform(
    vehicle: SimulatedAutopilot,
    script: Callable[[Context, VehicleState], Script[T]],
    listeners: tuple[Callable[[Incoming], None], ...] = (),
    identity: Identity = ONBOARD_COMPUTER,
    shown: list[str] | None = None,
) -> T:
    """Run a script on a vehicle that has been found and whose state is known."""
    texts = [] if shown is None else shown

    def whole(context: Context) -> Script[T]:
        state = VehicleState()
        context.listeners += [state.hear, *listeners]
        yield from find_vehicle(context)
        return (yield from script(context, state))

    return run(
        Machine(whole),
        SimulatedLink(vehicle, identity=identity),
        on_show=lambda show: texts.append(show.text),
    )
