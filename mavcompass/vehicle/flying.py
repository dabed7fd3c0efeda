"""Fly a recording's motion in a simulator of this computer, and keep what it tells, frame by frame."""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Mapping
from contextlib import closing
from pathlib import Path

from mavcompass.errors import LinkError, UsageError
from mavcompass.messages import Attitude, Heartbeat, ParamValue, message_id
from mavcompass.procedure.flying import Profile, fly_profile
from mavcompass.procedure.script import Machine, Show
from mavcompass.vehicle.driver import run
from mavcompass.vehicle.link import GROUND_STATION
from mavcompass.vehicle.links.wire import WireLink
from mavcompass.vehicle.simulators import ArduPilotSitl, Flight, Px4Sih, RunningProgram
from mavcompass.vehicle.transport import Transport
from mavcompass.vehicle.wire import Frame

Record = Callable[[int, bytes], None]
_CONNECTS_S = 30.0
# A simulator of a busy computer may pause.
_SILENCE_S = 15.0


class _Recorder:
    """Keep frames with the vehicle's time: from the flight's begin on, and all parameters before."""

    def __init__(self, record: Record, utc_s: float) -> None:
        self._record = record
        self._utc_s = utc_s
        self._boot_s = 0.0
        self._before: dict[bytes, bytes] = {}
        self._on = False

    def switch(self, on: bool) -> None:
        """Begin, with the parameters that were told before, or end."""
        self._on = on
        if on:
            for frame in self._before.values():
                self._keep(frame)

    def hear(self, frame: Frame) -> None:
        """Take a frame."""
        if frame.message_id == message_id(Attitude):
            self._boot_s = max(self._boot_s, int.from_bytes(frame.payload[:4], "little") / 1000.0)
        if self._on:
            self._keep(frame.raw)
        elif frame.message_id == message_id(Heartbeat):
            self._before[b""] = frame.raw
        elif frame.message_id == message_id(ParamValue):
            self._before[frame.payload[8:24]] = frame.raw

    def _keep(self, raw: bytes) -> None:
        self._record(round((self._utc_s + self._boot_s) * 1e6), raw)


def fly_in_simulator(
    simulator: ArduPilotSitl | Px4Sih,
    profile: Profile,
    parameters: Mapping[str, float],
    folder: Path,
    record: Record,
    on_show: Callable[[Show], None] | None = None,
) -> None:
    """Start a simulator in `folder` with these parameters, fly a profile, stop the simulator.

    `record` gets the Unix time, in microseconds of the vehicle's own clock, and the bytes of every frame of
    the flight. Raises UsageError or LinkError where the simulator does not start or stays silent, Refused
    where it does not fly.
    """
    transport = simulator.listen()
    with closing(WireLink(transport, GROUND_STATION)) as link:
        recorder = _Recorder(record, time.time() if profile.utc_s is None else profile.utc_s)
        link.on_frame = recorder.hear
        heading_deg = math.degrees(float(profile.yaw_rad[0])) % 360.0
        flight = Flight(profile.kind, profile.pivots, profile.home, heading_deg)
        with simulator.start(folder, flight, parameters, transport) as program:
            _wait_for(transport, program)
            machine = Machine(
                lambda context: fly_profile(context, profile, recorder.switch, simulator.live(parameters))
            )
            try:
                run(machine, link, on_show=on_show, silence_s=_SILENCE_S)
            except LinkError as error:
                if program.has_ended:
                    raise _ended(program) from error
                raise


def _wait_for(transport: Transport, program: RunningProgram) -> None:
    """Wait until the simulator connects."""
    give_up_s = time.monotonic() + _CONNECTS_S
    while not transport.peers():
        transport.wait(0.1)
        transport.read()
        if program.has_ended:
            raise _ended(program)
        if time.monotonic() > give_up_s:
            raise UsageError(
                f"The simulator did not connect within {_CONNECTS_S:.0f} s.",
                f"It said: {program.last_words() or 'nothing'}.",
            )


def _ended(program: RunningProgram) -> UsageError:
    return UsageError(
        f"The simulator ended by itself. It said: {program.last_words() or 'nothing'}.",
        "See whether --model and --defaults go with the program.",
    )
