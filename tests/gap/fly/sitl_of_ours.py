"""A program with the options of ArduPilot's simulator, in which the embedded firmware flies.

It has the dialogue of the real one: `--help`, a file of parameters, a connection to the port of `--serial0`.
SIM_MAG1_OFS and SIM_MAG1_DIA are the iron of its first compass; with SIM_TEST_DIES it ends at once. On a busy
computer its time waits for whoever steers it, so that the flight is the same however fast it is.
"""

from __future__ import annotations

import argparse
import math
import os
import sys
from pathlib import Path

from mavcompass.compass_parameters import ardupilot_correction
from mavcompass.correction import IDENTITY, FieldCorrection
from mavcompass.errors import LinkLost
from mavcompass.messages import Message, SetPositionTargetLocalNed
from mavcompass.simulation.autopilot.board import Outgoing
from mavcompass.simulation.physics.sensors import CompassModel, CompassSetup
from mavcompass.simulation.vehicle import SimulatedAutopilot
from mavcompass.vehicle.links.server import VehicleServer
from mavcompass.vehicle.parameters.files import read_parameter_file
from mavcompass.vehicle.stopping import StopRequest
from mavcompass.vehicle.transport import Reconnect, Tcp, open_transport

AHEAD_S = 0.25
VEHICLES = {"rover": "ackermann-rover", "rover-skid": "rover", "quad": "copter"}


def iron(values: dict[str, float]) -> FieldCorrection:
    """Return what would cure the compass's iron, in the form in which the simulator is told of it."""
    return FieldCorrection(
        tuple(values.get(f"SIM_MAG1_OFS_{axis}", 0.0) for axis in "XYZ"),  # type: ignore[arg-type]
        tuple(values.get(f"SIM_MAG1_DIA_{axis}", 1.0) for axis in "XYZ"),  # type: ignore[arg-type]
    )


class PatientVehicle(SimulatedAutopilot):
    """Be a vehicle whose time never runs far ahead of its last target."""

    _steered_s = math.inf

    def receive(self, message: Message, system: int, component: int, port: int = 0) -> None:
        if isinstance(message, SetPositionTargetLocalNed):
            self._steered_s = message.time_boot_ms / 1000.0  # of the attitude that it answers
        super().receive(message, system, component, port)

    def advance(self, until_s: float) -> list[Outgoing]:
        return super().advance(min(until_s, max(self._steered_s + AHEAD_S, self.time_s)))


def main() -> None:
    options = argparse.ArgumentParser()
    options.add_argument("--wipe", action="store_true")
    for name in ("model", "home", "defaults", "speedup", "rc-in-port", "serial0", "serial1", "serial2"):
        options.add_argument(f"--{name}")
    told = options.parse_args()
    values = read_parameter_file(Path(told.defaults))
    if "SIM_TEST_DIES" in values:
        sys.exit("panic: no such frame")
    lat, lon, alt, heading = map(float, told.home.split(","))
    plain = CompassSetup(CompassModel(IDENTITY, 2.0), IDENTITY)
    first = CompassSetup(CompassModel(iron(values), 2.0), ardupilot_correction(values, 1))
    vehicle = PatientVehicle(
        VEHICLES[told.model],
        seed=5,
        parameters={name: value for name, value in values.items() if not name.startswith("SIM_")},
        compasses=(first, plain, plain),
        place=(lat, lon, alt),
        start_yaw_deg=heading,
        armed=False,
        ready_s=2.0,
    )
    Path("pid").write_text(str(os.getpid()))
    kind, host, port = told.serial0.split(":")
    assert kind == "tcpclient"
    transport = open_transport(Tcp(host, int(port)), Reconnect(again_s=0.0))
    try:
        VehicleServer(vehicle, transport, speed=float(told.speedup)).serve(StopRequest())
    except LinkLost:
        pass


main()
