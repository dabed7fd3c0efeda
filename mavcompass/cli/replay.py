"""`mavcompass replay`: a recording on a real port, as if the vehicle were there."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

import click

from mavcompass.cli.options import Output, Whole, common_options
from mavcompass.cli.source import listen_option, quiet_option, require_for, serve, speed_option
from mavcompass.errors import UsageError

if TYPE_CHECKING:
    from mavcompass.vehicle.links.faults import Faults
    from mavcompass.vehicle.replay import Alterations

_FAULTS = "loss, duplicate, reorder, latency, jitter, time-jump, saturation, frozen-compass"


@click.command()
@click.argument("log", type=click.Path(path_type=Path))
@listen_option
@speed_option
@click.option(
    "--fault",
    "faults",
    multiple=True,
    metavar="NAME=VALUE",
    help="loss=0.3, duplicate=0.05, reorder=0.1 (probabilities, each way), latency=SECONDS, jitter=SECONDS,"
    " time-jump=AT:BY, saturation=MILLIGAUSS, frozen-compass=AT (seconds of the replay); may be repeated.",
)
@click.option("--seed", type=Whole(0), default=0, show_default=True, help="Of the faults.")
@quiet_option
@common_options
def command(
    log: Path, where: str, speed: float, faults: tuple[str, ...], seed: int, quiet: bool, output: Output
) -> int:
    """Play a recording (.tlog, .bin, .log, .ulg, .csv) to MAVLink clients, until its end or Ctrl-C.

    A .tlog is played frame by frame; any other recording is turned into messages. Parameters and commands
    are answered as the recording has it. Time begins when the first client is there.

    \b
    mavcompass replay flight.tlog --listen udpout:127.0.0.1:14550
    mavcompass replay 00000042.BIN --listen tcp:127.0.0.1:5760 --speed 4 --fault loss=0.1
    """
    from mavcompass.vehicle.links.faults import FaultyRecording
    from mavcompass.vehicle.links.server import VehicleServer
    from mavcompass.vehicle.replay import replayed_autopilot
    from mavcompass.vehicle.transport import listening_address

    address = listening_address(where)
    require_for(log, address)
    on_link, on_vehicle = parse_faults(faults)
    recorded = FaultyRecording(replayed_autopilot(log, on_vehicle), on_link, seed)
    served = serve(
        address,
        lambda port: VehicleServer(recorded, port, speed=speed, is_over=lambda: recorded.ended),
        lambda where: None if quiet else output.say(f"{log} is played at {where}; Ctrl-C ends it."),
    )
    output.write_json(
        {"recording": str(log), **served, "played_s": recorded.time_s, "to_the_end": recorded.ended}
    )
    return 0


def parse_faults(texts: tuple[str, ...]) -> tuple[Faults, Alterations]:
    """Read `--fault NAME=VALUE`. Raises UsageError for what is none."""
    from mavcompass.vehicle.links.faults import Faults
    from mavcompass.vehicle.replay import Alterations

    numbers: dict[str, float] = {}
    jumps: list[tuple[float, float]] = []
    for text in texts:
        name, _, value = text.partition("=")
        try:
            if name == "time-jump":
                at, _, by = value.partition(":")
                jumps.append((float(at), float(by)))
            else:
                numbers[name] = float(value)
        except ValueError:
            raise UsageError(
                f"--fault {text} has no number where one belongs.",
                f"Write NAME=VALUE; the names are {_FAULTS}.",
            ) from None
    for name in ("loss", "duplicate", "reorder"):
        if not 0.0 <= numbers.get(name, 0.0) <= 1.0:
            raise UsageError(f"--fault {name} is a probability.", "Give a number from 0 to 1.")
    on_link = Faults(
        loss=numbers.pop("loss", 0.0),
        duplicate=numbers.pop("duplicate", 0.0),
        reorder=numbers.pop("reorder", 0.0),
        latency_s=max(numbers.pop("latency", 0.0), 0.0),
        jitter_s=max(numbers.pop("jitter", 0.2), 0.0),
    )
    on_vehicle = Alterations(
        tuple(jumps), numbers.pop("saturation", None), numbers.pop("frozen-compass", None)
    )
    if numbers:
        raise UsageError(f"There is no fault {next(iter(numbers))!r}.", f"The names are {_FAULTS}.")
    return on_link, on_vehicle
