"""Learn while the vehicle works: keep its latest minutes, and ask now and then what they show of a compass.

What is kept is a recording of bounded length, in pieces of ten seconds, without those in which the vehicle
stood: these say nothing new. Asking is done by a helper process, so that neither memory nor heading suffer.
"""

from __future__ import annotations

import logging
import math
import threading
from collections import deque
from collections.abc import Mapping
from dataclasses import dataclass, field
from datetime import datetime, timedelta

import numpy as np

from mavcompass.calibration.methods.running import WINDOW_S
from mavcompass.calibration.result import CalibrationResult
from mavcompass.earth_field import EarthField
from mavcompass.errors import MavCompassError
from mavcompass.frames import FloatArray
from mavcompass.messages import Incoming
from mavcompass.procedure.dialect import describe_compasses
from mavcompass.service.config import LearningConfig
from mavcompass.service.view import VehicleView
from mavcompass.service.watch import Finding
from mavcompass.service.work import clock
from mavcompass.service.work.worker import Worker, learn
from mavcompass.track import Track
from mavcompass.track_builder import TrackBuilder
from mavcompass.vehicle.dialects import make_dialect

_log = logging.getLogger(__name__)

PIECE_S = 10.0
# Asked after so many pieces: at first often, for a vehicle whose compass is far off; then seldom.
_SOON, _LATER, _EAGER = 6, 30, 60
# A gyro that varies by less than this, and a field that stays within this angle, belong to what stands:
# the mean of five readings with 3 mG of noise in a field of 500 moves by 0.2 degrees.
_STANDS_RADPS, _STANDS_TURN_RAD = math.radians(0.5), math.radians(0.5)


@dataclass(frozen=True, slots=True)
class Lesson:
    """Hold what was learnt of one compass, and when.

    Attributes:
        result: not accepted where it is not to be believed yet.
        changed_at: when its iron changed, None where it did not.
    """

    result: CalibrationResult
    changed_at: datetime | None = None


@dataclass(slots=True)
class _Kept:
    """Hold the pieces that were kept, as if nothing had been left out between them.

    Attributes:
        left_out_s: of time before each piece. count: of pieces, dropped ones of long ago included.
    """

    pieces: deque[Track] = field(default_factory=lambda: deque(maxlen=int(WINDOW_S / PIECE_S)))
    left_out_s: deque[float] = field(default_factory=lambda: deque(maxlen=int(WINDOW_S / PIECE_S)))
    count: int = 0
    dropped_s: float = 0.0

    def add(self, piece: Track) -> None:
        self.pieces.append(piece.shifted(-self.dropped_s))
        self.left_out_s.append(self.dropped_s)
        self.count += 1

    def boot_time_s(self, time_s: float) -> float:
        """Return when something of the joined recording happened by the vehicle's clock."""
        for piece, left_out_s in zip(self.pieces, self.left_out_s, strict=True):
            ends = [float(c.time_s[-1]) for c in piece.compasses.values() if len(c.reported)]
            if ends and time_s <= max(ends):
                return time_s + left_out_s
        return time_s + self.dropped_s


class Learning:
    """Learn the compasses of one vehicle; everything but `close` is the station's thread's.

    Attributes:
        lessons: the latest of each compass.
    """

    def __init__(self, config: LearningConfig) -> None:
        self.lessons: dict[int, Lesson] = {}
        self._config = config
        self._worker = Worker()
        self._builder: TrackBuilder | None = None
        self._corrections: Mapping[str, float] = {}
        self._thread: threading.Thread | None = None
        self._told: tuple[_Kept, dict[int, CalibrationResult]] | None = None
        self.restart()

    def restart(self) -> None:
        """Begin anew: the link was silent, the vehicle was restarted or its parameters were changed."""
        self._kept = _Kept()
        self._builder, self._piece_s = None, math.nan
        self._asked, self._rests = 0, False

    def forget(self) -> None:
        """Forget what was learnt, too: another calibration is in force."""
        self.restart()
        self.lessons = {}

    def hear(self, view: VehicleView, heard: Incoming) -> None:
        """Take one message of the vehicle."""
        if not (self._config.enabled and view.fresh):
            return
        if view.parameters != self._corrections:
            self._corrections = dict(view.parameters)
            self.forget()
        if self._builder is None:
            self._builder = TrackBuilder(view.identity.autopilot, view.identity.kind)
            self._builder.parameters.update(view.parameters)
            describe_compasses(self._builder, make_dialect(view.identity.autopilot), view.parameters)
        builder = self._builder
        builder.add(heard)
        if not math.isfinite(builder.latest_s):
            return
        if math.isnan(self._piece_s):
            self._piece_s = builder.latest_s
        elif builder.latest_s - self._piece_s >= PIECE_S:
            self._keep(builder)

    def _keep(self, builder: TrackBuilder) -> None:
        lasted_s, self._piece_s = builder.latest_s - self._piece_s, builder.latest_s
        piece = builder.take()
        if not piece.compasses or piece.gyro_radps is None:
            return
        rested, self._rests = self._rests, _stands(piece)
        if self._rests and rested:
            self._kept.dropped_s += lasted_s
        else:
            self._kept.add(piece)

    def tend(self, view: VehicleView) -> None:
        """Take what was found, and ask where there is enough that is new."""
        told, self._told = self._told, None
        if told is not None and told[0] is self._kept:
            self.lessons = {i: self._lesson(result) for i, result in told[1].items()}
        new = self._kept.count - self._asked
        if new < (_SOON if self._kept.count <= _EAGER else _LATER):
            return
        if self._thread is None or not self._thread.is_alive():
            self._asked = self._kept.count
            arguments = (self._kept, list(self._kept.pieces), view.instances(), view.world)
            self._thread = threading.Thread(target=self._ask, args=arguments, name="learning", daemon=True)
            self._thread.start()

    def _ask(
        self, kept: _Kept, pieces: list[Track], instances: tuple[int, ...], world: EarthField | None
    ) -> None:
        """Have the process look at the pieces; its answer counts unless all began anew meanwhile."""
        try:
            found = self._worker.call(learn, pieces, instances, world, self._config.limit_deg)
            self._told = kept, found
        except MavCompassError as error:
            _log.info("nothing could be learnt: %s", error)
        except Exception:
            _log.exception("unexpected error while learning")
        finally:
            self._worker.end()

    def _lesson(self, result: CalibrationResult) -> Lesson:
        if result.changed is None or self._builder is None:
            return Lesson(result)
        ago_s = self._builder.latest_s - self._kept.boot_time_s(result.changed.time_s)
        return Lesson(result, clock.now() - timedelta(seconds=ago_s))

    def offers(self) -> tuple[CalibrationResult, ...]:
        """List what would lower the heading error in force by the margin, at the least."""
        results = (lesson.result for lesson in self.lessons.values())
        return tuple(result for result in results if result.sure_gain_deg >= self._config.margin_deg)

    @property
    def findings(self) -> tuple[Finding, ...]:
        """Return what is to be told: offers, and iron that has changed."""
        changed = (_changed(lesson) for lesson in self.lessons.values() if lesson.changed_at is not None)
        return (*(_offer(result, self._config.margin_deg) for result in self.offers()), *changed)

    def close(self) -> None:
        """End the process for good."""
        self._worker.close()


def _stands(piece: Track) -> bool:
    """Tell whether nothing moves; a steady gyro may be a steady turn, which the field tells."""
    assert piece.gyro_radps is not None
    shaken = float(np.asarray(piece.gyro_radps.values).std(axis=0).max())
    fields = [compass.reported.values for compass in piece.compasses.values()]
    return shaken < _STANDS_RADPS and all(_turned_rad(field) < _STANDS_TURN_RAD for field in fields)


def _turned_rad(field: FloatArray) -> float:
    """Return the angle by which a field (N, 3) turned from its first half to its last."""
    first, last = (half.mean(axis=0) for half in np.array_split(field, 2))
    return math.atan2(float(np.linalg.norm(np.cross(first, last))), float(first @ last))


def _offer(result: CalibrationResult, margin_deg: float) -> Finding:
    i, old_deg, new_deg = result.instance, result.heading_change_deg, result.heading_sigma_deg
    short = f"Compass {i} is {old_deg:.0f} deg off, learnt: {new_deg:.1f} deg"
    text = (
        f"Compass {i} points {old_deg:.1f} degrees off, rms over the circle, by what was learnt on the way; "
        f"the calibration that was learnt is good to {new_deg:.1f} degrees."
    )
    remedy = "Disarm the vehicle, then have it written."
    return Finding("learnt", i, "warning", short, text, remedy, old_deg, margin_deg, "running")


def _changed(lesson: Lesson) -> Finding:
    assert lesson.result.changed is not None and lesson.changed_at is not None
    i, moved = lesson.result.instance, lesson.result.changed.moved_mgauss
    short = f"Compass {i}: iron changed {lesson.changed_at:%H:%M} UTC, {moved:.0f} mG"
    when = f"{lesson.changed_at:%H:%M:%S} UTC"
    text = f"The iron around compass {i} changed by about {moved:.0f} mG at {when}."
    remedy = "Find what was moved (a battery, a payload, a tool); calibrate if it stays."
    return Finding("moved", i, "warning", short, text, remedy, moved)
