"""One vehicle, one link, one folder: every step that a procedure takes on them is counted and may fail."""

from __future__ import annotations

import heapq
import io
import itertools
import math
import os
import random
from bisect import insort
from collections import Counter
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any, Literal
from unittest.mock import patch

from mavcompass.errors import LinkLost
from mavcompass.messages import (
    CommandLong,
    Incoming,
    Message,
    ParamRequestRead,
    ParamSet,
    SetAttitudeTarget,
    SetPositionTargetLocalNed,
)
from mavcompass.procedure.script import Show
from mavcompass.simulation.autopilot.guidance import TARGET_TIMEOUT_S
from mavcompass.simulation.vehicle import SimulatedAutopilot
from mavcompass.vehicle.links.simulated import SimulatedLink
from mavcompass.vehicle.stopping import StopRequest

StepKind = Literal["send", "hear", "file", "state"]
# What a calibration changes, and what it holds at another value meanwhile.
COMPASS = ("COMPASS", "CAL_MAG", "ARMING_CHECK", "EK3_", "EKF2_")
TURNING_RADPS = math.radians(5.0)


class Killed(BaseException):
    """End the program as SIGKILL does: nothing handles this, and nothing is said or written after it."""


class Hung(BaseException):
    """End a run that went on for too long."""


@dataclass(frozen=True, slots=True)
class Step:
    """Name a step: a message sent or heard, a file's write, fsync or rename, a change of phase."""

    kind: StepKind
    what: str


@dataclass(frozen=True, slots=True)
class Carried:
    """Hold a message on its way, with its sender; `delay_s` holds it back."""

    way: Literal["send", "hear"]
    message: Message
    system: int
    component: int
    delay_s: float = 0.0


@dataclass(frozen=True, slots=True)
class Fault:
    """Say what goes wrong at a step: something happens, or a message is carried otherwise.

    Attributes:
        ends_it: whoever commands motion is gone, or has to end it, from the step on.
        steps_in: somebody does so who is there: a calibration ends as a refusal, all put back.
    """

    name: str
    happen: Callable[[Scene], None] | None = None
    carry: Callable[[Scene, Carried], list[Carried] | None] | None = None
    ends_it: bool = False
    steps_in: bool = False


@dataclass
class Scene:
    """Be what a procedure works on.

    Attributes:
        target, fault: the fault happens at the step of this number, from 1.
        count, steps: steps so far; while nothing is to happen (`target` 0) they are kept.
        told: every sentence for the person. at_s: when the fault happened, on the link's clock.
        limit_s: virtual time at which a run counts as hung.
        stop: the person's or the system's wish that it ends.
        mode, rates: what the vehicle is to be left with; the fault may change the mode.
        began: whether motion had been commanded when the fault happened.
        before: the compass parameters at the start. touched: those that the undisturbed run wrote.
        foreign, foreign_s: what somebody else wrote, and when last. read_s: when each was read last.
        tracebacks: those in the log, and those that nobody could catch.
        order: the mode in which it turns as it is told, and until when what it was told last lasts.
        commanded_s: when it was last told to turn, or last turned by an order in force.
        turning_s: when it was last seen in a turn that an order began; one that the autopilot begins by
            itself, as where it holds a heading that jumps, is not ours. stood_s: when first not turning,
            after `at_s`. sent: messages that got through, by kind. wrote: parameters that were told a value.
    """

    vehicle: SimulatedAutopilot
    folder: Path
    chance: random.Random = field(default_factory=lambda: random.Random(0))
    fault: Fault | None = None
    target: int = 0
    limit_s: float = math.inf
    active: bool = False
    stop: StopRequest = field(default_factory=StopRequest)
    mode: int = -1
    began: bool = False
    rates: dict[int, int] = field(default_factory=dict)
    count: int = 0
    steps: list[Step] = field(default_factory=list)
    told: list[str] = field(default_factory=list)
    at_s: float = math.nan
    dead: bool = False
    closed: bool = False
    silent_until_s: float = -math.inf
    disk_error: int = 0
    clock_off_s: float = 0.0
    leap_s: float = 0.0
    before: dict[str, float] = field(default_factory=dict)
    touched: frozenset[str] = frozenset()
    foreign: dict[str, float] = field(default_factory=dict)
    foreign_s: float = -math.inf
    agenda: list[tuple[float, Callable[[], None]]] = field(default_factory=list)
    read_s: dict[str, float] = field(default_factory=dict)
    order: tuple[str, float] = ("", -math.inf)
    commanded_s: float = -math.inf
    turning_s: float = -math.inf
    stood_s: float = -math.inf
    sent: Counter[type[Message]] = field(default_factory=Counter)
    wrote: set[str] = field(default_factory=set)
    tracebacks: list[str] = field(default_factory=list)
    held: dict[str, Carried] = field(default_factory=dict)

    @property
    def undo_folder(self) -> Path:
        """Return where undo files go."""
        return self.folder / "undo"

    def link(self) -> WatchedLink:
        """Open a link to the vehicle."""
        self.closed = False
        return WatchedLink(self)

    def look_on(self, seconds: float) -> None:
        """Let time pass while somebody listens."""
        with self.link() as link:
            end_s = self.vehicle.time_s + seconds
            while link.now() < end_s:
                link.receive(end_s - link.now())

    def mode_and_rates(self) -> tuple[int, dict[int, int]]:
        """Read the truth: the mode that the vehicle is in, and the rates of its messages."""
        streams = self.vehicle.firmware.telemetry.streams(0)
        rates = {number: streams.interval_us(number) for number in self.vehicle.firmware.telemetry.available}
        return self.vehicle.firmware.reports.heartbeat().custom_mode, rates

    def compass_values(self) -> dict[str, float]:
        """Read the truth: what the vehicle's storage holds about its compasses."""
        held = self.vehicle.firmware.store.values
        return {name: value for name, value in held.items() if name.startswith(COMPASS)}

    def show(self, show: Show) -> None:
        """Take a line for the person: a change of the procedure's state."""
        self.told.append(show.text)
        self.step("state", show.step)

    def step(self, kind: StepKind, what: str) -> bool:
        """Count a step; True where the fault happens at it."""
        if not self.active:
            return False
        if self.dead:
            raise Killed
        self.count += 1
        if not self.target:
            self.steps.append(Step(kind, what))
        if self.count != self.target or self.fault is None:
            return False
        self.at_s, self.began = self.vehicle.time_s, self.commanded_s > -math.inf
        if self.fault.happen is not None:
            was, _ = self.mode_and_rates()
            self.fault.happen(self)
            now, _ = self.mode_and_rates()
            self.mode = now if now != was else self.mode  # what the fault changed is not ours to put back
            if self.dead:
                raise Killed
        return True

    def carry(self, carried: Carried) -> list[Carried]:
        """Say how a message goes on its way."""
        if not self.active:
            return [carried]
        out = [carried]
        if self.step(carried.way, type(carried.message).__name__) and self.fault and self.fault.carry:
            out = self.fault.carry(self, carried) or []
        if out and (late := self.held.pop(carried.way, None)) is not None:
            out.append(late)
        return out

    def attend(self, now_s: float) -> None:
        """Let happen what is due, and end what is over."""
        if self.active and self.dead:
            raise Killed
        if now_s > self.limit_s:
            raise Hung(f"still going on after {now_s:.0f} s of the vehicle's time")
        while self.agenda and self.agenda[0][0] <= now_s:
            self.agenda.pop(0)[1]()

    def at(self, time_s: float, happen: Callable[[], None]) -> None:
        """Let something happen at a time."""
        insort(self.agenda, (time_s, happen), key=lambda due: due[0])


class WatchedLink(SimulatedLink):
    """Be the vehicle's link in virtual time, with the scene's faults on it."""

    def __init__(self, scene: Scene) -> None:
        super().__init__(scene.vehicle, "sim")
        self.scene = scene
        self._order = itertools.count()
        self._coming: list[tuple[float, int, Carried]] = []
        self._going: list[tuple[float, int, Carried]] = []

    def send(self, message: Message) -> None:
        """Send, as the fault has it."""
        identity = self.identity
        self._put(self.scene.carry(Carried("send", message, identity.spoken_system, identity.component)))

    def receive(self, timeout_s: float) -> Incoming | None:
        """Return what is heard, as the fault has it."""
        deadline_s = self.now() + timeout_s
        while True:
            now_s = self.now()
            self.scene.attend(now_s)
            if self.scene.leap_s:
                self._leap()
                continue
            if self.scene.closed:
                raise LinkLost("The link was closed.", "Open it again.")
            while self._going and self._going[0][0] <= now_s:
                self._deliver(heapq.heappop(self._going)[2])
            if self._coming and self._coming[0][0] <= now_s:
                late = heapq.heappop(self._coming)[2]
                return Incoming(now_s, late.system, late.component, late.message)
            queues = (self._coming, self._going, self.scene.agenda)
            until_s = min([deadline_s, *(queue[0][0] for queue in queues if queue)])
            heard = super().receive(max(until_s - now_s, 0.0))
            if heard is not None:
                if self.now() < self.scene.silent_until_s:
                    continue
                out = self.scene.carry(Carried("hear", heard.message, heard.system, heard.component))
                if len(out) == 1 and out[0].message is heard.message and not out[0].delay_s:
                    return replace(heard, system=out[0].system, component=out[0].component)
                self._put(out)
            elif self.now() >= deadline_s and not (self._coming and self._coming[0][0] <= self.now()):
                return None

    def _leap(self) -> None:
        """Let time pass that nobody listened to, as on a computer that was suspended."""
        end_s, self.scene.leap_s = self.now() + self.scene.leap_s, 0.0
        while self.autopilot.time_s < end_s - 1e-6:
            self._advance(self.autopilot.time_s + 0.1)
        self._heard.clear()
        self._now_s = self.autopilot.time_s

    def _put(self, out: list[Carried]) -> None:
        for carried in out:
            if carried.way == "send" and not carried.delay_s:
                self._deliver(carried)
            else:
                queue = self._going if carried.way == "send" else self._coming
                heapq.heappush(queue, (self.now() + carried.delay_s, next(self._order), carried))

    def _deliver(self, carried: Carried) -> None:
        scene = self.scene
        if scene.closed or self.now() < scene.silent_until_s:
            return
        scene.sent[type(carried.message)] += 1
        match carried.message:
            case ParamRequestRead(param_id=name):
                scene.read_s[name] = self.now()
            case ParamSet(param_id=name):
                scene.wrote.add(name)
        own_deg = math.degrees(self.autopilot.firmware.board.filter.yaw_rad)
        if (lasts_s := ordered_s(carried.message, own_deg)) is not None:
            mode = scene.order[0] or (self.autopilot.firmware.status.mode if lasts_s else "")
            scene.order = mode, self.now() + lasts_s
            scene.commanded_s = self.now() if lasts_s else scene.commanded_s
        self.autopilot.receive(carried.message, carried.system, carried.component, self._port)

    def _advance(self, until_s: float) -> None:
        before_s = self.autopilot.time_s
        super()._advance(until_s)
        scene, now_s, status = self.scene, self.autopilot.time_s, self.autopilot.firmware.status
        if abs(scene.vehicle.body.yaw_rate_radps) > TURNING_RADPS:
            if status.armed and status.mode == scene.order[0] and now_s <= scene.order[1]:
                scene.commanded_s = scene.turning_s = now_s
            elif scene.turning_s >= before_s:
                scene.turning_s = now_s
        elif now_s >= scene.at_s > scene.stood_s:
            scene.stood_s = now_s


def ordered_s(message: Message, own_deg: float) -> float | None:
    """Return for how long a message has the vehicle turn, 0 to stand; None where it says nothing of that.

    `own_deg` is the autopilot's own heading.
    """
    match message:
        case CommandLong(command=115, param1=heading_deg, param2=rate_deg_s, param4=0.0):
            return abs((heading_deg - own_deg + 180.0) % 360.0 - 180.0) / rate_deg_s
        case CommandLong(command=115, param1=angle_deg, param2=rate_deg_s):
            return angle_deg / rate_deg_s
        case SetPositionTargetLocalNed(yaw_rate=rate, type_mask=mask):
            return TARGET_TIMEOUT_S if not mask & 0x400 or rate else 0.0
        case SetAttitudeTarget(body_yaw_rate=rate, type_mask=mask):
            return TARGET_TIMEOUT_S if not mask & 0x80 or rate else 0.0
    return None


class _WatchedFile:
    """Be a file whose writes are steps; half of what was to be written stays of one that fails."""

    def __init__(self, file: Any, scene: Scene, name: str) -> None:
        self._file, self._scene, self._name = file, scene, name

    def write(self, data: Any) -> int:
        try:
            _file_step(self._scene, f"write {self._name}")
        except BaseException:
            self._file.write(data[: len(data) // 2])
            self._file.flush()
            raise
        return int(self._file.write(data))

    def __getattr__(self, name: str) -> Any:
        return getattr(self._file, name)

    def __enter__(self) -> _WatchedFile:
        return self

    def __exit__(self, *_: object) -> None:
        self._file.close()


def _file_step(scene: Scene, what: str) -> None:
    scene.step("file", what)
    if scene.active and scene.disk_error:
        raise OSError(scene.disk_error, os.strerror(scene.disk_error))


@contextmanager
def watched_files(scene: Scene) -> Iterator[None]:
    """Make every change of a file in the scene's folder a step."""
    opened, fsync, replaced, created, made = io.open, os.fsync, os.replace, os.open, os.mkdir

    def ours(path: Any) -> bool:
        inside = isinstance(path, (str, os.PathLike)) and os.fspath(path).startswith(str(scene.folder))
        return scene.active and inside

    def watched_open(file: Any, mode: str = "r", *rest: Any, **named: Any) -> Any:
        if not ours(file) or not set(mode) & set("wax+"):
            return opened(file, mode, *rest, **named)
        name = "".join(Path(file).suffixes)
        _file_step(scene, f"open {name}")
        return _WatchedFile(opened(file, mode, *rest, **named), scene, name)

    def watched_fsync(fd: int) -> None:
        if scene.active:
            _file_step(scene, "fsync")
        fsync(fd)

    def watched_replace(source: Any, target: Any, **named: Any) -> None:
        if ours(target):
            _file_step(scene, f"rename {Path(target).suffix}")
        replaced(source, target, **named)

    def watched_create(path: Any, flags: int, *rest: Any, **named: Any) -> int:
        if ours(path) and flags & os.O_CREAT:
            _file_step(scene, f"reserve {Path(path).suffix}")
        return created(path, flags, *rest, **named)

    def watched_mkdir(path: Any, *rest: Any, **named: Any) -> None:
        if ours(path):
            _file_step(scene, "mkdir")
        made(path, *rest, **named)

    with (
        patch.object(io, "open", watched_open),
        patch.object(os, "fsync", watched_fsync),
        patch.object(os, "replace", watched_replace),
        patch.object(os, "open", watched_create),
        patch.object(os, "mkdir", watched_mkdir),
    ):
        yield
