"""`mavcompass` alone: find what is there, and ask what to do with it. Nothing moves unasked."""

from __future__ import annotations

from concurrent.futures import ThreadPoolExecutor
from typing import TYPE_CHECKING

import click

from mavcompass.installation.invocation import program

if TYPE_CHECKING:
    from mavcompass.procedure.vehicle_state import VehicleIdentity

NOBODY = 3
# Where vehicles usually send to; BlueOS's port for extensions; mavlink-router's and a simulator's; the one of
# our own snippet for mavlink-router.
PLACES = ("udpin:0.0.0.0:14550", "tcp:127.0.0.1:5777", "tcp:127.0.0.1:5760", "udpin:127.0.0.1:14571")
# A heartbeat comes once a second; all of a link were heard a second after the first.
_LISTEN_S, _OTHERS_S = 3.0, 1.2
_ACTS = {
    "check it; nothing moves": ["check", "--turn", "none"],
    "watch its heading": ["heading"],
    "calibrate it": ["calibrate"],
    "serve its page, for phones too": ["serve", "--http", "0.0.0.0:8808"],
}


def look_around() -> list[str]:
    """Find vehicles, let the person choose one and what to do; return the command for it, or none."""
    from mavcompass.cli.doctor import ports_of

    places = [*map(str, ports_of()), *PLACES]
    click.echo(f"Looking for vehicles: {', '.join(places)} ...")
    with ThreadPoolExecutor(len(places)) as pool:
        found = [one for some in pool.map(vehicles_at, places) for one in some]
    if not found:
        click.echo(
            "No vehicle was heard. Check power and cable, or name its address. What stands in the way here:"
            f"\n  {program()} doctor\nWithout a vehicle, to try it out:\n  {program()} calibrate sim:rover"
        )
        return []
    for number, (place, vehicle) in enumerate(found, 1):
        click.echo(f"  {number}  {vehicle}, on {place}")
    number = 1 if len(found) == 1 else click.prompt("Which", type=click.IntRange(1, len(found)), default=1)
    place, vehicle = found[number - 1]
    for number, act in enumerate(_ACTS, 1):
        click.echo(f"  {number}  {act}")
    chosen = click.prompt("What", type=click.IntRange(1, len(_ACTS)), default=1)
    name, *options = list(_ACTS.values())[chosen - 1]
    if name == "calibrate" and not click.confirm(
        "It turns four times by 90 degrees: itself where it is armed, else you turn it. You are asked before"
        " anything is written. Begin?"
    ):
        return []
    shared = sum(place == other for other, _ in found) > 1
    command = [name, place, *options, *(["--system", str(vehicle.system)] if shared else [])]
    click.echo(f"> {program()} {' '.join(command)}")
    return command


def vehicles_at(place: str) -> list[tuple[str, VehicleIdentity]]:
    """Listen at an address for the autopilots there; what cannot be opened has none."""
    from mavcompass.errors import MavCompassError
    from mavcompass.procedure.script import Machine
    from mavcompass.procedure.vehicle_state import find_vehicles
    from mavcompass.vehicle.driver import run
    from mavcompass.vehicle.opening import open_link

    try:
        with open_link(place) as link:
            heard = run(Machine(lambda context: find_vehicles(context, _LISTEN_S, _OTHERS_S)), link)
    except MavCompassError:
        return []
    return [(place, vehicle) for vehicle in heard]
