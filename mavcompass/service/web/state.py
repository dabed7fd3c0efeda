"""What the service knows, as JSON: the vehicle, the headings, the findings, the task; and as a stream.

Each listener of the WebSocket looks at what the station knows when it is its turn. Nothing is queued, so a
slow listener costs nothing and sees the newest all the same.
"""

from __future__ import annotations

import asyncio
import contextlib
import json
import math
from typing import Any

from starlette.websockets import WebSocket, WebSocketDisconnect

from mavcompass import __version__
from mavcompass.heading.live import Heading
from mavcompass.printable import plain
from mavcompass.service.station import Station
from mavcompass.service.view import VehicleView
from mavcompass.service.watch import COURSE_SPEED_MPS, Finding
from mavcompass.service.work.learning import Lesson
from mavcompass.vehicle.link import LinkStatistics

SCHEMA = "mavcompass.state/1"


def heading_json(heading: Heading) -> dict[str, Any]:
    """Describe one heading; the level field is what a page draws the circle from."""
    forward, right, down = heading.level_mgauss
    return {
        "instance": heading.instance,
        "boot_s": round(heading.boot_s, 4),
        "magnetic_deg": round(math.degrees(heading.magnetic_rad), 2),
        "true_deg": None if heading.true_rad is None else round(math.degrees(heading.true_rad), 2),
        "sigma_deg": round(math.degrees(heading.sigma_rad), 2),
        "true_sigma_deg": None
        if heading.true_sigma_rad is None
        else round(math.degrees(heading.true_sigma_rad), 2),
        "level_mgauss": [round(forward, 1), round(right, 1), round(down, 1)],
    }


def moment_json(station: Station) -> dict[str, Any]:
    """Describe what changes quickly: headings, tilt, turned angle, and the course where it moves."""
    view = station.view
    if view is None:
        return {"connected": False, "headings": [], "turned_deg": 0.0, "rate_dps": 0.0, "still": False}
    level, (course_rad, speed_mps) = view.level, view.over_ground
    moves = speed_mps > COURSE_SPEED_MPS
    headings = [c.latest for c in list(view.compasses.values()) if c.latest is not None]
    return {
        "connected": station.connected,
        "headings": [heading_json(heading) for heading in headings],
        "turned_deg": round(math.degrees(level.turned_rad), 1),
        "rate_dps": round(math.degrees(level.rate_radps), 1),
        "roll_deg": round(math.degrees(level.roll_rad), 1),
        "pitch_deg": round(math.degrees(level.pitch_rad), 1),
        "still": abs(level.rate_radps) < 0.02,
        "course_deg": None if course_rad is None or not moves else round(math.degrees(course_rad) % 360.0, 1),
    }


def state_json(station: Station) -> dict[str, Any]:
    """Describe everything."""
    task = station.desk.current
    return {
        "schema": SCHEMA,
        "version": __version__,
        "link": _link_json(station),
        "vehicle": None if station.view is None else _vehicle_json(station.view),
        "world": None if station.view is None else _world_json(station.view),
        "now": moment_json(station),
        "findings": [finding_json(finding) for finding in station.findings],
        "learning": [_lesson_json(station, lesson) for lesson in list(station.learning.lessons.values())],
        "task": None if task is None else task.to_json(),
    }


def _lesson_json(station: Station, lesson: Lesson) -> dict[str, Any]:
    """Describe what was learnt of a compass: old against new, how sure, and what it has not seen yet."""
    result, margin_deg = lesson.result, station.config.learning.margin_deg
    return {
        "compass": result.instance,
        "margin_deg": margin_deg,
        "offered": result in station.learning.offers(),
        "sigma_deg": plain(result.heading_sigma_deg),
        "in_force_error_deg": plain(result.heading_change_deg),
        "not_seen_deg": list(result.not_seen_deg),
        "iron_changed_at": None
        if lesson.changed_at is None
        else lesson.changed_at.isoformat(timespec="seconds"),
        "reasons": list(result.reasons),
        "parameters": {name: plain(value) for name, value in result.parameters.items()},
    }


def finding_json(finding: Finding) -> dict[str, Any]:
    """Describe one finding."""
    return {
        "id": finding.id,
        "compass": finding.instance,
        "severity": finding.severity,
        "text": finding.text,
        "remedy": finding.remedy,
        "method": finding.method or None,
        "value": plain(finding.value),
        "limit": plain(finding.limit),
    }


def _link_json(station: Station) -> dict[str, Any]:
    link, view = station.link, station.view
    counts = LinkStatistics() if link is None else link.statistics
    silent_s = None if link is None or view is None else plain(link.now() - view.heard_s)
    return {
        "source": station.config.vehicle.source,
        "open": link is not None,
        "connected": station.connected,
        "error": station.link_error,
        "silent_s": silent_s if silent_s is None else round(silent_s, 3),
        "reconnects": 0 if view is None else view.reconnects,
        "reboots": 0 if view is None else view.reboots,
        "received": counts.received,
        "lost": counts.lost,
        "malformed": counts.malformed,
        "dropped": counts.dropped,
    }


def _vehicle_json(view: VehicleView) -> dict[str, Any]:
    return {
        "key": view.key,
        "system": view.identity.system,
        "autopilot": view.identity.autopilot,
        "kind": view.identity.kind,
        "armed": view.state.armed,
        "mode": view.state.mode,
        "boot_s": plain(view.boot_s),
        "compasses": [
            {
                "instance": instance,
                "device_id": view.device_id(instance),
                "calibration_sigma_deg": _sigma_deg(view, instance),
                "true_north": _north_json(view, instance),
            }
            for instance in view.instances()
        ],
        "texts": list(view.state.texts)[-5:],
    }


def _sigma_deg(view: VehicleView, instance: int) -> float | None:
    compass = view.compasses.get(instance)
    return None if compass is None else round(math.degrees(compass.calibration_sigma_rad), 2)


def _north_json(view: VehicleView, instance: int) -> dict[str, Any] | None:
    compass = view.compasses.get(instance)
    return None if compass is None or compass.north is None else compass.north.to_json()


def _world_json(view: VehicleView) -> dict[str, Any] | None:
    world = view.world
    if world is None:
        return None
    return {
        "horizontal_mgauss": round(world.horizontal_mgauss, 1),
        "total_mgauss": round(world.total_mgauss, 1),
        "dip_deg": round(math.degrees(world.inclination_rad), 2),
        "declination_deg": round(math.degrees(world.declination_rad), 2),
    }


DEFAULT_HZ, MOST_HZ = 10.0, 20.0
# What listeners say is dropped; none needs more for it.
MOST_HEARD_BYTES = 4096


async def stream(station: Station, socket: WebSocket) -> None:
    """Send `now` and what a run's trail has grown by at the listener's rate, the rest as it changes."""
    rate_hz = sensible_rate_hz(socket.query_params.get("rate_hz"))
    with contextlib.suppress(WebSocketDisconnect):
        await socket.accept()
        goodbye = asyncio.ensure_future(_until_gone(socket))
        try:
            await _send(station, socket, 1.0 / rate_hz, goodbye)
        finally:
            goodbye.cancel()


async def _send(station: Station, socket: WebSocket, period_s: float, goodbye: asyncio.Future[None]) -> None:
    seen: dict[str, Any] = {}
    drawn: dict[int, dict[int, int]] = {}  # by task and compass: the points that were sent
    while not goodbye.done():
        message: dict[str, Any] = {"now": moment_json(station)}
        task = station.desk.current
        news = {
            "task": None if task is None else task.to_json(),
            "findings": [finding_json(finding) for finding in station.findings],
        }
        message |= {key: value for key, value in news.items() if seen.get(key, ...) != value}
        seen = news
        if task is not None and task.trail.points:
            known = drawn.setdefault(task.number, {})
            message["trail"] = {"task": task.number, **task.trail.since(known)}
            for instance, trail in message["trail"]["compasses"].items():
                known[instance] = trail["first"] + len(trail["points"])
        await socket.send_text(json.dumps(message))
        await asyncio.wait([goodbye], timeout=period_s)


async def _until_gone(socket: WebSocket) -> None:
    """Read and drop what a listener says until it leaves."""
    try:
        while True:
            await socket.receive_text()
    except (WebSocketDisconnect, KeyError, RuntimeError):
        return


def sensible_rate_hz(text: str | None) -> float:
    """Return the rate that a listener asked for, within limits; the usual one where that is no number."""
    try:
        rate_hz = float(text or DEFAULT_HZ)
    except ValueError:
        return DEFAULT_HZ
    return min(max(rate_hz, 0.1), MOST_HZ) if rate_hz == rate_hz else DEFAULT_HZ
