"""Who the vehicle is and how it is: found by its heartbeat, kept up to date by what it says."""

from __future__ import annotations

import math
from collections import deque
from dataclasses import dataclass, field

from mavcompass import messages as mav
from mavcompass.earth_field import EarthField, decimal_year, earth_field
from mavcompass.enums import MavModeFlag
from mavcompass.errors import NoVehicle
from mavcompass.kinds import AUTOPILOTS, VEHICLES, Kind
from mavcompass.printable import printable
from mavcompass.procedure.script import Context, Script

_M_PER_DEG = 111_319.5
# Clocks that were never set begin at zero, or at a date of their firmware.
_NOT_DATED_US = 1_400_000_000_000_000


@dataclass(frozen=True, slots=True)
class VehicleIdentity:
    """Name a vehicle: its MAVLink address, autopilot ("ardupilot", "px4") and kind."""

    system: int
    component: int
    autopilot: str
    kind: Kind


def identify(heard: mav.Incoming) -> VehicleIdentity | None:
    """Recognise an autopilot's heartbeat; None for ground stations, cameras, radios and the rest."""
    beat = heard.message
    if not isinstance(beat, mav.Heartbeat):
        return None
    autopilot = AUTOPILOTS.get(beat.autopilot)
    if autopilot is None:
        return None
    return VehicleIdentity(heard.system, heard.component, autopilot, VEHICLES.get(beat.type, "unknown"))


def find_vehicle(
    context: Context, system: int | None = None, timeout_s: float = 10.0
) -> Script[VehicleIdentity]:
    """Wait for the heartbeat of an autopilot and talk to that one from now on.

    Heartbeats of ground stations and peripherals are routed onto every link, so the first one heard
    need not be the vehicle's. `system` picks one of several vehicles.
    Raises NoVehicle when none was heard in time.
    """
    end = context.now + timeout_s
    others = 0
    while context.now < end:
        event = yield end
        if not isinstance(event, mav.Incoming):
            continue
        found = identify(event)
        if found is not None and system in (None, found.system):
            context.system, context.component = found.system, found.component
            return found
        others += 1
    if others:
        raise NoVehicle(
            f"{others} messages were heard, but no heartbeat of an ArduPilot or PX4 autopilot"
            + (f" with system id {system}." if system is not None else "."),
            "Check that the autopilot itself is connected to this link, not only a ground station.",
        )
    raise NoVehicle(
        f"Nothing was heard in {timeout_s:.0f} s.",
        "Check the address, the cable and the power, and that no other program holds the port.",
    )


def find_vehicles(
    context: Context, timeout_s: float = 10.0, others_within_s: float = 3.0
) -> Script[tuple[VehicleIdentity, ...]]:
    """Wait for the heartbeats of all autopilots on the link, in the order of their system ids.

    They beat once a second: `others_within_s` after the first one, all were heard. Raises NoVehicle.
    """
    found = {(first := (yield from find_vehicle(context, None, timeout_s))).system: first}
    end = context.now + others_within_s
    while context.now < end:
        event = yield end
        if isinstance(event, mav.Incoming) and (other := identify(event)) is not None:
            found.setdefault(other.system, other)
    return tuple(found[system] for system in sorted(found))


def metres_from(start: mav.GlobalPositionInt, place: mav.GlobalPositionInt) -> tuple[float, float]:
    """Return how far north and east of a start a near place is, metres."""
    east_deg = ((place.lon - start.lon) * 1e-7 + 180.0) % 360.0 - 180.0  # the date line may lie between
    east_m = east_deg * _M_PER_DEG * math.cos(math.radians(start.lat * 1e-7))
    return (place.lat - start.lat) * 1e-7 * _M_PER_DEG, east_m


@dataclass(slots=True)
class VehicleState:
    """Keep the latest of what the vehicle says of itself; `hear` is a listener of a Context."""

    heard_s: float = float("-inf")
    heartbeat: mav.Heartbeat | None = None
    attitude: mav.Attitude | None = None
    place: mav.GlobalPositionInt | None = None
    local: mav.LocalPositionNed | None = None
    ekf: mav.EkfStatusReport | None = None
    battery: mav.SysStatus | None = None
    sticks: mav.RcChannels | None = None
    landed: mav.ExtendedSysState | None = None
    fence: mav.FenceStatus | None = None
    gps: mav.GpsRawInt | None = None
    utc: mav.SystemTime | None = None
    texts: deque[str] = field(default_factory=lambda: deque(maxlen=20))

    def hear(self, heard: mav.Incoming) -> None:
        """Take one message of the vehicle."""
        self.heard_s = heard.time_s
        message = heard.message
        match message:
            case mav.Heartbeat():
                self.heartbeat = message
            case mav.Attitude(roll=roll, pitch=pitch) if math.isfinite(roll) and math.isfinite(pitch):
                self.attitude = message
            case mav.GlobalPositionInt(lat=lat, lon=lon) if abs(lat) <= 900_000_000 >= abs(lon) // 2:
                self.place = message
            case mav.LocalPositionNed(x=x, y=y, z=z) if all(map(math.isfinite, (x, y, z))):
                self.local = message
            case mav.EkfStatusReport():
                self.ekf = message
            case mav.SysStatus():
                self.battery = message
            case mav.RcChannels():
                self.sticks = message
            case mav.ExtendedSysState():
                self.landed = message
            case mav.FenceStatus():
                self.fence = message
            case mav.GpsRawInt():
                self.gps = message
            case mav.SystemTime():
                self.utc = message
            case mav.Statustext():
                self.texts.append(printable(message.text))

    @property
    def armed(self) -> bool:
        """Tell whether the motors are armed; False while no heartbeat was heard."""
        return self.heartbeat is not None and bool(self.heartbeat.base_mode & MavModeFlag.SAFETY_ARMED)

    @property
    def mode(self) -> int:
        """Return the autopilot's own number of its mode, -1 while none is known."""
        return -1 if self.heartbeat is None else self.heartbeat.custom_mode

    def world(self, year: float) -> EarthField | None:
        """Return the Earth's field at the vehicle, None where it does not know its place.

        `year` (decimal) is used where it does not know the date.
        """
        place, utc = self.place, self.utc
        if place is None or not (place.lat or place.lon):
            return None
        if utc is not None and utc.time_unix_usec > _NOT_DATED_US:
            year = decimal_year(utc.time_unix_usec * 1e-6)
        lat_deg, lon_deg = round(place.lat * 1e-7, 2), round(place.lon * 1e-7, 2)
        return earth_field(lat_deg, lon_deg, place.alt * 1e-3, round(year, 2))
