"""Hours of service in minutes: link cuts, reboots and calibrations, with memory and every reconnect watched.

    python scripts/campaigns/service_soak.py [--hours 2] [--cuts 200] [--reboots 20] [--calibrations 12]
                                             [--full-disks 3] [--clock-steps 20]
    python scripts/campaigns/service_soak.py --hours 72 --cuts 720 --reboots 72 --calibrations 72
                                             --full-disks 9 --clock-steps 72

The service's station runs on an embedded rover in virtual time, as fast as the machine can; its date runs
with it. Cuts lose everything both ways. A reconnect is counted from the moment the link works (or the
rebooted vehicle speaks) to the first heading published after it; cuts during which the vehicle was silent
anyway are counted from the end of the silence. Each calibration asked for must end, in the history and in a
MAG_CAL_REPORT that left while the link worked; what it wrote can be undone by the file that the history
names. On a disk that is full (the system refuses every byte beyond so many in each file: none, or what an
undo file or part of a recording takes) it must end, too, and only then may it be missing in the history.
The computer's clock steps by up to ten years, as a receiver's time sets it. Memory is the whole process's,
the simulated vehicle's included. One reading scatters by 0.7 %, alike for hours, as the heap's free end is
given back or not: the median of the last six hours is compared with that of six hours after the first two
(a fifth of a shorter run each).
"""

from __future__ import annotations

import contextlib
import gc
import random
import resource
import signal
import statistics
import sys
import tempfile
import time
from dataclasses import asdict, dataclass, field
from datetime import UTC, datetime, timedelta
from functools import partial
from pathlib import Path

from campaign import ended, options, resident_mb
from fault_cells.scene import Scene

from mavcompass.errors import UsageError
from mavcompass.messages import Incoming, MagCalReport
from mavcompass.service.config import ServiceConfig, StorageConfig, VehicleConfig
from mavcompass.service.station import Station
from mavcompass.service.work import clock
from mavcompass.service.work.history import Entry, History
from mavcompass.service.work.tasks import CalibrationRequest, Task
from mavcompass.simulation.vehicle import SimulatedAutopilot
from mavcompass.vehicle.link import Link
from mavcompass.vehicle.parameters.undo import load_record

_READY_AFTER_REBOOT_S = 10.0
_MOST_GROWTH_PERCENT = 2.0
_MOST_RECORDINGS = 50
_LARGEST_STEP_S = 3e8  # ten years
_BEGAN = datetime(2026, 5, 1, tzinfo=UTC)
# What a full disk still takes of each file: nothing, an undo file, a part of a recording.
_ROOM = (0, 20_000, 200_000)
_WARM_AFTER_S, _COMPARED_S, _READ_EVERY_S = 2 * 3600.0, 6 * 3600.0, 300.0
# Cuts and reboots end some calibrations; if they ended more than this, nothing was tried.
_LEAST_WRITTEN = 0.6


@dataclass(slots=True)
class Figures:
    """Hold what a soak showed; `faults` says in words what must not be."""

    virtual_s: float = 0.0
    wall_s: float = 0.0
    cuts: int = 0
    reboots: int = 0
    reconnects: int = 0
    slowest_reconnect_s: float = 0.0
    calibrations: int = 0
    written: int = 0
    interrupted: int = 0
    on_full_disk: int = 0
    clock_steps: int = 0
    recordings: int = 0
    warm_mb: float = 0.0
    end_mb: float = 0.0
    growth_percent: float = 0.0
    headings: int = 0
    undo_files: int = 0
    hourly_mb: list[float] = field(default_factory=list)
    endings: list[str] = field(default_factory=list)
    faults: list[str] = field(default_factory=list)


@dataclass(frozen=True, slots=True)
class Ended:
    """Keep of a calibration what is judged: all of it weighs 44 kB, as if the service grew."""

    number: int
    ok: bool
    finished: bool
    entry: int | None
    error: str
    reports: int
    on_full_disk: bool


class Soak:
    """Run one soak."""

    def __init__(
        self,
        hours: float,
        cuts: int,
        reboots: int,
        calibrations: int,
        full_disks: int = 0,
        clock_steps: int = 0,
        seed: int = 1,
    ) -> None:
        self.length_s = hours * 3600.0
        chance = random.Random(seed)
        # The first calibration is let alone: memory is compared with what a service weighs that has done one.
        begin, end = 90.0, self.length_s - 60.0
        starts = sorted(chance.uniform(begin, end) for _ in range(cuts))
        windows: list[tuple[float, float]] = []
        for start in starts:
            start = max(start, windows[-1][1] + 3.0 if windows else begin)
            windows.append((start, start + chance.uniform(0.5, 12.0)))
        reboots_at = sorted(chance.uniform(begin, end - 60.0) for _ in range(reboots))
        spacing_s = (end - begin) / max(calibrations, 1)
        self.calibrations_at = [5.0, *(begin + (k + 0.3) * spacing_s for k in range(1, calibrations))]
        steps_at = sorted(chance.uniform(begin, end) for _ in range(clock_steps))
        self.full_disks = set(chance.sample(range(1, calibrations), min(full_disks, calibrations - 1)))
        self._chance = chance
        self.vehicle = SimulatedAutopilot("rover", seed=seed)
        self.scene = Scene(self.vehicle, Path())
        self.link = self.scene.link()
        for start, stop in windows:
            self.scene.at(start, partial(setattr, self.scene, "silent_until_s", stop))
            self.scene.at(stop, self._waits)
        for when in reboots_at:
            self.scene.at(when, self.vehicle.reboot)
        for when in steps_at:
            self.scene.at(when, self._step_the_clock)
        self.figures = Figures(cuts=cuts, reboots=reboots)
        self._task: Task | None = None
        self._is_full = False
        self._ended: list[Ended] = []
        self._waiting_since: float | None = None
        self._seen_boots = 0
        self._step_s = 0.0

    def run(self) -> Figures:
        """Run to the end and return the figures."""
        with tempfile.TemporaryDirectory() as folder:
            config = ServiceConfig(
                vehicle=VehicleConfig(source="sim:rover", compasses=(1,)), storage=StorageConfig(folder)
            )
            history = History(Path(folder) / "history.db")
            opened: list[Link] = [self.link]
            station = Station(config, history, lambda: opened[0])
            began = time.monotonic()
            hear = station._hear

            def watching_hear(link: Link, heard: Incoming) -> None:
                before = station.headings
                self._at(station, heard)
                hear(link, heard)
                if station.headings > before:
                    self._heading_published(heard.time_s)

            station._hear = watching_hear  # type: ignore[method-assign]
            computers_clock = clock.now
            clock.now = self._date
            try:
                station.start()
                with contextlib.suppress(KeyboardInterrupt):  # who stops it early has the figures so far
                    self._watch(station)
                station.stop()
            finally:
                clock.now = computers_clock
                fill_disk(None)
            self.figures.headings = station.headings
            self.figures.wall_s = time.monotonic() - began
            self.figures.virtual_s = self.link.now()
            self.figures.recordings = len(list((Path(folder) / "recordings").glob("*")))
            self._judge(history)
            history.close()
        return self.figures

    # --- on the station's thread, in virtual time ---------------------------------------------------

    def _at(self, station: Station, heard: Incoming) -> None:
        """Let happen what is due beside the agenda: a calibration, and what follows a reboot."""
        now_s = heard.time_s
        if self.vehicle.boots != self._seen_boots and heard.component == 1 and heard.system == 1:
            self._seen_boots = self.vehicle.boots
            self._waits()
            self.scene.at(now_s + _READY_AFTER_REBOOT_S, self._rearm)
        if self._is_full and self._task is not None and self._task.finished:
            fill_disk(None)
        if self.calibrations_at and now_s >= self.calibrations_at[0] and not station.desk.busy:
            self.calibrations_at.pop(0)
            self.vehicle.board.consumed_mah = 0.0  # another battery: nobody turns what has none left
            request = CalibrationRequest(motion="vehicle", writing="yes")
            self._note_the_end()
            self._is_full = len(self._ended) in self.full_disks
            before = sum(ended.on_full_disk for ended in self._ended)
            fill_disk(_ROOM[before % len(_ROOM)] if self._is_full else None)
            self._task = station.desk.submit(request, "http", clock.utc_now())

    def _note_the_end(self) -> None:
        if (task := self._task) is not None:
            reports = self.scene.sent.pop(MagCalReport, 0)
            self._ended.append(
                Ended(task.number, task.ok, task.finished, task.entry, task.error, reports, self._is_full)
            )

    def _waits(self) -> None:
        self._waiting_since = self.link.now()

    def _rearm(self) -> None:
        self.vehicle.firmware.modes.enter("GUIDED")  # type: ignore[attr-defined]
        self.vehicle.firmware.arming.arm(forced=True)  # type: ignore[attr-defined]

    def _step_the_clock(self) -> None:
        self.figures.clock_steps += 1
        self._step_s = self._chance.uniform(-_LARGEST_STEP_S, _LARGEST_STEP_S)

    def _heading_published(self, now_s: float) -> None:
        if self._waiting_since is not None:
            self.figures.reconnects += 1
            waited_s = now_s - self._waiting_since
            self.figures.slowest_reconnect_s = max(self.figures.slowest_reconnect_s, waited_s)
            self._waiting_since = None

    def _date(self) -> datetime:
        """Return the date that the service is told: it runs with virtual time, and steps."""
        return _BEGAN + timedelta(seconds=self.link.now() + self._step_s)

    # --- on the main thread -------------------------------------------------------------------------

    def _watch(self, station: Station) -> None:
        compared_s = min(0.2 * self.length_s, _COMPARED_S)
        warm_s = min(0.2 * self.length_s, _WARM_AFTER_S) + compared_s
        lately = max(round(compared_s / _READ_EVERY_S), 1)
        read: list[float] = []
        stalled, last_s = 0, -1.0
        while self.link.now() < self.length_s:
            time.sleep(0.1)
            now_s = self.link.now()
            if now_s > _READ_EVERY_S * (len(read) + 1):
                gc.collect()
                read.append(resident_mb())
                self.figures.end_mb = statistics.median(read[-lately:])
                if not self.figures.warm_mb and now_s > warm_s:
                    self.figures.warm_mb = self.figures.end_mb
            if now_s > 3600.0 * (len(self.figures.hourly_mb) + 1):
                self.figures.hourly_mb.append(round(read[-1], 2))
                with contextlib.suppress(OSError):  # the disk may be full just now
                    print(f"{now_s / 3600.0:6.2f} h {read[-1]:8.2f} MB", file=sys.stderr)
            stalled, last_s = (stalled + 1 if now_s == last_s else 0), now_s
            if stalled > 600:
                self.figures.faults.append(f"the station stood still at {self.link.now():.0f} s")
                return

    def _judge(self, history: History) -> None:
        figures = self.figures
        self._note_the_end()
        ended, entries = self._ended, history.entries("calibration", limit=10_000)
        figures.calibrations = len(ended)
        figures.written = sum(entry.ok for entry in entries)
        figures.interrupted = sum(bool(e.error) for e in ended)
        figures.endings = [e.error or ("written" if e.ok else "not accepted") for e in ended]
        if figures.warm_mb:
            figures.growth_percent = 100.0 * (figures.end_mb / figures.warm_mb - 1.0)
        figures.on_full_disk = sum(e.on_full_disk for e in ended)
        figures.undo_files = sum(entry.undo_file is not None for entry in entries)
        kept = {entry.id for entry in entries}
        lost = [e.number for e in ended if e.entry not in kept and not e.on_full_disk]
        undone = [entry.id for entry in entries if entry.ok and not has_undo(entry)]
        unfinished = [e.number for e in ended if not e.finished]
        untold = [e.number for e in ended if not e.reports]
        least = _LEAST_WRITTEN * (len(ended) - figures.on_full_disk)
        wrong = {
            f"calibrations {lost} are missing in the history": lost,
            f"what entries {undone} wrote cannot be undone": undone,
            f"{figures.recordings} recordings were kept": figures.recordings > _MOST_RECORDINGS,
            f"calibrations {unfinished} never ended": unfinished,
            f"of calibrations {untold} no report was sent": untold,
            f"{figures.written} of {len(ended)} calibrations were written": figures.written < least,
            f"a reconnect took {figures.slowest_reconnect_s:.1f} s": figures.slowest_reconnect_s >= 2.0,
            f"memory grew by {figures.growth_percent:.1f} %": figures.growth_percent > _MOST_GROWTH_PERCENT,
        }
        figures.faults += [words for words, is_so in wrong.items() if is_so]


def fill_disk(room: int | None) -> None:
    """Have the system refuse this process, in every file, what goes beyond so many bytes; None: no more."""
    _, most = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (most if room is None else room, most))


def has_undo(entry: Entry) -> bool:
    """Tell whether the file is there and whole that puts back what a calibration wrote."""
    try:
        return entry.undo_file is not None and bool(load_record(Path(entry.undo_file)).before)
    except UsageError:
        return False


def main() -> int:
    """Run one soak; print its figures."""
    wanted = options(
        __doc__,
        hours=2.0,
        cuts=200,
        reboots=20,
        calibrations=12,
        full_disks=(3, "calibrations during which the disk is full"),
        clock_steps=20,
        seed=1,
    )
    # Also where a shell has its background ignore it.
    signal.signal(signal.SIGINT, signal.default_int_handler)
    given = {name: value for name, value in vars(wanted).items() if name != "json"}
    figures = asdict(Soak(**given).run())
    for name, value in figures.items():
        print(f"{name:22} {value:.2f}" if isinstance(value, float) else f"{name:22} {value}")
    return ended(wanted.json, figures, figures["faults"])


if __name__ == "__main__":
    sys.exit(main())
