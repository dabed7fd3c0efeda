"""Restore in drawn histories: several vehicles, addresses and clocks, and nothing goes to the wrong vehicle.

    .venv/bin/python scripts/campaigns/undo_histories.py [--histories 1000] [--steps 8] [--seed 1]

Each history draws two or three vehicles that differ in little (their unique id, their system id, a compass,
their board), and then lets `mavcompass params write` and `restore` be called, with and without a file, on
one or other of them at one or other address, of records and backups and copies of them elsewhere, while the
clock jumps about. Every value that is ever written is
another one, so that each tells whose it is. A vehicle must never hold a value that was not written to itself,
and `restore` without a file must bring back what its last write replaced.
"""

from __future__ import annotations

import io
import json
import random
import shutil
import sys
from contextlib import redirect_stderr, redirect_stdout
from dataclasses import dataclass
from datetime import UTC, datetime
from functools import partial
from pathlib import Path
from typing import Any
from unittest.mock import patch

from campaign import borrow, ended, folder, options, share, tried

from mavcompass import vehicle as vehicle_room
from mavcompass.cli.main import main as mavcompass
from mavcompass.enums import MavCmd, MavResult
from mavcompass.messages import AutopilotVersion, CommandAck, CommandLong, Message
from mavcompass.vehicle.link import ONBOARD_COMPUTER
from mavcompass.vehicle.links.autopilot import SaidMessage
from mavcompass.vehicle.links.simulated import SimulatedLink
from mavcompass.vehicle.parameters import undo

borrow("vehicle")
from parameter_vehicle import ParameterVehicle, ardupilot_parameters  # noqa: E402

ADDRESSES = ("udpin:0.0.0.0:14550", "tcp:192.168.1.7:5760")
OFFSETS = tuple(f"COMPASS_OFS_{axis}" for axis in "XYZ")


class Vehicle(ParameterVehicle):
    """Be an autopilot that has parameters and a serial number, and nothing else; `number` from 1.

    Attributes:
        own: the offsets that were ever written to it, or that it had at first.
    """

    def __init__(
        self, system: int, version: AutopilotVersion | None, devices: tuple[int, int], number: int
    ) -> None:
        ids = {f"COMPASS_DEV_ID{k}": float(one) for k, one in zip(("", "2"), devices, strict=True)}
        offsets = {name: float(10 * number + k) for k, name in enumerate(OFFSETS)}
        super().__init__(ardupilot_parameters(**ids, **offsets))
        self.system, self.version, self.number, self.own = system, version, number, set(offsets.values())
        self.time_s, self._beat_s = 0.0, 0.0
        self._due: list[Message] = []

    def receive(self, message: Message, system: int, component: int, port: int = 0) -> None:
        """Answer as the firmware does."""
        self._due += self.handle(message)

    def command(self, message: CommandLong) -> list[Message]:
        """Tell who it is."""
        if message.command == MavCmd.REQUEST_MESSAGE and self.version is not None:
            return [CommandAck(message.command, MavResult.ACCEPTED), self.version]
        return [CommandAck(message.command, MavResult.UNSUPPORTED)]

    def advance(self, until_s: float) -> list[SaidMessage]:
        """Let time pass."""
        if until_s >= self._beat_s:
            self._beat_s = until_s + 1.0
            self._due.append(self.heartbeat())
        said, self._due = self._due, []
        was_s, self.time_s = self.time_s, until_s
        return [SaidMessage(was_s, self.system, 1, message) for message in said]


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


@dataclass(frozen=True)
class Lived:
    """Hold what became of a history."""

    written: int
    refused: int
    wrong: list[str]


def live(seed: int, steps: int) -> Lived:
    """Draw a history and let it happen."""
    with folder() as place, patch("os.fsync", lambda handle: None):
        history = History(seed, place)
        history.run(steps)
    return Lived(history.written, history.refused, history.wrong)


def main(words: list[str] | None = None) -> int:
    """Let them all happen."""
    wanted = options(__doc__, words, histories=1000, steps=8, seed=1, workers=1)
    seeds = range(wanted.seed, wanted.seed + wanted.histories)
    lived = [*tried(partial(live, steps=wanted.steps), seeds, lambda one: one.wrong, workers=wanted.workers)]
    written, refused = sum(one.written for one in lived), sum(one.refused for one in lived)
    wrong = sum(bool(one.wrong) for one in lived)
    print(f"{share(wrong, len(lived))} histories wrong; {written} writes done, {refused} refused")
    return ended(wanted.json, lived, wrong or not (written and refused))


if __name__ == "__main__":
    sys.exit(main())
