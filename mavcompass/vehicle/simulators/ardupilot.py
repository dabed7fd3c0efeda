"""ArduPilot's simulator (SITL): one program per kind of vehicle, set up by a file of parameters."""

from __future__ import annotations

import re
import socket
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path

from mavcompass.errors import UsageError
from mavcompass.installation.parts import params_path
from mavcompass.vehicle.parameters.files import read_parameter_file
from mavcompass.vehicle.simulators.program import Flight, RunningProgram, help_of
from mavcompass.vehicle.transport import Transport
from mavcompass.vehicle.transport.tcp import TcpServerTransport

_OPTIONS = ("--home", "--model", "--defaults", "--speedup", "--serial0")
# Where nobody says where: the field that ArduPilot's own trials use.
_SOMEWHERE = (-35.363262, 149.165237, 584.0)
_PARAMETERS_FILE = "flight.parm"
# Of the vehicle's own calibration: what the readings that it reports were made with.
_CALIBRATION = re.compile(r"COMPASS_((OFS|DIA|ODI|MOT)_[XYZ]|SCALE|MOTCT)")


@dataclass(frozen=True, slots=True)
class ArduPilotSitl:
    """Start a program of ArduPilot's simulator.

    Attributes:
        program: its file. model: what `--model` is to say; "" for what goes with the motion.
        known: parameters of the vehicle as far as it is known.
        defaults: files of parameters that a person wants above these and below what is to be tried.
        speed: 2 is twice real time.
    """

    program: Path
    model: str = ""
    known: Mapping[str, float] = field(default_factory=dict)
    defaults: Sequence[Path] = ()
    speed: float = 8.0

    target = "ardupilot-sitl"

    def check(self) -> None:
        """Raise UsageError where the program cannot be run or is no such simulator, or a file is none."""
        said = help_of(self.program)
        if not all(option in said for option in _OPTIONS):
            raise UsageError(
                f"{self.program} is not ArduPilot's simulator: its --help does not name"
                f" {', '.join(option for option in _OPTIONS if option not in said)}.",
                "Build it with `./waf configure --board sitl && ./waf rover copter` and give --sitl"
                " build/sitl/bin/ardurover or arducopter.",
            )
        for file in self.defaults:
            read_parameter_file(file)

    def listen(self) -> Transport:
        """Open the port to which it will connect: any that is free."""
        return TcpServerTransport("127.0.0.1", 0)

    def live(self, parameters: Mapping[str, float]) -> dict[str, float]:
        """Return what is to be set over the link once it runs: nothing, it starts with its parameters."""
        return {}

    def model_for(self, flight: Flight) -> str:
        """Return the simulator's model of a vehicle."""
        if self.model:
            return self.model
        models = {"copter": "quad", "boat": "motorboat", "rover": "rover-skid" if flight.pivots else "rover"}
        return models[flight.kind]

    def parameters_for(self, model: str, over: Mapping[str, float]) -> dict[str, float]:
        """Return all parameters: of every flight, of its model, the vehicle's, the person's, `over`."""
        own = {"quad": "copter", "rover-skid": "rover-skid", "motorboat": "rover-skid"}.get(model, "rover")
        out = read_parameter_file(params_path("sitl-flight/common.parm"))
        out |= read_parameter_file(params_path(f"sitl-flight/{own}.parm")) | dict(self.known)
        for file in self.defaults:
            out |= read_parameter_file(file)
        return out | dict(over)

    def start(
        self,
        folder: Path,
        flight: Flight,
        parameters: Mapping[str, float],
        port: Transport,
    ) -> RunningProgram:
        """Start it in `folder`; it connects to `port` of this computer. Raises UsageError where it cannot."""
        model = self.model_for(flight)
        file = folder / _PARAMETERS_FILE
        lines = [f"{name} {value:.9g}" for name, value in self.parameters_for(model, parameters).items()]
        file.write_text("\n".join(lines) + "\n", encoding="utf-8")
        lat, lon, alt = _SOMEWHERE if flight.home is None else flight.home
        command: list[str | Path] = [
            self.program.absolute(), "--wipe", "--model", model,
            "--home", f"{lat:.8f},{lon:.8f},{alt:.2f},{flight.heading_deg:.2f}",
            "--defaults", file.absolute(), "--speedup", f"{self.speed:g}",
            "--rc-in-port", str(_free_udp_port()),
            "--serial0", f"tcpclient:{port.name.removeprefix('tcpin:')}",
            "--serial1", "none:x", "--serial2", "none:x",
        ]  # fmt: skip
        return RunningProgram(command, folder)

    @staticmethod
    def calibration_in(parameters: Mapping[str, float]) -> dict[str, float]:
        """Pick a vehicle's calibration of compass 1: a simulator that has its iron needs its cure as well."""
        out = {name: value for name, value in parameters.items() if _CALIBRATION.fullmatch(name)}
        offsets = [name for name in out if name.startswith("COMPASS_OFS_")]
        if offsets and not any(out[name] for name in offsets):
            # All zero the simulator would take for not calibrated, and copy its own iron there.
            out[offsets[0]] = 0.001
        return out


def _free_udp_port() -> int:
    """Return a port for the remote control, which nobody uses here: its usual one may be taken."""
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as port:
        port.bind(("", 0))
        return int(port.getsockname()[1])
