"""The station: the thread that owns the link and does everything that has to do with the vehicle.

It hears, publishes headings, watches the compass, answers ground stations, keeps the message rates and
runs one procedure at a time. Other threads hand it requests through `desk` and read what it knows.
"""

from __future__ import annotations

import logging
import math
import socket
import threading
import time
from collections.abc import Callable

from mavcompass import messages as mav
from mavcompass.earth_field import decimal_year
from mavcompass.errors import MavCompassError
from mavcompass.heading.live import Heading
from mavcompass.messages import Incoming
from mavcompass.procedure.vehicle_state import RollCall, VehicleIdentity, several
from mavcompass.service.config import ServiceConfig, split_host_port
from mavcompass.service.mavlink.component import GroundStationReporter
from mavcompass.service.mavlink.rates import RateKeeper
from mavcompass.service.view import GONE_S, VehicleView
from mavcompass.service.watch import CompassWatch, Finding
from mavcompass.service.work import clock
from mavcompass.service.work.clock import Schedule
from mavcompass.service.work.history import History
from mavcompass.service.work.jobs import Jobs
from mavcompass.service.work.learning import Learning
from mavcompass.service.work.tasks import Desk
from mavcompass.two_clocks import shared_id
from mavcompass.vehicle.link import Link
from mavcompass.vehicle.stopping import StopRequest

_log = logging.getLogger(__name__)

_TEND_EVERY_S = 0.05
_LOOK_EVERY_S = 0.1
_HEARTBEAT_EVERY_S = 1.0
_MEET_AGAIN_S = 10.0
_JUDGE_EVERY_S = 60.0
_REOPEN_S = 0.5
_PATIENCE_S = 15.0
# More than this computer reads has to come for so long to be told.
_FLOODED_S = 5.0
_DEG = 180.0 / math.pi

OpenLink = Callable[[], Link]


class Station:
    """Serve one vehicle on one link.

    Attributes:
        desk: takes requests. view: what is known of the vehicle, None before its first heartbeat.
        stale: findings from parameters and history. link_error: why the link is not open, or "".
        beat: counts up while the thread is alive, for the watchdog. headings: published so far.
    """

    def __init__(self, config: ServiceConfig, history: History, open_link: OpenLink) -> None:
        self.config = config
        self.desk = Desk()
        self.watch = CompassWatch(config.watch)
        self.learning = Learning(config.learning)
        self.view: VehicleView | None = None
        self.stale: tuple[Finding, ...] = ()
        self.link: Link | None = None
        self.link_error = ""
        self.beat = 0
        self.headings = 0
        self._open_link = open_link
        self._due = Schedule()
        self._roll = RollCall()
        self._ground_stations = GroundStationReporter(config, self.desk, self._due)
        self._jobs = Jobs(config, history, self.learning, self._hear_in_procedure)
        self._rates = RateKeeper({})
        self._publisher = HeadingPublisher(config.heading.publish) if config.heading.publish else None
        self._ending = StopRequest()
        self._thread = threading.Thread(target=self._run, name="station", daemon=True)

    # --- for other threads --------------------------------------------------------------------------

    def start(self) -> None:
        """Open the link and begin."""
        self._thread.start()

    def stop(self) -> bool:
        """End: a procedure is stopped safely first. False where the thread did not end in time."""
        self.desk.close("The service is stopping.")
        self._ending.reason = "The service is stopping."
        self._thread.join(_PATIENCE_S)
        self.learning.close()
        if self._publisher is not None:
            self._publisher.close()
        return not self._thread.is_alive()

    @property
    def connected(self) -> bool:
        """Tell whether the vehicle was heard lately."""
        view, link = self.view, self.link
        return view is not None and link is not None and link.now() - view.heard_s < GONE_S

    @property
    def findings(self) -> tuple[Finding, ...]:
        """Return what is wrong with the compasses or their link, the bad first."""
        all_of_them = (*self.watch.findings, *self.stale, *self.learning.findings, *_about(self.link))
        return tuple(sorted(all_of_them, key=lambda finding: finding.severity != "bad"))

    # --- the thread ---------------------------------------------------------------------------------

    def _run(self) -> None:
        told = ""
        while self._ending.reason is None:
            try:
                with self._open_link() as link:
                    self.link, self.link_error = link, ""
                    self._live(link)
            except MavCompassError as error:
                if (again := str(error)) != told:
                    _log.warning("%s", error)
                told = self.link_error = again
            except Exception:
                self.link_error = "An unexpected error; see the service's log."
                _log.exception("unexpected error on the link; opening it again")
            self.link = None
            self.beat += 1
            if self._ending.reason is None:
                time.sleep(_REOPEN_S)

    def _live(self, link: Link) -> None:
        """Do all the work on an open link until it is lost or the service ends."""
        self._due.clear()
        self._roll = RollCall(self.config.vehicle.system or None)
        if self.view is not None:
            link.identity = link.identity.aboard(self.view.identity.system)
        while self._ending.reason is None:
            task = self.desk.take()
            if task is not None:
                self._jobs.work(link, self.view, task)
                self._after_work()
            now_s = link.now()
            incoming = link.receive(max(self._due.next_s("tend", now_s, _TEND_EVERY_S) - now_s, 0.0))
            if incoming is not None:
                self._hear(link, incoming)
            self._tend(link, idle=True)
        if self.view is not None:
            for request in self._rates.goodbye(self.view.identity.system):
                link.send(request)

    def _after_work(self) -> None:
        """Read the parameters again, which may have changed, and judge the compass anew."""
        self.watch.restart()
        self.learning.restart()
        self._due.hurry("meet")

    def _hear_in_procedure(self, link: Link, heard: Incoming) -> None:
        self._hear(link, heard)
        self._tend(link, idle=False)

    def _hear(self, link: Link, heard: Incoming) -> None:
        """Take one message, whoever sent it."""
        view = self.view
        if view is None or not view.is_from(heard):
            self._hear_other(link, heard)
            return
        if heard.time_s - view.heard_s > GONE_S:
            view.reconnects += 1
            view.level.restart()
            self.learning.restart()
            self._vehicle_is_back()
        if view.restarted(heard.message):
            _log.warning("the vehicle was restarted")
            view.restart()
            self.watch.restart()
            self.learning.restart()
            self._vehicle_is_back()
        self._rates.count(type(heard.message))
        heading = view.hear(heard)
        self.learning.hear(view, heard)
        if heading is not None:
            self.headings += 1
            if self._publisher is not None:
                self._publisher.publish(heading)
            if self._jobs.task is not None:
                self._jobs.task.trail.add(heading, view.level.turned_rad)
        if self._jobs.recorder is not None:
            self._jobs.recorder.add(heard)

    def _hear_other(self, link: Link, heard: Incoming) -> None:
        """Take a message of anybody but the vehicle: a command, or the vehicle's first heartbeat."""
        offered = [result.instance for result in self.learning.offers()]
        self._ground_stations.hear_command(link, self.view, heard, offered)
        if self.view is not None:
            return
        self._roll.hear(heard)
        if not self._roll.found or heard.time_s < self._roll.complete_s():
            return
        roll, self._roll = self._roll, RollCall(self.config.vehicle.system or None)
        if len(roll.found) > 1:
            raise several(roll.in_words())
        ((found, _),) = roll.found.values()
        _log.info("found %s %s, system %d", found.autopilot, found.kind, found.system)
        link.identity = link.identity.aboard(found.system)
        year = round(decimal_year(clock.now().timestamp()), 2)
        self.view = VehicleView(found, f"{found.autopilot}-system-{found.system}", year, heard_s=heard.time_s)
        if self.view.is_from(heard):
            self.view.hear(heard)
        self._rates = RateKeeper(_wanted_rates(found, self.config.vehicle.rate_hz))

    def _vehicle_is_back(self) -> None:
        self._rates.vehicle_is_back()
        self._due.hurry("meet")

    def _tend(self, link: Link, idle: bool) -> None:
        """Do what is due; `idle` while no procedure runs, which speaks for itself then."""
        now_s = link.now()
        if not self._due.is_due("tend", now_s, _TEND_EVERY_S):
            return
        self.beat += 1
        if idle and self._due.is_due("heartbeat", now_s, _HEARTBEAT_EVERY_S):
            link.send(link.identity.heartbeat())
        view = self.view
        if view is None:
            return
        if self._due.is_due("look", now_s, _LOOK_EVERY_S):
            self.watch.update(view.glance(now_s))
        self._ground_stations.tell(link, view, self.findings, now_s)
        if not idle or now_s - view.heard_s > GONE_S:
            return
        for request in self._rates.due(now_s, view.identity.system):
            link.send(request)
        if not view.fresh:
            # A request that waits comes first: it reads the parameters itself.
            if not self.desk.busy and self._due.is_due("meet", now_s, _MEET_AGAIN_S):
                self._jobs.meet(link, view, self._ending)
                self._due.hurry("judge")
        elif self._due.is_due("judge", now_s, _JUDGE_EVERY_S):
            self.stale = self._jobs.judge_calibrations(view)
        else:
            self.learning.tend(view)


def _about(link: Link | None) -> tuple[Finding, ...]:
    """Say what is wrong with what comes: more than can be read, or from two with one system id."""
    if link is not None and link.statistics.shared:
        what, remedy = shared_id(min(link.statistics.shared))
        return (Finding("link", 0, "bad", "Compass: two autopilots share a system id", what, remedy),)
    if link is None or link.behind_s() < _FLOODED_S:
        return ()
    text = f"More messages come on {link.name} than this computer can read: what they tell is late or lost."
    remedy = (
        "Lower the rates of the vehicle's messages (SRn_*, MAV_n_RATE), or end what else keeps this"
        " computer busy."
    )
    return (Finding("link", 0, "warning", "Compass: more messages than can be read", text, remedy),)


def _wanted_rates(identity: VehicleIdentity, rate_hz: float) -> dict[type[mav.Message], float]:
    """List the messages that the service wants, at their rates."""
    slow_hz = min(rate_hz, 10.0)
    return {
        mav.ScaledImu if identity.autopilot == "px4" else mav.RawImu: rate_hz,
        mav.ScaledImu2: slow_hz,
        mav.ScaledImu3: slow_hz,
        mav.Attitude: slow_hz,
        mav.GlobalPositionInt: 2.0,
        mav.GpsRawInt: 5.0,
        mav.SysStatus: 2.0,
        mav.SystemTime: 1.0,
        **({mav.ExtendedSysState: 1.0} if identity.kind == "plane" else {}),
    }


class HeadingPublisher:
    """Send every heading to other programs here, one JSON datagram each; nobody needs to listen."""

    def __init__(self, address: str) -> None:
        """Take "udp:HOST:PORT"; raises OSError for an unknown host."""
        host, port = split_host_port(address.removeprefix("udp:"))
        family, kind, _, _, target = socket.getaddrinfo(host, port, type=socket.SOCK_DGRAM)[0]
        self._socket = socket.socket(family, kind)
        self._socket.setblocking(False)
        self._target = target

    def publish(self, heading: Heading) -> None:
        """Send one heading; what cannot be sent is left."""
        try:
            self._socket.sendto(datagram(heading), self._target)
        except OSError:
            pass  # nobody listens, or the buffer is full: the next one comes soon

    def close(self) -> None:
        """Close the socket."""
        self._socket.close()


def datagram(heading: Heading) -> bytes:
    """Write a heading as JSON; degrees, the vehicle's clock in seconds."""
    true, true_sigma = (
        "null" if angle is None else f"{angle * _DEG:.3f}"
        for angle in (heading.true_rad, heading.true_sigma_rad)
    )
    return (
        f'{{"boot_s":{heading.boot_s:.6f},"compass":{heading.instance},'
        f'"magnetic_deg":{heading.magnetic_rad * _DEG:.3f},"true_deg":{true},'
        f'"sigma_deg":{heading.sigma_rad * _DEG:.3f},"true_sigma_deg":{true_sigma}}}'
    ).encode()
