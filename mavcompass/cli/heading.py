"""`mavcompass heading SOURCE`: the tilt-compensated heading, live or of a recording."""

from __future__ import annotations

import math
import sys
from collections.abc import Iterator
from contextlib import suppress
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

import click

from mavcompass.cli.options import FILE, Number, Output, Whole, common_options, to_json
from mavcompass.cli.source import require_for, sign_key_option, system_option
from mavcompass.cli.terminal.lines import dial, is_live
from mavcompass.errors import UsageError
from mavcompass.installation.parts import require
from mavcompass.vehicle.transport import Address, Recording, parse_address

if TYPE_CHECKING:
    from mavcompass.heading.one_compass import HeadingResult
    from mavcompass.heading.true_north import TrueNorth
    from mavcompass.track import Track
    from mavcompass.vehicle.heading_stream import LiveHeading


class Row(NamedTuple):
    """Hold one heading as it is shown; degrees, None for what is not known."""

    time_s: float
    magnetic_deg: float
    sigma_deg: float
    true_deg: float | None
    grid_deg: float | None
    north: TrueNorth | None = None

    @classmethod
    def of(cls, heading: LiveHeading) -> Row:
        """Take a heading in radians."""
        true, grid = (None if a is None else math.degrees(a) for a in (heading.true_rad, heading.grid_rad))
        magnetic, sigma = math.degrees(heading.magnetic_rad), math.degrees(heading.sigma_rad)
        return cls(heading.boot_s, magnetic, sigma, true, grid, heading.north)

    def text(self) -> str:
        """Return a line for a person."""
        true = "   -  " if self.true_deg is None else f"{self.true_deg:6.1f}"
        return (
            f"{self.time_s:8.2f} s   magnetic {self.magnetic_deg:6.1f}   true {true}"
            f"   sigma {self.sigma_deg:4.1f} deg"
        )

    def figures(self) -> list[str]:
        """Return what stands beside a dial, what matters first."""
        known = self.true_deg is not None
        shown = f"{self.true_deg if known else self.magnetic_deg:05.1f} {'true' if known else 'magnetic'}"
        magnetic = [f"{self.magnetic_deg:05.1f} magnetic"] if known else []
        return [f"{shown} \u00b1{self.sigma_deg:.1f}", *magnetic, f"{self.time_s:.0f} s"]

    def document(self) -> dict[str, Any]:
        """Return the JSON form."""
        degrees = ("magnetic_deg", "true_deg", "grid_deg", "sigma_deg")
        told = {name: getattr(self, name) for name in degrees}
        rounded = {name: None if value is None else round(value, 3) for name, value in told.items()}
        return {"time_s": round(self.time_s, 4), **rounded}


@click.command()
@click.argument("source")
@click.option("--compass", "instance", type=Whole(1, 3), default=1, show_default=True, help="Which compass.")
@click.option("--two-axis", is_flag=True, help="Use X and Y only; Z comes from the Earth's field.")
@click.option("--json-lines", is_flag=True, help="One JSON object a line.")
@click.option("--rate", "rate_hz", type=Number(0.01, 400.0), help="Rows a second (live: 5, recording: all).")
@click.option("--duration", "duration_s", type=Number(0.0), help="End after this many seconds.")
@click.option(
    "--mcap",
    "mcap_file",
    type=FILE,
    help="Write a recording's fields, headings and verdicts to an MCAP file (ROS 2 messages), too.",
)
@system_option
@sign_key_option
@common_options
def command(
    source: str,
    instance: int,
    two_axis: bool,
    json_lines: bool,
    rate_hz: float | None,
    duration_s: float | None,
    mcap_file: Path | None,
    system: int | None,
    output: Output,
) -> int:
    """Stream the tilt-compensated heading with its uncertainty (1 sigma).

    Magnetic, and true by the World Magnetic Model where the vehicle knows its place, or by what the
    receiver's course or a second antenna shows on the way; it ends by saying which. The autopilot's own
    calibration is in force. A live stream ends with Ctrl-C; on a terminal it is a compass card.

    \b
    mavcompass heading udpin:0.0.0.0:14550
    mavcompass heading flight.tlog --json-lines --rate 1
    mavcompass heading flight.tlog --mcap flight.mcap --json heading.json
    """
    address = parse_address(source)
    require_for(address)
    notes: list[str] = []
    recorded = isinstance(address, Recording)
    if mcap_file is not None:
        _may_write(mcap_file, recorded)
    redrawn = not (recorded or json_lines or output.json_file == "-")
    if recorded:
        from mavcompass.api import read_track
        from mavcompass.heading.evidence import heading_of_track

        track = read_track(source)
        found = heading_of_track(track, None, instance, two_axis=two_axis)
        if mcap_file is not None:
            from mavcompass.report.bag import write_bag

            write_bag(track, mcap_file, {} if two_axis else {instance: found})
            click.echo(f"Written: {mcap_file}", err=True)
        rows = _recorded(track, instance, found, notes)
    else:
        # Where a person looks on, a simulated vehicle's time is theirs.
        speed = 1.0 if redrawn and is_live(sys.stdout) else None
        rate_hz = rate_hz or 5.0
        rows = _live(source, address, instance, two_axis, rate_hz, system, notes, speed)
    chosen = _limited(rows, rate_hz, duration_s)
    kept: list[dict[str, Any]] = []
    north = None
    with suppress(KeyboardInterrupt), dial(redrawn) as draw:  # Ctrl-C: the ordinary end of a live stream
        for row in chosen:
            north = row.north
            if json_lines:
                print(to_json(row.document()), flush=not recorded)
            elif draw is not None:
                draw(row.magnetic_deg if row.true_deg is None else row.true_deg, row.figures())
            elif output.json_file is None or (output.json_file != "-" and sys.stdout.isatty()):
                print(row.text(), flush=True)  # without a reader it ends
            if output.json_file is not None:
                kept.append(row.document())
    for note in notes:
        click.echo(f"Note: {note}", err=True)
    document: dict[str, Any] = {"schema": "mavcompass.heading/1", "source": source, "headings": kept}
    document["notes"] = notes
    if north is not None:
        click.echo(f"True north: {north.words()}.", err=True)
        document["true_north"] = north.to_json()
    output.write_json(document)
    return 0


def _may_write(path: Path, recorded: bool) -> None:
    """Refuse an MCAP file that cannot be written, before anything is read. Raises UsageError."""
    if not recorded:
        raise UsageError("--mcap needs a recording.", "Record the vehicle first; a .tlog will do.")
    if not path.absolute().parent.is_dir():
        raise UsageError(f"There is no folder {path.parent}.", "Make it, or name a file elsewhere.")
    require("A ROS 2 bag")


def _limited(rows: Iterator[Row], rate_hz: float | None, duration_s: float | None) -> Iterator[Row]:
    """Thin rows out to a rate and end them after a duration."""
    start_s, next_s = None, -math.inf
    for row in rows:
        start_s = row.time_s if start_s is None else start_s
        if duration_s is not None and row.time_s - start_s > duration_s:
            return
        if rate_hz is None or row.time_s >= next_s:
            next_s = max(next_s, row.time_s - 1e-9) + (1.0 / rate_hz if rate_hz else 0.0)
            yield row


def _recorded(track: Track, instance: int, found: HeadingResult, notes: list[str]) -> Iterator[Row]:
    import numpy as np

    from mavcompass.parameter_remarks import remarks_said

    notes += remarks_said(track.autopilot, track.parameters, instance)
    columns = (found.magnetic_rad, found.sigma_rad, found.true_rad, found.grid_rad)
    nothing = np.full(len(found.time_s), np.nan)
    degrees = [nothing if column is None else np.degrees(column) for column in columns]
    for row in np.stack([found.time_s, *degrees], axis=1).tolist():
        true, grid = (None if math.isnan(value) else value for value in row[3:])
        yield Row(row[0], row[1], row[2], true, grid, found.north)


def _live(
    source: str,
    address: Address,
    instance: int,
    two_axis: bool,
    rate_hz: float,
    system: int | None,
    notes: list[str],
    speed: float | None,
) -> Iterator[Row]:
    from mavcompass.vehicle.heading_stream import headings
    from mavcompass.vehicle.opening import open_link

    if two_axis and instance != 1:
        raise UsageError("--two-axis works on compass 1 of a live vehicle.", "Leave --compass away.")
    with open_link(address, speed=speed) as link:
        stream = headings(
            link,
            source,
            instance,
            two_axis=two_axis,
            rate_hz=max(rate_hz, 10.0),
            system=system,
            on_notes=notes.extend,
        )
        yield from map(Row.of, stream)
