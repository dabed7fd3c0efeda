"""`mavcompass doctor`: what on this computer stands in the way; and `mavcompass` alone: who is there."""

from __future__ import annotations

import errno
import grp
import os
import platform
import shutil
import socket
import sys
import time
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Literal

import click

from mavcompass.cli.options import Output, common_options
from mavcompass.cli.terminal.lines import mark, styled
from mavcompass.installation.invocation import program

if TYPE_CHECKING:
    from mavcompass.procedure.vehicle_state import VehicleIdentity

Verdict = Literal["pass", "warn", "fail"]
NOT_FIT = 5
_WORDS = {
    "pass": "Ready.",
    "warn": "Usable, as far as said above.",
    "fail": "First mend what is marked FAIL.",
}
GROUND_STATION_PORT = 14_550
_LEAST_PYTHON = (3, 11)
_PORTS = ("ttyACM*", "ttyUSB*", "ttyAMA*", "ttyTHS*", "cu.usb*")
_NEEDED_MB, _COMFORTABLE_MB = 50, 500  # a flight's recording and report; many of them


@dataclass(frozen=True, slots=True)
class Finding:
    """Hold one answer: what was looked at, how it is, and what to do about it."""

    name: str
    verdict: Verdict
    text: str
    remedy: str = ""


@click.command()
@common_options
def command(output: Output) -> int:
    """Say what on this computer stands in the way of working with a vehicle, and how to mend it.

    It looks at Python, optional parts, serial ports and the right to open them, who listens on UDP port
    14550, the clock, the undo folder and the disk. It changes nothing. Exit code: 0, or 5 where something
    has to be mended first.

    \b
    Example: mavcompass doctor
    """
    findings = []
    for finding in examine():
        findings.append(finding)
        output.say(f"{mark(finding.verdict)}  {finding.text}")
        if finding.remedy:
            output.say(f"      {finding.remedy}")
    verdicts = {finding.verdict for finding in findings}
    worst: Verdict = "fail" if "fail" in verdicts else "warn" if "warn" in verdicts else "pass"
    output.say(styled(_WORDS[worst], bold=True))
    rows = [{"name": f.name, "verdict": f.verdict, "text": f.text, "remedy": f.remedy} for f in findings]
    output.write_json({"schema": "mavcompass.doctor/1", "verdict": worst, "findings": rows})
    return NOT_FIT if worst == "fail" else 0


def examine() -> Iterator[Finding]:
    """Look at everything, the quick and the general first."""
    from mavcompass.vehicle.parameters.undo import undo_directory

    yield python()
    yield from parts()
    yield from serial_ports()
    yield udp_port()
    yield clock(time.time())
    yield writing(undo_directory())
    yield space(undo_directory())


def python() -> Finding:
    """Tell the Python that runs this."""
    version = platform.python_version()
    text = f"Python {version} at {sys.executable}, {platform.system()} {platform.machine()}"
    if sys.version_info < _LEAST_PYTHON:
        return Finding("python", "fail", text, "Install Python 3.11 or newer.")
    return Finding("python", "pass", text)


def parts() -> Iterator[Finding]:
    """Tell which parts of the program are not installed."""
    from mavcompass.installation.invocation import pip_install
    from mavcompass.installation.parts import PARTS, missing

    lacking = [part for part in PARTS.values() if missing(part)]
    for extra in dict.fromkeys(part.extra for part in lacking):
        of_extra = [part for part in lacking if part.extra == extra]
        needs = ", ".join(part.need[0].lower() + part.need[1:] for part in of_extra)
        modules = ", ".join(module for part in of_extra for module in missing(part))
        text = f"Not possible here: {needs} ({modules} not installed)."
        yield Finding("parts", "warn", text, pip_install(f"mavcompass[{extra}]"))
    if not lacking:
        yield Finding("parts", "pass", f"All {len(PARTS)} optional parts are installed.")


def ports_of(devices: Path = Path("/dev")) -> list[Path]:
    """List the serial ports that an autopilot may be at."""
    return sorted(port for pattern in _PORTS for port in devices.glob(pattern))


def serial_ports(devices: Path = Path("/dev"), processes: Path = Path("/proc")) -> Iterator[Finding]:
    """Tell each serial port, whether this user may open it, and which program has it open."""
    ports = ports_of(devices)
    if not ports:
        yield Finding("serial", "pass", "No serial port is there; plug the autopilot in to use one.")
    for port in ports:
        if not os.access(port, os.R_OK | os.W_OK):
            group = _group_of(port)
            yield Finding(
                "serial",
                "warn",
                f"{port}: this user may not open it; it belongs to the group {group}.",
                f"sudo usermod -aG {group} $USER, then log out and in again.",
            )
        elif holder := _holding(str(port), processes):
            yield Finding("serial", "warn", f"{port}: {holder} has it open.", "End that program first.")
        else:
            yield Finding("serial", "pass", f"{port}: free and ready.")


def udp_port(port: int = GROUND_STATION_PORT, processes: Path = Path("/proc")) -> Finding:
    """Tell who listens already where vehicles usually send to."""
    try:
        with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe:
            probe.bind(("0.0.0.0", port))
    except OSError as error:
        if error.errno != errno.EADDRINUSE:
            return Finding("udp", "warn", f"UDP port {port} cannot be opened: {error.strerror}.")
        holder = _listening(port, processes) or "another program"
        return Finding(
            "udp",
            "warn",
            f"UDP port {port}: {holder} listens there.",
            f"End it, or let it forward to another port and use that: udpin:127.0.0.1:{port + 1}.",
        )
    return Finding("udp", "pass", f"UDP port {port} is free.")


def clock(unix_s: float) -> Finding:
    """Tell whether the computer knows the year: the Earth's field is of a day."""
    from mavcompass.earth_field import MODEL_YEARS, decimal_year

    first, last = MODEL_YEARS
    day = time.strftime("%Y-%m-%d %H:%M UTC", time.gmtime(unix_s))
    year = decimal_year(unix_s)
    if year < first:
        text = f"The clock says {day}, which cannot be: the Earth's field would be of the wrong year."
        return Finding("clock", "fail", text, "sudo timedatectl set-ntp true, or set it: sudo date -s '...'.")
    if year >= last:
        text = f"The clock says {day}; the World Magnetic Model in here ends with {last:.0f}."
        return Finding("clock", "warn", text, "Set the clock if it is wrong, else update mavcompass.")
    return Finding("clock", "pass", f"The clock says {day}.")


def writing(folder: Path) -> Finding:
    """Tell whether an undo file can be written: without one, nothing is written to a vehicle."""
    there = _nearest(folder)
    if there.is_dir() and os.access(there, os.W_OK | os.X_OK):
        return Finding("undo", "pass", f"Undo files go to {folder}.")
    return Finding(
        "undo",
        "fail",
        f"Undo files cannot be written to {folder}, so nothing would be written to a vehicle.",
        "Make that folder writable, or name another: export MAVCOMPASS_UNDO_DIR=FOLDER.",
    )


def space(folder: Path) -> Finding:
    """Tell the room left where undo files, recordings and reports go."""
    free_mb = shutil.disk_usage(_nearest(folder)).free / 1e6
    text = f"{free_mb / 1e3:.1f} GB are free." if free_mb >= 1e3 else f"Only {free_mb:.0f} MB are free."
    verdict: Verdict = "fail" if free_mb < _NEEDED_MB else "warn" if free_mb < _COMFORTABLE_MB else "pass"
    remedy = "" if verdict == "pass" else "Make room: old recordings, or sudo apt clean."
    return Finding("disk", verdict, text, remedy)


def _nearest(folder: Path) -> Path:
    """Return the folder, or the nearest of its parents that is there."""
    return next((path for path in (folder, *folder.absolute().parents) if path.exists()), Path("/"))


def _group_of(port: Path) -> str:
    try:
        return grp.getgrgid(port.stat().st_gid).gr_name
    except (KeyError, OSError):
        return "dialout"


def _listening(port: int, processes: Path) -> str:
    """Name the program whose socket is bound to a UDP port, where the system tells (Linux)."""
    for table in ("net/udp", "net/udp6"):
        try:
            lines = (processes / table).read_text().splitlines()[1:]
        except OSError:
            continue
        for fields in map(str.split, lines):
            if int(fields[1].rpartition(":")[2], 16) == port and (
                holder := _holding(f"socket:[{fields[9]}]", processes)
            ):
                return holder
    return ""


def _holding(target: str, processes: Path) -> str:
    """Name the program that has a file or a socket open; other users' programs are seen by root only."""
    for link in processes.glob("[0-9]*/fd/*"):
        try:
            if os.readlink(link) == target:
                process = link.parents[1]
                return f"{(process / 'comm').read_text().strip()} (process {process.name})"
        except OSError:
            continue  # it ended meanwhile, or is not ours to see
    return ""


# --- mavcompass alone: who is there ----------------------------------------------------------------------

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
