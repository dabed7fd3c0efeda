"""`mavcompass simulate`: a simulated flight controller on a real port."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager, nullcontext
from pathlib import Path
from typing import TYPE_CHECKING

import click

from mavcompass.cli.options import FILE, Output, Whole, common_options
from mavcompass.cli.source import listen_option, quiet_option, require_for, serve, speed_option
from mavcompass.errors import UsageError
from mavcompass.vehicle.transport import VEHICLES

if TYPE_CHECKING:
    from mavcompass.vehicle.links.server import Record
    from mavcompass.vehicle.transport import Transport


@contextmanager
def recording_to(tlog: Path, utc_start_s: float) -> Iterator[Record]:
    """Give a function that records frames at a virtual time. Raises UsageError for a file that cannot be."""
    from mavcompass.logs import TlogWriter

    try:
        writer = TlogWriter(tlog)
    except OSError as error:
        raise UsageError(
            f"{tlog} cannot be written: {error.strerror}.",
            "Give --tlog a file in a folder that you may write to.",
        ) from error
    start_us = round(utc_start_s * 1e6)
    with writer:
        yield lambda time_s, frame: writer.append(start_us + round(time_s * 1e6), frame)


@click.command()
@click.option(
    "--vehicle",
    type=click.Choice(VEHICLES),
    default="rover",
    show_default=True,
    help="What kind of vehicle, with its firmware.",
)
@listen_option
@click.option(
    "--effect",
    "effects",
    multiple=True,
    metavar="NAME[:p=v,..]",
    help="A physical effect on compass 1 and its IMU (see gap catalogue); may be repeated.",
)
@click.option("--seed", type=Whole(0), default=0, show_default=True, help="Of everything random.")
@speed_option
@click.option("--disarmed", is_flag=True, help="Start at power-up, disarmed (default: armed and ready).")
@click.option(
    "--tlog",
    type=FILE,
    help="Record what the vehicle sends to its first client.",
)
@quiet_option
@common_options
def command(
    vehicle: str,
    where: str,
    effects: tuple[str, ...],
    seed: int,
    speed: float,
    disarmed: bool,
    tlog: Path | None,
    quiet: bool,
    output: Output,
) -> int:
    """Run a simulated flight controller for any number of MAVLink clients, until Ctrl-C or SIGTERM.

    Its time begins when the first client is there. Everything follows from the seed and the clients' doings.

    \b
    mavcompass simulate --vehicle rover --listen tcp:127.0.0.1:5760
    mavcompass simulate --vehicle copter --listen udpout:127.0.0.1:14550 --seed 7
    """
    from mavcompass.vehicle.links.server import VehicleServer
    from mavcompass.vehicle.links.simulated import simulated_autopilot
    from mavcompass.vehicle.transport import listening_address

    address = listening_address(where)
    require_for(address)
    autopilot = simulated_autopilot(vehicle, seed, effects, armed=not disarmed)
    words = f"A simulated {vehicle} (seed {seed}) is at"
    recording = nullcontext() if tlog is None else recording_to(tlog, autopilot.world.utc_start_s)
    with recording as record:

        def at(port: Transport) -> VehicleServer:
            autopilot.moor(port.name)
            return VehicleServer(
                autopilot, port, speed=speed, is_rebooting=lambda: autopilot.rebooting, record=record
            )

        served = serve(
            address, at, lambda where: None if quiet else output.say(f"{words} {where}; Ctrl-C ends it.")
        )
    output.write_json({"vehicle": vehicle, "seed": seed, **served, "vehicle_time_s": autopilot.time_s})
    return 0
