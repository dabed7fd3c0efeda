"""A vehicle that has parameters and nothing else, and a bad radio to talk to it, in virtual time.

It answers as the firmware does: three echoes to the write of an `_X`, silence to unknown names, NaN
ignored, 32-bit floats; as PX4, one echo each and integers bit for bit.
"""

from __future__ import annotations

import heapq
import itertools
import math
import random
import struct
from collections.abc import Callable
from typing import Any

import numpy as np

from mavcompass.enums import MavAutopilot, MavCmd, MavResult, MavType
from mavcompass.messages import (
    CommandAck,
    CommandLong,
    Heartbeat,
    Incoming,
    Message,
    ParamRequestRead,
    ParamSet,
    ParamValue,
    Statustext,
)
from mavcompass.procedure.script import Context, Machine, Script, Send, Show, Stop, Tick

REAL32, INT32 = 9, 6
SYSTEM, COMPONENT = 7, 1


def ardupilot_parameters(**changes: float) -> dict[str, float]:
    """Return the compass parameters of a calibrated vehicle with two compasses and room for a third."""
    values = {
        "COMPASS_ENABLE": 1.0,
        "COMPASS_AUTODEC": 1.0,
        "COMPASS_DEC": 0.2233572,
        "COMPASS_LEARN": 0.0,
        "COMPASS_MOTCT": 0.0,
        "COMPASS_OFFS_MAX": 1800.0,
        "COMPASS_PRIO1_ID": 97539.0,
        "COMPASS_PRIO2_ID": 131874.0,
        "COMPASS_PRIO3_ID": 0.0,
        "CUST_ROT_ENABLE": 0.0,
    }
    values |= {f"CUST_ROT{n}_{angle}": 0.0 for n in (1, 2) for angle in ("ROLL", "PITCH", "YAW")}
    for number, device in (("", 97539.0), ("2", 131874.0), ("3", 0.0)):
        for axis, offset in zip("XYZ", (5.0, 13.0, -18.0), strict=True):
            values[f"COMPASS_OFS{number}_{axis}"] = offset
            values[f"COMPASS_DIA{number}_{axis}"] = 1.0
            values[f"COMPASS_ODI{number}_{axis}"] = 0.0
            values[f"COMPASS_MOT{number}_{axis}"] = 0.0
        values |= {
            f"COMPASS_SCALE{number}": 1.0,
            f"COMPASS_USE{number}": 1.0,
            f"COMPASS_ORIENT{number}": 0.0,
            f"COMPASS_DEV_ID{number}": device,
            "COMPASS_EXTERNAL" if not number else f"COMPASS_EXTERN{number}": 0.0,
        }
    return values | changes


def px4_parameters(**changes: float) -> dict[str, float]:
    """Return the compass parameters of a PX4 vehicle with two of four slots in use."""
    values = {"CAL_MAG_COMP_TYP": 0.0, "SENS_BOARD_ROT": 0.0, "SYS_HAS_MAG": 1.0}
    for n, device in enumerate((396809.0, 396825.0, 0.0, 0.0)):
        values |= {f"CAL_MAG{n}_ID": device, f"CAL_MAG{n}_PRIO": 50.0, f"CAL_MAG{n}_ROT": -1.0}
        for axis, offset in zip("XYZ", (0.02, -0.13, 0.07), strict=True):
            values[f"CAL_MAG{n}_{axis}OFF"] = offset
            values[f"CAL_MAG{n}_{axis}SCALE"] = 1.0
            values[f"CAL_MAG{n}_{axis}ODIAG"] = 0.0
            values[f"CAL_MAG{n}_{axis}COMP"] = 0.0
        values |= {f"CAL_MAG{n}_{angle}": 0.0 for angle in ("ROLL", "PITCH", "YAW")}
    return values | changes


def single(value: float) -> float:
    return float(np.float32(value))


class ParameterVehicle:
    """Hold parameters; `handle` takes a message and returns the answers."""

    autopilot = MavAutopilot.ARDUPILOTMEGA

    def __init__(self, values: dict[str, float] | None = None) -> None:
        values = ardupilot_parameters() if values is None else values
        self.values = {name: single(value) for name, value in values.items()}
        self.writes: list[str] = []
        self.commands: list[CommandLong] = []
        self.stuck: set[str] = set()  # written, echoed with the old value
        self.deaf: set[str] = set()  # never answered
        self.known_commands = {MavCmd.PREFLIGHT_SET_SENSOR_OFFSETS, MavCmd.RUN_PREARM_CHECKS}
        self.armed = False
        self.stored_ids = {1, 2, 3}  # compasses whose device id is in the storage
        self.mute = False

    def heartbeat(self) -> Heartbeat:
        return Heartbeat(MavType.GROUND_ROVER, self.autopilot, 128 if self.armed else 0)

    def handle(self, message: Message) -> list[Message]:
        if self.mute:
            return []
        match message:
            case ParamRequestRead(param_id=name):
                return [self.value(name)] if name in self.values and name not in self.deaf else []
            case ParamSet(param_id=name):
                return self.set(message)
            case CommandLong():
                return self.command(message)
        return []

    def value(self, name: str) -> ParamValue:
        return ParamValue(name, self.values[name], REAL32, len(self.values), 65535)

    def set(self, message: ParamSet) -> list[Message]:
        name = message.param_id
        self.writes.append(name)
        if name not in self.values or name in self.deaf or not math.isfinite(message.param_value):
            return []
        if name not in self.stuck:
            self.values[name] = single(message.param_value)
        if name.endswith("_X"):
            return [self.value(name[:-1] + axis) for axis in "XYZ"]
        return [self.value(name)]

    def command(self, message: CommandLong) -> list[Message]:
        self.commands.append(message)
        if message.command not in self.known_commands:
            return [CommandAck(message.command, MavResult.UNSUPPORTED)]
        texts: list[Message] = []
        match message.command:
            case MavCmd.PREFLIGHT_SET_SENSOR_OFFSETS:
                instance = {2: 1, 5: 2, 6: 3}[int(message.param1)]
                number = "" if instance == 1 else str(instance)
                xyz = (message.param2, message.param3, message.param4)
                for axis, offset in zip("XYZ", xyz, strict=True):
                    self.values[f"COMPASS_OFS{number}_{axis}"] = single(offset)
                self.stored_ids.add(instance)
            case MavCmd.PREFLIGHT_CALIBRATION:
                assert message.param2 == 76.0
                self.stored_ids = {1, 2, 3}
            case MavCmd.RUN_PREARM_CHECKS:
                if self.armed:
                    return [CommandAck(message.command, MavResult.TEMPORARILY_REJECTED)]
                if not self.calibrated():
                    texts.append(Statustext(2, "PreArm: Compass not calibrated"))
        return [CommandAck(message.command, MavResult.ACCEPTED), *texts]

    def calibrated(self) -> bool:
        return all(
            any(self.values[f"COMPASS_OFS{n}_{axis}"] for axis in "XYZ") and instance in self.stored_ids
            for instance, n in ((1, ""), (2, "2"))
        )


class PX4Vehicle(ParameterVehicle):
    """Hold PX4's parameters: integers travel as their four bytes."""

    autopilot = MavAutopilot.PX4
    integers = ("_ID", "_PRIO", "_ROT", "_TYP", "_MAG")

    def __init__(self, values: dict[str, float] | None = None) -> None:
        super().__init__(px4_parameters() if values is None else values)

    def is_integer(self, name: str) -> bool:
        return name.endswith(self.integers)

    def value(self, name: str) -> ParamValue:
        if not self.is_integer(name):
            return ParamValue(name, self.values[name], REAL32, len(self.values), 0)
        (bits,) = struct.unpack("<f", struct.pack("<i", int(self.values[name])))
        return ParamValue(name, bits, INT32, len(self.values), 0)

    def set(self, message: ParamSet) -> list[Message]:
        name = message.param_id
        self.writes.append(name)
        if name not in self.values:
            return []
        if self.is_integer(name):
            assert message.param_type == INT32, "PX4 rejects a write of another type"
            self.values[name] = float(struct.unpack("<i", struct.pack("<f", message.param_value))[0])
        else:
            self.values[name] = single(message.param_value)
        return [self.value(name)]


class Radio:
    """Carry messages between a script and a vehicle, losing, doubling and delaying them by seed."""

    def __init__(
        self,
        vehicle: ParameterVehicle,
        *,
        seed: int = 0,
        loss: float = 0.0,
        duplication: float = 0.0,
        delay_s: float = 0.02,
        jitter_s: float = 0.0,
        cut_s: float = math.inf,
        silence_s: float = 3.0,
        stop_s: float = math.inf,
    ) -> None:
        self.vehicle = vehicle
        self.random = random.Random(seed)
        self.loss, self.duplication = loss, duplication
        self.delay_s, self.jitter_s = delay_s, jitter_s
        self.cut_s, self.silence_s, self.stop_s = cut_s, silence_s, stop_s
        self.now_s = 0.0
        self.sent: list[Message] = []
        self.sent_s: list[float] = []
        self.shown: list[Show] = []
        self._order = itertools.count()
        self._queue: list[tuple[float, int, bool, Message]] = []

    def run(self, script: Callable[[Context], Script[Any]], limit_s: float = 300.0) -> Any:
        """Run a script to its end; return its result or raise its error."""

        def addressed(context: Context) -> Script[Any]:
            context.system, context.component = SYSTEM, COMPONENT
            return (yield from script(context))

        machine: Machine[Any] = Machine(addressed)
        start_s = heard_s = next_heartbeat_s = self.now_s
        stopped = False
        steps = 0
        self._do(machine.step(Tick(self.now_s)))
        while not machine.done:
            steps += 1
            assert self.now_s - start_s < limit_s and steps < 200_000, "the script does not end"
            wake_s = max(machine.wake_at_s, self.now_s + 1e-6)
            if not stopped and (self.now_s >= self.stop_s or self.now_s - heard_s > self.silence_s):
                stopped = True
                self._do(machine.step(Stop(self.now_s, "Stopped.")))
                continue
            next_s = min(wake_s, next_heartbeat_s, self._queue[0][0] if self._queue else math.inf)
            next_s = min(next_s, heard_s + self.silence_s + 1e-3 if not stopped else math.inf)
            self.now_s = max(next_s, self.now_s)
            if self.now_s >= next_heartbeat_s:
                next_heartbeat_s += 1.0
                self._carry(self.vehicle.heartbeat(), to_vehicle=False)
            elif self._queue and self._queue[0][0] <= self.now_s:
                _, _, to_vehicle, message = heapq.heappop(self._queue)
                if to_vehicle:
                    for answer in self.vehicle.handle(message):
                        self._carry(answer, to_vehicle=False)
                else:
                    heard_s = self.now_s
                    self._do(machine.step(Incoming(self.now_s, SYSTEM, COMPONENT, message)))
            else:
                self._do(machine.step(Tick(self.now_s)))
        if machine.error is not None:
            raise machine.error
        return machine.result

    def _do(self, actions: list[Any]) -> None:
        for action in actions:
            if isinstance(action, Send):
                self.sent.append(action.message)
                self.sent_s.append(self.now_s)
                self._carry(action.message, to_vehicle=True)
            elif isinstance(action, Show):
                self.shown.append(action)

    def _carry(self, message: Message, to_vehicle: bool) -> None:
        copies = 2 if self.random.random() < self.duplication else 1
        for _ in range(copies):
            arrival_s = self.now_s + self.delay_s + self.random.uniform(0.0, self.jitter_s)
            if self.random.random() >= self.loss and arrival_s < self.cut_s:
                heapq.heappush(self._queue, (arrival_s, next(self._order), to_vehicle, message))
