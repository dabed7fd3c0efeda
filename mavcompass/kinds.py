"""Our names for MAVLink's kinds of autopilots and vehicles."""

from __future__ import annotations

from typing import Literal

from mavcompass.enums import MavAutopilot, MavType

Kind = Literal["rover", "boat", "copter", "sub", "plane", "vtol", "unknown"]

AUTOPILOTS: dict[int, str] = {MavAutopilot.ARDUPILOTMEGA: "ardupilot", MavAutopilot.PX4: "px4"}
VEHICLES: dict[int, Kind] = {
    MavType.FIXED_WING: "plane",
    MavType.QUADROTOR: "copter",
    MavType.COAXIAL: "copter",
    MavType.HELICOPTER: "copter",
    MavType.HEXAROTOR: "copter",
    MavType.OCTOROTOR: "copter",
    MavType.TRICOPTER: "copter",
    MavType.DODECAROTOR: "copter",
    MavType.DECAROTOR: "copter",
    MavType.VTOL_TAILSITTER_DUOROTOR: "plane",
    MavType.VTOL_TAILSITTER_QUADROTOR: "plane",
    MavType.VTOL_TILTROTOR: "plane",
    MavType.VTOL_FIXEDROTOR: "plane",
    MavType.VTOL_TAILSITTER: "plane",
    MavType.VTOL_TILTWING: "plane",
    MavType.GROUND_ROVER: "rover",
    MavType.SURFACE_BOAT: "boat",
    MavType.SUBMARINE: "sub",
}
# What its rotors hold in the air; a plane is a "vtol" as long as they do.
HOVERING: frozenset[Kind] = frozenset({"copter", "vtol"})
