"""Who the vehicle is and how it is: found by its heartbeat, kept up to date by what it says."""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Sequence
from dataclasses import dataclass, field, replace

from mavcompass import messages as mav
from mavcompass.earth_field import EarthField, decimal_year, earth_field
from mavcompass.enums import MavCmd, MavModeFlag, MavVtolState
from mavcompass.errors import NoVehicle, Refused, UsageError
from mavcompass.kinds import AUTOPILOTS, VEHICLES, Kind
from mavcompass.messages import telemetry
from mavcompass.printable import printable
from mavcompass.procedure.nameplate import read_nameplate
from mavcompass.procedure.script import Context, Script, expect
from mavcompass.two_clocks import shared_id

_M_PER_DEG = 111_319.5
# Clocks that were never set begin at zero, or at a date of their firmware.
_NOT_DATED_US = 1_400_000_000_000_000
# Autopilots beat once a second: within this time after the first the others beat, unless that is lost.
OTHERS_WITHIN_S = 1.5
# How a plane flies is told at once where it is known, and asked for twice: a message may be lost.
_ASKED_TWICE, _TOLD_WITHIN_S = 2, 1.0


@dataclass(frozen=True, slots=True)
class VehicleIdentity:
    """Name a vehicle: its MAVLink address, autopilot ("ardupilot", "px4") and kind."""

    system: int
    component: int
    autopilot: str
    kind: Kind

    def __str__(self) -> str:
        """Return it as people write it."""
        return f"{_MAKES.get(self.autopilot, self.autopilot)} {self.kind}, system {self.system}"


_MAKES = {"ardupilot": "ArduPilot", "px4": "PX4"}


def identify(heard: mav.Incoming) -> VehicleIdentity | None:
    """Recognise an autopilot's heartbeat; None for ground stations, cameras, radios and the rest."""
    beat = heard.message
    if not isinstance(beat, mav.Heartbeat):
        return None
    autopilot = AUTOPILOTS.get(beat.autopilot)
    if autopilot is None:
        return None
    return VehicleIdentity(heard.system, heard.component, autopilot, VEHICLES.get(beat.type, "unknown"))


@dataclass(slots=True)
class RollCall:
    """Collect the autopilots that beat on a link, by system id, with their latest heartbeats.

    Heartbeats of ground stations and peripherals are routed onto every link, so the first one heard need not
    be a vehicle's. `wanted` picks one of several vehicles.
    """

    wanted: int | None = None
    found: dict[int, tuple[VehicleIdentity, mav.Heartbeat]] = field(default_factory=dict)
    first_s: float = math.inf

    def hear(self, heard: mav.Incoming) -> None:
        """Take a message, whoever sent it. Raises Refused where two autopilots beat with one system id."""
        found, beat = identify(heard), heard.message
        if found is None or self.wanted not in (None, found.system):
            return
        assert isinstance(beat, mav.Heartbeat)
        before = self.found.setdefault(found.system, (found, beat))[0]
        if before.component == found.component:
            if before != found:
                raise Refused(*shared_id(found.system))
            self.found[found.system] = found, beat
        self.first_s = min(self.first_s, heard.time_s)

    def complete_s(self, others_within_s: float = OTHERS_WITHIN_S) -> float:
        """Return when all were heard: at once where one is wanted, else when the others had time to beat."""
        return self.first_s + (others_within_s if self.wanted is None else 0.0)

    def in_words(self) -> tuple[str, ...]:
        """Describe each that was found in a line."""
        return tuple(
            f"system {system}: {identity.kind}, {identity.autopilot},"
            f" {'armed' if beat.base_mode & MavModeFlag.SAFETY_ARMED else 'disarmed'}"
            for system, (identity, beat) in sorted(self.found.items())
        )


def several(lines: tuple[str, ...]) -> UsageError:
    """Say that several vehicles are on a link, one a line, and that one must be chosen."""
    return UsageError(f"{len(lines)} vehicles are on this link:", "Choose one with --system.", lines)


def find_vehicle(
    context: Context, system: int | None = None, timeout_s: float = 10.0
) -> Script[VehicleIdentity]:
    """Wait for the heartbeat of an autopilot and talk to that one from now on.

    `system` picks one of several vehicles. Raises NoVehicle when none was heard in time, UsageError with a
    list where several were and none is picked, Refused where two share a system id.
    """
    roll = yield from _call(context, system, timeout_s, OTHERS_WITHIN_S)
    if len(roll.found) == 1:
        ((identity, _),) = roll.found.values()
        context.system, context.component = identity.system, identity.component
        context.alone = system is None
        return (yield from _as_it_flies(context, identity))
    lines = []
    for line, number in zip(roll.in_words(), sorted(roll.found), strict=True):
        identity = roll.found[number][0]
        context.system, context.component = number, identity.component
        plate = yield from read_nameplate(context, identity.autopilot, ())
        lines.append(f"{line}, {f'unique id {plate.uid}' if plate.uid else 'without a unique id'}")
    context.system = context.component = 0
    raise several(tuple(lines))


def _as_it_flies(context: Context, identity: VehicleIdentity) -> Script[VehicleIdentity]:
    """Ask a plane whether its rotors hold it now; its heartbeat tells neither that nor that they could."""
    if identity.kind != "plane":
        return identity
    number = mav.message_id(mav.ExtendedSysState)
    for _ in range(_ASKED_TWICE):
        context.command(MavCmd.REQUEST_MESSAGE, number)
        told = yield from expect(context, mav.ExtendedSysState, timeout_s=_TOLD_WITHIN_S)
        if told is not None:
            return replace(identity, kind=kind_now(identity.kind, told))
    return identity


def kind_now(kind: Kind, told: mav.ExtendedSysState | None) -> Kind:
    """Return what a vehicle is as it flies: a plane that its rotors hold is a vtol."""
    held = told is not None and told.vtol_state == MavVtolState.MC
    return "vtol" if kind == "plane" and held else kind


def find_vehicles(
    context: Context, timeout_s: float = 10.0, others_within_s: float = 3.0
) -> Script[tuple[VehicleIdentity, ...]]:
    """Wait for the heartbeats of all autopilots on the link, in the order of their system ids.

    They beat once a second: `others_within_s` after the first one, all were heard, though one or two were
    lost. Raises NoVehicle, or Refused where two share a system id.
    """
    roll = yield from _call(context, None, timeout_s, others_within_s)
    return tuple(roll.found[system][0] for system in sorted(roll.found))


def _call(context: Context, system: int | None, timeout_s: float, others_within_s: float) -> Script[RollCall]:
    """Hear who beats. Raises NoVehicle where nobody does in time."""
    roll, others, give_up_s = RollCall(system), 0, context.now + timeout_s
    while context.now < (end_s := roll.complete_s(others_within_s) if roll.found else give_up_s):
        event = yield end_s
        if isinstance(event, mav.Incoming):
            roll.hear(event)
            others += 1
    if roll.found:
        return roll
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


def metres_from(start: mav.GlobalPositionInt, place: mav.GlobalPositionInt) -> tuple[float, float]:
    """Return how far north and east of a start a near place is, metres."""
    return metres_apart((start.lat * 1e-7, start.lon * 1e-7), (place.lat * 1e-7, place.lon * 1e-7))


def metres_apart(start_deg: Sequence[float], place_deg: Sequence[float]) -> tuple[float, float]:
    """Return the same of latitudes and longitudes, degrees; what stands behind them does not count."""
    east_deg = (place_deg[1] - start_deg[1] + 180.0) % 360.0 - 180.0  # the date line may lie between
    east_m = east_deg * _M_PER_DEG * math.cos(math.radians(start_deg[0]))
    return (place_deg[0] - start_deg[0]) * _M_PER_DEG, east_m


def _on_earth(told: mav.GlobalPositionInt | mav.GpsRawInt) -> bool:
    return abs(told.lat) <= 900_000_000 >= abs(told.lon) // 2


# Where the latest of a message is kept, whatever is in it.
_KEPT: dict[type[mav.Message], str] = {
    mav.Heartbeat: "heartbeat",
    mav.EkfStatusReport: "ekf",
    mav.EstimatorStatus: "estimator",
    mav.SysStatus: "battery",
    mav.RcChannels: "sticks",
    mav.ExtendedSysState: "landed",
    mav.FenceStatus: "fence",
    mav.GpsRawInt: "gps",
    mav.SystemTime: "utc",
}


@dataclass(slots=True)
class VehicleState:
    """Keep the latest of what the vehicle says of itself; `hear` is a listener of a Context.

    `reporting` are the compasses that a field was heard of; what has no compass reports zeros.
    """

    heard_s: float = float("-inf")
    heartbeat: mav.Heartbeat | None = None
    attitude: mav.Attitude | None = None
    place: mav.GlobalPositionInt | None = None
    local: mav.LocalPositionNed | None = None
    ekf: mav.EkfStatusReport | None = None
    estimator: mav.EstimatorStatus | None = None
    battery: mav.SysStatus | None = None
    sticks: mav.RcChannels | None = None
    landed: mav.ExtendedSysState | None = None
    fence: mav.FenceStatus | None = None
    gps: mav.GpsRawInt | None = None
    utc: mav.SystemTime | None = None
    reporting: set[int] = field(default_factory=set)
    texts: deque[str] = field(default_factory=lambda: deque(maxlen=20))
    _texts_s: deque[float] = field(default_factory=lambda: deque(maxlen=20))

    def hear(self, heard: mav.Incoming) -> None:
        """Take one message of the vehicle."""
        self.heard_s = heard.time_s
        message = heard.message
        match message:
            case mav.RawImu() | mav.ScaledImu():
                if message.xmag or message.ymag or message.zmag:
                    self.reporting.add(telemetry.MAG_MESSAGES[message.wire_name()])
            case mav.Attitude(roll=roll, pitch=pitch) if math.isfinite(roll) and math.isfinite(pitch):
                self.attitude = message
            case mav.GlobalPositionInt() if _on_earth(message):
                self.place = message
            case mav.LocalPositionNed(x=x, y=y, z=z) if all(map(math.isfinite, (x, y, z))):
                self.local = message
            case mav.Statustext():
                begun = ""
                if message.chunk_seq and self.texts:
                    begun, _ = self.texts.pop(), self._texts_s.pop()
                self.texts.append(begun + printable(message.text.rstrip("\t")))  # PX4's mark of an event
                self._texts_s.append(heard.time_s)
            case _ if (name := _KEPT.get(type(message))) is not None:
                setattr(self, name, message)

    def said_since(self, time_s: float) -> list[str]:
        """List what it said from a time on, the earliest first."""
        return [text for text, heard_s in zip(self.texts, self._texts_s, strict=True) if heard_s >= time_s]

    @property
    def armed(self) -> bool:
        """Tell whether the motors are armed; False while no heartbeat was heard."""
        return self.heartbeat is not None and bool(self.heartbeat.base_mode & MavModeFlag.SAFETY_ARMED)

    @property
    def mode(self) -> int:
        """Return the autopilot's own number of its mode, -1 while none is known."""
        return -1 if self.heartbeat is None else self.heartbeat.custom_mode

    @property
    def speed_mps(self) -> float:
        """Return how fast it moves over the ground; 0 while it does not know its place."""
        return 0.0 if self.place is None else 0.01 * math.hypot(self.place.vx, self.place.vy)

    @property
    def where(self) -> tuple[float, float, float] | None:
        """Return latitude and longitude, degrees, and altitude, metres; None where that is not known.

        The receiver's place counts where the estimator tells none: PX4's does not before it has a yaw.
        """
        place: mav.GlobalPositionInt | mav.GpsRawInt | None = self.place
        gps = self.gps
        if place is None and gps is not None and gps.fix_type >= telemetry.FIX_3D and _on_earth(gps):
            place = gps
        if place is None or not (place.lat or place.lon):
            return None
        return place.lat * 1e-7, place.lon * 1e-7, place.alt * 1e-3

    def world(self, year: float) -> EarthField | None:
        """Return the Earth's field at the vehicle, None where it does not know its place.

        `year` (decimal) is used where it does not know the date.
        """
        where, utc = self.where, self.utc
        if where is None:
            return None
        if utc is not None and utc.time_unix_usec > _NOT_DATED_US:
            year = decimal_year(utc.time_unix_usec * 1e-6)
        return earth_field(round(where[0], 2), round(where[1], 2), where[2], round(year, 2))
