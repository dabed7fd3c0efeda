#!/usr/bin/env python3
"""Restore in drawn histories: several vehicles, addresses and clocks, and nothing goes to the wrong vehicle.

    .venv/bin/python scripts/campaigns/undo_histories.py --histories 1000

Each history draws two or three vehicles that differ in little (their unique id, their system id, a compass,
their board), and then lets `mavcompass params write` and `restore` be called, with and without a file, on
one or other of them at one or other address, of records and backups and copies of them elsewhere, while the
clock jumps about. Every value that is ever written is
another one, so that each tells whose it is. A vehicle must never hold a value that was not written to itself,
and `restore` without a file must bring back what its last write replaced.
"""

from __future__ import annotations

import argparse
import io
import json
import random
import shutil
import sys
import tempfile
from collections import deque
from contextlib import redirect_stderr, redirect_stdout
from dataclasses import dataclass, field
from datetime import UTC, datetime
from pathlib import Path
from typing import Any
from unittest.mock import patch

from mavcompass import vehicle as vehicle_room
from mavcompass.cli.main import main as mavcompass
from mavcompass.enums import MavAutopilot, MavCmd, MavResult, MavType
from mavcompass.messages import (
    AutopilotVersion,
    CommandAck,
    CommandLong,
    Heartbeat,
    Message,
    ParamRequestRead,
    ParamSet,
    ParamValue,
)
from mavcompass.vehicle.link import ONBOARD_COMPUTER
from mavcompass.vehicle.links.autopilot import SaidMessage
from mavcompass.vehicle.links.simulated import SimulatedLink
from mavcompass.vehicle.parameters import undo
from mavcompass.vehicle.parameters.rules import parameter_rules

ADDRESSES = ("udpin:0.0.0.0:14550", "tcp:192.168.1.7:5760")
OFFSETS = tuple(f"COMPASS_OFS_{axis}" for axis in "XYZ")
_REAL32 = 9


@dataclass
class Vehicle:
    """Be an autopilot that has parameters and a serial number, and nothing else.

    Attributes:
        own: the offsets that were ever written to it, or that it had at first.
    """

    system: int
    version: AutopilotVersion | None
    devices: tuple[int, int]
    number: int
    time_s: float = 0.0
    values: dict[str, float] = field(default_factory=dict)
    own: set[float] = field(default_factory=set)
    _due: deque[SaidMessage] = field(default_factory=deque)
    _beat_s: float = 0.0

    def __post_init__(self) -> None:
        rules = parameter_rules("ardupilot")
        general = [*rules.general, *rules.vehicle]
        self.values = dict.fromkeys((name for name in general if "*" not in name), 0.0)
        for compass, device in zip(("", "2", "3"), (*self.devices, 0), strict=True):
            for stem, value in (("OFS", 1.0), ("DIA", 1.0), ("ODI", 0.0), ("MOT", 0.0)):
                self.values |= {f"COMPASS_{stem}{compass}_{axis}": value for axis in "XYZ"}
            for stem in rules.per_compass:
                self.values.setdefault(f"COMPASS_{stem}{compass}", 0.0)
            self.values[f"COMPASS_DEV_ID{compass}"] = float(device)
            self.values[f"COMPASS_EXTERN{compass or 'AL'}"] = 0.0
            self.values[f"COMPASS_SCALE{compass}"] = 1.0
        self.values |= {"COMPASS_ENABLE": 1.0, "COMPASS_OFFS_MAX": 1800.0}
        self.values |= {name: float(10 * self.number + k) for k, name in enumerate(OFFSETS)}
        self.own |= {self.values[name] for name in OFFSETS}

    def receive(self, message: Message, system: int, component: int, port: int = 0) -> None:
        """Answer as the firmware does."""
        match message:
            case ParamRequestRead(param_id=name) if name in self.values:
                self._say(ParamValue(name, self.values[name], _REAL32, len(self.values), 65_535))
            case ParamSet(param_id=name, param_value=value) if name in self.values:
                self.values[name] = value
                names = [name[:-1] + axis for axis in "XYZ"] if name.endswith("_X") else [name]
                for each in names:
                    self._say(ParamValue(each, self.values[each], _REAL32, len(self.values), 65_535))
            case CommandLong(command=MavCmd.REQUEST_MESSAGE) if self.version is not None:
                self._say(CommandAck(message.command, MavResult.ACCEPTED))
                self._say(self.version)
            case CommandLong():
                self._say(CommandAck(message.command, MavResult.UNSUPPORTED))

    def _say(self, message: Message) -> None:
        self._due.append(SaidMessage(self.time_s, self.system, 1, message))

    def advance(self, until_s: float) -> list[SaidMessage]:
        """Let time pass."""
        self.time_s = until_s
        if until_s >= self._beat_s:
            self._beat_s = until_s + 1.0
            self._say(Heartbeat(MavType.GROUND_ROVER, MavAutopilot.ARDUPILOTMEGA))
        said, self._due = list(self._due), deque()
        return said


def draw_vehicles(chance: random.Random) -> list[Vehicle]:
    """Draw vehicles of which no two are alike, though they differ in one thing only."""
    found: dict[tuple[Any, ...], Vehicle] = {}
    tells = chance.random() < 0.7  # a version and a unique id
    while len(found) < chance.choice((2, 2, 3)):
        uid, long, board = chance.choice((1, 2)) if tells else 0, chance.choice((3, 4)), chance.choice((5, 6))
        if tells and chance.random() < 0.3:  # ArduPilot's way: the long one only
            version = AutopilotVersion(flight_sw_version=0x04050700, board_version=board, uid2=(long,) * 18)
        elif tells or chance.random() < 0.5:
            version = AutopilotVersion(flight_sw_version=0x04050700, board_version=board, uid=uid)
        else:
            version = None
        system, devices = chance.choice((1, 1, 2)), (97_539, chance.choice((131_874, 131_618)))
        told = None if version is None else (version.board_version, version.uid, version.uid2)
        found.setdefault((system, devices, told), Vehicle(system, version, devices, len(found) + 1))
    return list(found.values())


class History:
    """Be one drawn history in a folder of its own."""

    def __init__(self, seed: int, folder: Path) -> None:
        self.chance = random.Random(seed)
        self.folder = folder
        self.vehicles = draw_vehicles(self.chance)
        self.wrong: list[str] = []
        self.last: dict[int, dict[str, float]] = {}
        self.fresh = 500
        self.written = self.refused = 0
        self.told = ""

    def run(self, steps: int) -> None:
        """Let it happen."""
        with patch.object(undo, "datetime", self._clock()):
            for _ in range(steps):
                self._step(self.chance.choice(self.vehicles), self.chance.choice(ADDRESSES))

    def _step(self, vehicle: Vehicle, address: str) -> None:
        chance, before = self.chance, dict(vehicle.values)
        records = sorted(self.folder.glob("undo/*.json"))
        kept = [
            *records,
            *(path.with_suffix(".new.param") for path in records),
            *self.folder.glob("backup.*"),
        ]
        match chance.choice(("write", "write", "restore", "restore", "file", "file", "again", "backup")):
            case "write":
                names = chance.sample(OFFSETS, chance.randint(1, 3))
                values = {name: float(self._next()) for name in names}
                path = self.folder / "wanted.param"
                path.write_text("".join(f"{name},{value}\n" for name, value in values.items()))
                vehicle.own |= set(values.values())
                if self._call(vehicle, "write", address, path) != 0:
                    self.wrong.append(f"a plain write was refused: {self.told}")
            case "restore":
                code = self._call(vehicle, "restore", address)
                wanted = self.last.get(vehicle.number)
                if wanted is None and code == 0:
                    self.wrong.append("restored without a record")
                if wanted is not None and any(vehicle.values[n] != v for n, v in wanted.items()):
                    self.wrong.append("the last write was not taken back")
            case "file" if records:
                record = chance.choice(records)
                if chance.random() < 0.1:  # as an earlier version left it
                    document = json.loads(record.read_text())
                    record = self.folder / "old.json"
                    record.write_text(json.dumps({**document, "vehicle": None}))
                    if self._call(vehicle, "restore", address, record) != 7:
                        self.wrong.append("a record of nobody knows whom was restored")
                self._call(vehicle, "restore", address, record)
            case "again" if kept:
                path = chance.choice(kept)
                if chance.random() < 0.5:
                    path = Path(shutil.copy(path, self.folder / f"copied{path.suffix}"))
                self._call(vehicle, chance.choice(("write", "restore")), address, path)
            case "backup":
                path = self.folder / f"backup.{chance.choice(('param', 'parm', 'params'))}"
                self._call(vehicle, "backup", address, path)
        changed = {name: before[name] for name in OFFSETS if before[name] != vehicle.values[name]}
        if changed:
            self.last[vehicle.number] = changed
        for each in self.vehicles:
            strange = {each.values[name] for name in OFFSETS} - each.own
            if strange:
                self.wrong.append(f"vehicle {each.number} holds {strange}, which is another's")

    def _call(self, vehicle: Vehicle, verb: str, address: str, file: Path | None = None) -> int:
        def open_link(source: str) -> SimulatedLink:
            return SimulatedLink(vehicle, source, ONBOARD_COMPUTER)

        words = ["params", verb, address, *([] if file is None else [str(file)]), "--yes"]
        if self.chance.random() < 0.5:
            words += ["--system", str(vehicle.system)]
        with (
            patch.object(vehicle_room, "open_link", open_link),
            patch.dict("os.environ", {undo.DIRECTORY_VARIABLE: str(self.folder / "undo")}),
            redirect_stdout(io.StringIO()),
            redirect_stderr(told := io.StringIO()),
        ):
            code = mavcompass(words)
        self.told = told.getvalue()
        self.written, self.refused = self.written + (code == 0), self.refused + (code == 7)
        if code not in (0, 2, 7):
            self.wrong.append(f"exit code {code} of {' '.join(words)}")
        return code

    def _next(self) -> int:
        self.fresh += 1
        return self.fresh

    def _clock(self) -> Any:
        chance = self.chance

        class Clock:
            """Jump about."""

            @staticmethod
            def now(zone: Any) -> datetime:
                return datetime.fromtimestamp(chance.choice((0, 1.7e9, 1.8e9, 2.5e9)), UTC)

        return Clock


def main(arguments: list[str] | None = None) -> int:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0] if __doc__ else "")
    parser.add_argument("--histories", type=int, default=1000)
    parser.add_argument("--steps", type=int, default=8)
    parser.add_argument("--seed", type=int, default=1)
    options = parser.parse_args(arguments)
    wrong = written = refused = 0
    with patch("os.fsync", lambda handle: None):
        for seed in range(options.seed, options.seed + options.histories):
            with tempfile.TemporaryDirectory() as folder:
                history = History(seed, Path(folder))
                history.run(options.steps)
            written, refused, wrong = (
                written + history.written,
                refused + history.refused,
                wrong + bool(history.wrong),
            )
            for sentence in history.wrong:
                print(f"history {seed}: {sentence}")
    print(f"{wrong} of {options.histories} histories wrong; {written} writes done, {refused} refused")
    return 1 if wrong or not (written and refused) else 0


if __name__ == "__main__":
    sys.exit(main())
