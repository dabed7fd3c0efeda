"""How things really are: what a simulated result is judged by."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from mavcompass.correction import Vector
from mavcompass.frames import FloatArray
from mavcompass.simulation.physics.motion import Body
from mavcompass.simulation.physics.sensors import Surroundings


@dataclass(frozen=True, slots=True, eq=False)
class Truth:
    """Hold the true state at one moment.

    Attributes:
        rotation: body to NED, (3, 3); roll_rad, pitch_rad, yaw_rad: the same as angles.
        position_ned_m: relative to the start; field_ned_mgauss: the Earth's field there.
    """

    time_s: float
    rotation: FloatArray
    roll_rad: float
    pitch_rad: float
    yaw_rad: float
    yaw_rate_radps: float
    position_ned_m: Vector
    velocity_ned_mps: Vector
    field_ned_mgauss: Vector
    declination_rad: float
    current_a: float
    temperature_degc: float


def truth_of(body: Body, around: Surroundings, time_s: float) -> Truth:
    """Read the true state off a body and its surroundings."""
    return Truth(
        time_s=time_s,
        rotation=np.array(body.rotation).reshape(3, 3),
        roll_rad=body.roll_rad,
        pitch_rad=body.pitch_rad,
        yaw_rad=body.yaw_rad,
        yaw_rate_radps=body.yaw_rate_radps,
        position_ned_m=(body.north_m, body.east_m, -body.height_m),
        velocity_ned_mps=body.velocity_ned_mps,
        field_ned_mgauss=body.world.field_ned_mgauss,
        declination_rad=body.world.declination_rad,
        current_a=around.current_a,
        temperature_degc=around.temperature_degc,
    )
