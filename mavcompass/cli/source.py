"""What commands on a vehicle or a recording share: options, what they need, opening it, asking to write."""

from __future__ import annotations

import os
import sys
from collections.abc import Callable, Sequence
from contextlib import closing
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING

import click

from mavcompass.calibration.methods import method_names
from mavcompass.cli.options import THERE, Number, Whole
from mavcompass.errors import UsageError
from mavcompass.installation.parts import require
from mavcompass.vehicle.transport import Address, Serial, parse_address

if TYPE_CHECKING:
    from mavcompass.vehicle.link import Link
    from mavcompass.vehicle.links.server import VehicleServer
    from mavcompass.vehicle.transport import Transport, WireAddress


def _instances(
    context: click.Context, parameter: click.Parameter, value: str | None
) -> tuple[int, ...] | None:
    if value is None or value == "all":
        return None if value is None else ()
    try:
        chosen = tuple(sorted({int(part) for part in value.split(",")}))
    except ValueError:
        chosen = ()
    if not chosen or any(i not in (1, 2, 3) for i in chosen):
        raise click.BadParameter("give numbers from 1 to 3, such as 1,2, or all.", context, parameter)
    return chosen


recorded_compass_option = click.option(
    "--compass", "instances", default="1", callback=_instances, help="1, 2, 3, a list of them, or all."
)
compass_option = click.option(
    "--compass",
    "instances",
    callback=_instances,
    help="1, 2, 3, a list of them, or all (a live vehicle: all; a recording: 1).",
)
system_option = click.option(
    "--system", type=Whole(1, 255), help="System id, where several vehicles are heard."
)


def _systems(context: click.Context, parameter: click.Parameter, value: str | None) -> int | str | None:
    if value is None or value == "all":
        return value
    if value.isdecimal() and 1 <= int(value) <= 255:
        return int(value)
    raise click.BadParameter("give a system id from 1 to 255, or all.", context, parameter)


systems_option = click.option(
    "--system",
    callback=_systems,
    metavar="N|all",
    help="System id, where several vehicles are heard; all turns one after the other.",
)


def _sign_key(context: click.Context, parameter: click.Parameter, value: Path | None) -> None:
    if value is not None:
        from mavcompass.vehicle.opening import SIGN_KEY_VARIABLE

        os.environ[SIGN_KEY_VARIABLE] = str(value.absolute())


sign_key_option = click.option(
    "--sign-key",
    type=THERE,
    callback=_sign_key,
    expose_value=False,
    help="Sign what is sent with the key in this file, and drop what is not signed with it.",
)
effects_option = click.option(
    "--effect",
    "effects",
    multiple=True,
    metavar="NAME[:p=v,..]",
    help="An effect for sim:... (see gap catalogue).",
)
method_option = click.option(
    "--method",
    type=click.Choice(method_names()),
    default="auto",
    show_default=True,
    help="How the readings are solved (auto: four positions; in a recording without them, its motion;"
    " autopilot: its own calibration, judged; one-point: offsets by --true-heading; touch-up: offsets by a"
    " quarter turn, scales as they are).",
)
max_error_option = click.option(
    "--max-error-deg",
    type=Number(0.1, 45.0),
    default=2.0,
    show_default=True,
    help="Accept no calibration with a larger predicted heading error.",
)
reference_option = click.option(
    "--reference",
    type=click.Choice(("auto", "gyro", "gps-yaw", "attitude", "columns")),
    default="auto",
    show_default=True,
    help="The attitude that the compass is compared with (auto: all that knows it).",
)


def refuse_unasked_write(yes: bool, dry_run: bool) -> None:
    """Raise UsageError where it is not clear whether to write, and nobody can be asked."""
    refuse_contradiction(yes, dry_run)
    if not yes and not dry_run and not sys.stdin.isatty():
        raise UsageError(
            "Nobody can be asked whether to write: standard input is not a terminal.",
            "Give --yes to write without asking, or --dry-run to write nothing.",
        )


def refuse_contradiction(yes: bool, dry_run: bool) -> None:
    """Raise UsageError for --yes with --dry-run."""
    if yes and dry_run:
        raise UsageError("--yes and --dry-run exclude each other.", "Give one of them.")


def this_year() -> float:
    """Return this computer's decimal year, for a vehicle that does not know the date."""
    import time

    from mavcompass.earth_field import decimal_year

    return round(decimal_year(time.time()), 2)


def open_source(
    address: Address, effects: Sequence[str], as_ground_station: bool = False, by_hand: bool = False
) -> Link:
    """Open a live address; effects, and who turns it by hand, are of an embedded simulated vehicle.

    The pilot's controls are taken from a ground station only (SYSID_MYGCS).
    """
    from mavcompass.vehicle.link import GROUND_STATION, ONBOARD_COMPUTER
    from mavcompass.vehicle.opening import open_link
    from mavcompass.vehicle.transport import Simulated

    if isinstance(address, Simulated):
        address = replace(address, effects=(*address.effects, *effects))
    elif effects:
        raise UsageError("--effect is for sim:VEHICLE only.", "Leave it away for a real vehicle.")
    identity = GROUND_STATION if as_ground_station else ONBOARD_COMPUTER
    return open_link(address, identity, by_hand=by_hand)


def require_for(
    *sources: str | Path | Address | None, report: Path | bool | None = None, also: tuple[str, ...] = ()
) -> None:
    """Raise UsageError where a part that these sources, a report or `also` need is not installed, or the
    report's folder is not there.

    Args:
        sources: addresses and recordings; None for one that was not given.
        report: the file of a report, or whether there is one.
        also: more keys of `PARTS`.
    """
    addresses = (parse_address(source) if isinstance(source, str) else source for source in sources)
    serial = ["A serial port"] if any(isinstance(address, Serial) for address in addresses) else []
    require(*serial, *(["An HTML report"] if report else []), *also)
    if isinstance(report, Path) and not report.absolute().parent.is_dir():
        raise UsageError(
            f"The report could not be written: the folder of {report} does not exist.",
            "Make it, or name another.",
        )


# --- a vehicle at a port, for any number of clients -------------------------------------------------

listen_option = click.option(
    "--listen",
    "where",
    required=True,
    metavar="ADDRESS",
    help="tcp:HOST:PORT or udpin:HOST:PORT wait for clients; udpout:HOST:PORT speaks first.",
)
speed_option = click.option(
    "--speed",
    type=Number(0.01, 1000.0),
    default=1.0,
    show_default=True,
    help="2 is twice real time.",
)
quiet_option = click.option("--quiet", is_flag=True, help="Do not say where it listens.")


def serve(
    address: WireAddress, at: Callable[[Transport], VehicleServer], say: Callable[[str], None]
) -> dict[str, object]:
    """Serve a vehicle at an address until its end, Ctrl-C or SIGTERM; return what a program is told of it.

    Args:
        at: puts the vehicle at the open port.
        say: tells a person where the port is.
    """
    from mavcompass.vehicle.stopping import StopRequest, stop_signals
    from mavcompass.vehicle.transport import open_transport

    stop = StopRequest()
    with closing(open_transport(address)) as transport:
        server = at(transport)
        with stop_signals(stop):
            say(transport.name)
            server.serve(stop)
    heard = server.statistics
    return {
        "address": transport.name,
        "received": heard.received,
        "malformed": heard.malformed,
        "dropped": heard.dropped,
    }
