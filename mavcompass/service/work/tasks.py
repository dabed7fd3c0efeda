"""What people and programs ask the service to do, and how each request is getting on."""

from __future__ import annotations

import math
import threading
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Annotated, Any, ClassVar, Literal

from msgspec import Meta

from mavcompass.calibration.methods import method_names
from mavcompass.calibration.result import BY_EYE_SIGMA_RAD, TrueHeading
from mavcompass.errors import MavCompassError, Refused
from mavcompass.heading.live import Heading
from mavcompass.procedure.motion import Permissions
from mavcompass.procedure.positions import DwellSettings
from mavcompass.procedure.script import Ask, Show
from mavcompass.procedure.settings import CalibrateSettings, Writing
from mavcompass.service.models import Compass, checked
from mavcompass.service.work.history import Kind
from mavcompass.vehicle.stopping import StopRequest

Motion = Literal["auto", "vehicle", "hand"]
State = Literal["waiting", "running", "asking", "done", "failed"]
Origin = Literal["http", "mavlink"]

# The method that writes what the service learnt while the vehicle worked: nothing moves.
LEARNT = "running"

_MOST_LINES = 200
_AFTER_WRITING = 0.9


def _twice(compasses: tuple[int, ...]) -> str | None:
    return "has a compass twice" if len(set(compasses)) < len(compasses) else None


def _unknown_method(method: str) -> str | None:
    return None if method in method_names() else f"must be one of {', '.join(method_names())}"


@dataclass(frozen=True, slots=True)
class CalibrationRequest:
    """Ask for a calibration."""

    compasses: Annotated[
        tuple[Compass, ...],
        Meta(max_length=3, description="Counted from 1; empty means those of the configuration, or all."),
        Meta(extra_json_schema={"uniqueItems": True}),
        checked(_twice),
    ] = ()
    motion: Annotated[
        Motion, Meta(description="Who turns the vehicle; auto: itself where it is armed, else a person.")
    ] = "auto"
    writing: Annotated[
        Writing, Meta(description="Whether the result is written: after a question, at once, or not at all.")
    ] = "ask"
    method: Annotated[
        str,
        Meta(
            extra_json_schema={"enum": list(method_names())},
            description="running: write what was learnt while the vehicle worked; nothing moves.",
        ),
        checked(_unknown_method),
    ] = "four-positions"
    true_heading_deg: Annotated[
        Annotated[float, Meta(ge=-360.0, le=360.0)] | None,
        Meta(description="For one-point: where it points, from true north; else a second antenna's."),
    ] = None
    true_heading_sigma_deg: Annotated[float, Meta(ge=0.05, le=45.0)] = math.degrees(BY_EYE_SIGMA_RAD)
    max_error_deg: Annotated[float, Meta(ge=0.1, le=45.0)] = 2.0
    positions: Annotated[int, Meta(ge=3, le=24)] = 4
    dwell_s: Annotated[float, Meta(ge=0.5, le=60.0)] = 2.0
    orientation: Annotated[
        bool, Meta(description="Set how a compass is mounted, too, where it is mounted turned.")
    ] = False
    rewrite: Annotated[bool, Meta(description="Write also where the values in force are already right.")] = (
        False
    )

    set_mode: Annotated[bool, Meta(description="Allow changing the flight mode; it is put back.")] = False
    arm: Annotated[
        bool,
        Meta(
            description="Allow arming; it is disarmed afterwards. Where it refuses for its compass alone, a"
            " question (with writing 'yes' none) is whether that check may be set aside until it is armed."
        ),
    ] = False
    takeoff_m: Annotated[
        Annotated[float, Meta(ge=2.0, le=100.0)] | None,
        Meta(description="Allow a copter to take off to so many metres; it lands afterwards."),
    ] = None
    land: Annotated[bool, Meta(description="Allow landing a copter that flies.")] = False

    kind: ClassVar[Kind] = "calibration"

    def settings(self, system: int, year: float, rate_hz: float) -> CalibrateSettings:
        """Return what it asks of the procedure, on a vehicle of this system id."""
        heading_deg, sigma_rad = self.true_heading_deg, math.radians(self.true_heading_sigma_deg)
        return CalibrateSettings(
            instances=self.compasses,
            method=self.method,
            true_heading=None if heading_deg is None else TrueHeading(math.radians(heading_deg), sigma_rad),
            max_heading_error_deg=self.max_error_deg,
            motion=self.motion,
            permissions=Permissions(
                self.set_mode, self.arm, self.takeoff_m or 0.0, self.land, exempt=self.writing
            ),
            positions=self.positions,
            writing=self.writing,
            system=system,
            rate_hz=rate_hz,
            year=year,
            orientation=self.orientation,
            rewrite=self.rewrite,
            dwell=DwellSettings(dwell_s=self.dwell_s),
        )


@dataclass(frozen=True, slots=True)
class CheckRequest:
    """Ask for a pre-flight check."""

    turn: Annotated[
        Literal["none", "vehicle", "hand"],
        Meta(description="Who turns the vehicle by 90 degrees, if anybody."),
    ] = "none"

    kind: ClassVar[Kind] = "check"


@dataclass(frozen=True, slots=True)
class UndoRequest:
    """Ask to put back what an undo file holds."""

    undo_file: str
    entry: int

    kind: ClassVar[Kind] = "undo"


@dataclass(frozen=True, slots=True)
class GapRequest:
    """Ask why the recording of a calibration differs from the simulation."""

    recording: str
    entry: int

    kind: ClassVar[Kind] = "gap"


Request = CalibrationRequest | CheckRequest | UndoRequest | GapRequest


# So many points of a run are drawn, no nearer to each other than this.
_MOST_POINTS, _APART_MGAUSS = 900, 1.5
Point = tuple[float, float]


@dataclass(slots=True)
class Trail:
    """Keep what a page draws of a run, whenever it joins: each compass's level field, forward and right.

    Attributes:
        turned_rad: the gyro's angle at the start; nan before that is known.
        positions: where the field was as each still position was reached.
        written: how many points there were before the write.
    """

    turned_rad: float = math.nan
    points: dict[int, list[Point]] = field(default_factory=dict)
    positions: dict[int, list[Point]] = field(default_factory=dict)
    written: dict[int, int] = field(default_factory=dict)

    def add(self, heading: Heading, turned_rad: float) -> None:
        """Take a heading."""
        if math.isnan(self.turned_rad):
            self.turned_rad = turned_rad
        forward, right, _ = heading.level_mgauss
        here, drawn = (round(forward, 1), round(right, 1)), self.points.setdefault(heading.instance, [])
        far = not drawn or math.dist(here, drawn[-1]) >= _APART_MGAUSS
        if far and len(drawn) < _MOST_POINTS:
            drawn.append(here)

    def mark(self, show: Show) -> None:
        """Take note of a position that was reached, and of the write."""
        if show.step == "write" and not self.written:
            self.written = {instance: len(drawn) for instance, drawn in self.points.items()}
        position = next((round(value) for name, value in show.data if name == "position"), 0)
        for instance, drawn in self.points.items():
            spots = self.positions.setdefault(instance, [])
            if show.step == "dwell" and drawn and len(spots) < position:
                spots.append(drawn[-1])

    def since(self, known: Mapping[int, int]) -> dict[str, Any]:
        """Return what was added since a listener had so many points of each compass."""
        return {
            "turned_at_start_deg": round(math.degrees(self.turned_rad), 1),
            "compasses": {
                instance: {
                    "first": known.get(instance, 0),
                    "points": drawn[known.get(instance, 0) :],
                    "positions": self.positions.get(instance, []),
                    "written": self.written.get(instance),
                }
                for instance, drawn in list(self.points.items())
            },
        }


class Busy(MavCompassError):
    """Report that something else is being done: one motion at a time."""


@dataclass(slots=True)
class Task:
    """Hold one request on its way; written by the thread that works on it, read by everybody.

    Attributes:
        lines: what was told so far: step, text, fraction, data.
        fraction: of the whole, 0..1, never falling.
        question: what the person is asked now, None while nothing. proposals: what it would write.
        document: the machine-readable result. entry: its number in the history.
        results: the latest solution for each compass of a calibration, as soon as there is one.
    """

    number: int
    request: Request
    origin: Origin
    started_at: str
    state: State = "waiting"
    lines: list[dict[str, Any]] = field(default_factory=list)
    fraction: float = 0.0
    question: Ask | None = None
    proposals: tuple[Mapping[str, Any], ...] = ()
    trail: Trail = field(default_factory=Trail)
    document: Mapping[str, Any] | None = None
    entry: int | None = None
    error: str = ""
    remedy: str = ""
    ok: bool = False
    results: tuple[Any, ...] = ()
    stop: StopRequest = field(default_factory=StopRequest)
    _answer: bool | None = None
    _answering: threading.Lock = field(default_factory=threading.Lock)

    @property
    def finished(self) -> bool:
        """Tell whether it has ended."""
        return self.state in ("done", "failed")

    def show(self, show: Show) -> None:
        """Take note of what the procedure tells."""
        self.trail.mark(show)
        if show.fraction is not None:
            # A write counts its own steps; the whole goes on after it.
            most = _AFTER_WRITING if show.step == "write" else 1.0
            self.fraction = max(self.fraction, min(show.fraction, most))
        line = {"step": show.step, "text": show.text, "fraction": self.fraction, "data": dict(show.data)}
        if len(self.lines) < _MOST_LINES:
            self.lines.append(line)
        else:  # a person who turns by hand gets many prompts; the latest is the one that counts
            self.lines[-1] = line

    def ask(self, question: Ask, proposals: tuple[Mapping[str, Any], ...] = ()) -> None:
        """Put a question to the person."""
        self._answer = None
        self.question, self.proposals, self.state = question, proposals, "asking"

    def give_answer(self, yes: bool) -> bool:
        """Answer the question; False where none is open. The first answer counts, whoever gives it."""
        with self._answering:
            if self.question is None:
                return False
            self._answer, self.question = yes, None
            return True

    def poll_answer(self) -> bool | None:
        """Return the answer when there is one."""
        answer = self._answer
        if answer is not None:
            self._answer, self.state = None, "running"
        return answer

    def finish(self, ok: bool, document: Mapping[str, Any], entry: int | None) -> None:
        """End with a result."""
        self.ok, self.document, self.entry = ok, document, entry
        self.question, self.fraction, self.state = None, 1.0, "done"

    def fail(self, error: Exception) -> None:
        """End with an error."""
        self.error = error.what if isinstance(error, MavCompassError) else f"{type(error).__name__}: {error}"
        self.remedy = getattr(error, "remedy", "")
        self.question, self.state = None, "failed"

    def to_json(self) -> dict[str, Any]:
        """Describe it, with everything that was told."""
        return {
            "id": self.number,
            "kind": self.request.kind,
            "method": self.request.method if isinstance(self.request, CalibrationRequest) else None,
            "origin": self.origin,
            "started_at": self.started_at,
            "state": self.state,
            "ok": self.ok,
            "fraction": self.fraction,
            "lines": list(self.lines),
            "question": None if self.question is None else self.question.question,
            "about": [] if self.question is None else list(self.question.about),
            "details": [] if self.question is None else list(self.question.details),
            "proposals": [] if self.question is None else list(self.proposals),
            "document": self.document,
            "history_entry": self.entry,
            "error": self.error,
            "remedy": self.remedy,
        }


class Desk:
    """Take one request at a time; safe to use from several threads."""

    def __init__(self) -> None:
        self._lock = threading.Lock()
        self._count = 0
        self._current: Task | None = None
        self._closed = False

    @property
    def current(self) -> Task | None:
        """Return the latest task, running or finished; None before the first."""
        return self._current

    @property
    def busy(self) -> bool:
        """Tell whether a task is waiting or running."""
        return self._current is not None and not self._current.finished

    def submit(self, request: Request, origin: Origin, now: str) -> Task:
        """Take a request. Raises Busy while another is under way."""
        with self._lock:
            if self._closed:
                raise Refused("The service is stopping.", "Start it again.")
            if self._current is not None and not self._current.finished:
                raise Busy(
                    f"A {self._current.request.kind} is under way.", "Wait for its end, or stop it first."
                )
            self._count += 1
            self._current = Task(self._count, request, origin, now)
            return self._current

    def take(self) -> Task | None:
        """Return the task that is waiting, now running; None where there is none."""
        with self._lock:
            task = self._current
            if task is None or task.state != "waiting":
                return None
            task.state = "running"
            return task

    def close(self, reason: str) -> None:
        """Take no more requests, and stop the one under way."""
        with self._lock:
            self._closed = True
            task = self._current
            if task is not None and not task.finished:
                task.stop.reason = task.stop.reason or reason
                if task.state == "waiting":
                    task.fail(Refused(reason))
