"""ArduPilot's simulator (SITL): one program per kind of vehicle, set up by a file of parameters."""

from __future__ import annotations

import socket
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path

from mavcompass.errors import UsageError
from mavcompass.installation.data_files import params_path
from mavcompass.vehicle.parameters.files import read_parameter_file
from mavcompass.vehicle.simulators.program import RunningProgram, help_of

_OPTIONS = ("--home", "--model", "--defaults", "--speedup", "--serial0")
# Where nobody says where: the field that ArduPilot's own trials use.
_SOMEWHERE = (-35.363262, 149.165237, 584.0)
_PARAMETERS_FILE = "flight.parm"
# Of the vehicle's own calibration: what the readings that it reports were made with.
_CALIBRATION = ("OFS", "DIA", "ODI", "MOT", "SCALE")


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

    def model_for(self, kind: str, pivots: bool) -> str:
        """Return the simulator's model of a vehicle."""
        if self.model:
            return self.model
        return {"copter": "quad", "boat": "motorboat"}.get(kind) or ("rover-skid" if pivots else "rover")

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
        kind: str,
        pivots: bool,
        home: tuple[float, float, float] | None,
        heading_deg: float,
        parameters: Mapping[str, float],
        port: int,
    ) -> RunningProgram:
        """Start it in `folder`; it will connect to `port` of this computer by TCP and listen to nobody.

        Raises UsageError where it cannot be started.
        """
        model = self.model_for(kind, pivots)
        file = folder / _PARAMETERS_FILE
        lines = [f"{name} {value:.9g}" for name, value in self.parameters_for(model, parameters).items()]
        file.write_text("\n".join(lines) + "\n", encoding="utf-8")
        lat, lon, alt = _SOMEWHERE if home is None else home
        command: list[str | Path] = [
            self.program.absolute(), "--wipe", "--model", model,
            "--home", f"{lat:.8f},{lon:.8f},{alt:.2f},{heading_deg:.2f}",
            "--defaults", file.absolute(), "--speedup", f"{self.speed:g}",
            "--rc-in-port", str(_free_udp_port()),
            "--serial0", f"tcpclient:127.0.0.1:{port}", "--serial1", "none:x", "--serial2", "none:x",
        ]  # fmt: skip
        return RunningProgram(command, folder)


def calibration_in(parameters: Mapping[str, float]) -> dict[str, float]:
    """Pick a vehicle's calibration of compass 1: a simulator that has its iron needs its cure as well."""
    out = {}
    for name, value in parameters.items():
        words = name.split("_")
        if words[0] == "COMPASS" and len(words) in (2, 3) and words[1] in _CALIBRATION:
            out[name] = value
    if "COMPASS_MOTCT" in parameters:
        out["COMPASS_MOTCT"] = parameters["COMPASS_MOTCT"]
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
