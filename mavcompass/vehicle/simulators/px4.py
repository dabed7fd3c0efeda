"""PX4's own simulator (SIH): the firmware as a program, a quadrotor in it, set up over the link."""

from __future__ import annotations

import fcntl
import os
import re
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

from mavcompass.errors import UsageError
from mavcompass.vehicle.parameters.files import read_parameter_file
from mavcompass.vehicle.simulators.program import Flight, RunningProgram, help_of
from mavcompass.vehicle.transport import Transport
from mavcompass.vehicle.transport.udp import UdpTransport

_STARTUP = "etc/init.d-posix/rcS"
_FIRST_PORT, _INSTANCES, _LOCK = 14540, 10, "/tmp/px4_lock-{}"
_QUADROTOR = {"PX4_SIM_MODEL": "sihsim_quadx", "PX4_SYS_AUTOSTART": "10040"}
# What is wrong with the compass shall stay: on the ground PX4 learns its bias in seconds and takes it off.
_FLIGHT: dict[str, float] = {"MBE_LEARN_GAIN": 0.1, "SENS_MAG_AUTOCAL": 0}
# Of the vehicle's own calibration. Whole numbers (device, rotation) are the simulator's own.
_CALIBRATION = re.compile(r"CAL_MAG0_[XYZ](OFF|SCALE|ODIAG|COMP)")


@dataclass(frozen=True, slots=True)
class Px4Sih:
    """Start PX4's SIH simulator.

    Attributes:
        program: its file, `px4`; its folder `etc` stands in the same build.
        known: parameters of the vehicle as far as it is known.
        defaults: files of parameters that a person wants above these.
        speed: 2 is twice real time.
    """

    program: Path
    known: Mapping[str, float]
    defaults: tuple[Path, ...] = ()
    speed: float = 4.0

    target = "px4-sitl"
    model = "sihsim_quadx"

    def check(self) -> None:
        """Raise UsageError where the program cannot be run, is not PX4, or its files are missing."""
        if "startup_file" not in help_of(self.program):
            raise UsageError(
                f"{self.program} is not PX4's simulator.",
                "Build it with `make px4_sitl sihsim_quadx` and give --sitl build/px4_sitl_default/bin/px4.",
            )
        self._etc()
        for file in self.defaults:
            read_parameter_file(file)

    def listen(self) -> Transport:
        """Open the port to which an instance will send, the first one that does not run yet."""
        for instance in range(_INSTANCES):
            if _runs(instance):
                continue
            try:
                return UdpTransport.listening("127.0.0.1", _FIRST_PORT + instance)
            except UsageError:
                continue
        raise UsageError(
            f"The ports {_FIRST_PORT} to {_FIRST_PORT + _INSTANCES - 1}, to which PX4 sends, are all taken.",
            "End one of the programs that use them.",
        )

    def live(self, parameters: Mapping[str, float]) -> dict[str, float]:
        """Return what is to be set over the link once it runs: all of it."""
        out = _FLIGHT | dict(self.known)
        for file in self.defaults:
            out |= read_parameter_file(file)
        return out | dict(parameters)

    def start(
        self, folder: Path, flight: Flight, parameters: Mapping[str, float], port: Transport
    ) -> RunningProgram:
        """Start it in `folder`; it sends to `port` of this computer. Raises UsageError where it cannot."""
        if flight.kind != "copter":
            raise UsageError(
                f"PX4's simulator is started here as a copter; the recording is of a {flight.kind}.",
                "Give a copter's recording, or fly the simulator by hand and use `mavcompass gap compare`.",
            )
        instance = int(port.name.rpartition(":")[2]) - _FIRST_PORT
        environment = {**os.environ, **_QUADROTOR, "PX4_SIM_SPEED_FACTOR": f"{self.speed:g}"}
        if flight.home is not None:
            names = ("PX4_HOME_LAT", "PX4_HOME_LON", "PX4_HOME_ALT")
            environment |= {name: f"{value:.8f}" for name, value in zip(names, flight.home, strict=True)}
        command: list[str | Path] = [
            self.program.absolute(), "-d", "-i", str(instance), "-w", folder.absolute(), "-s", _STARTUP,
            self._etc(),
        ]  # fmt: skip
        return RunningProgram(command, folder, environment)

    def _etc(self) -> Path:
        for folder in (self.program.absolute().parents[1], self.program.absolute().parent):
            if (folder / _STARTUP).is_file():
                return folder / "etc"
        raise UsageError(
            f"PX4's files ({_STARTUP}) are not in the build of {self.program}.",
            "Give the program in its build folder, such as build/px4_sitl_default/bin/px4.",
        )

    @staticmethod
    def calibration_in(parameters: Mapping[str, float]) -> dict[str, float]:
        """Pick a vehicle's calibration of compass 1: a simulator that has its iron needs its cure as well."""
        return {name: value for name, value in parameters.items() if _CALIBRATION.fullmatch(name)}


def _runs(instance: int) -> bool:
    """Tell whether an instance of PX4 runs on this computer: it holds a lock as long as it does."""
    try:
        with Path(_LOCK.format(instance)).open("r+b") as lock:
            fcntl.lockf(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except BlockingIOError:
        return True
    except OSError:  # it has never run here
        return False
    return False
