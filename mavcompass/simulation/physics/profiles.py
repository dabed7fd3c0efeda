"""The simulated vehicles: what each is, how fast it thinks, and how it turns."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import Literal

from mavcompass.enums import CopterMode, MavType, MavVtolState, PlaneMode, RoverMode, SubMode
from mavcompass.errors import UsageError
from mavcompass.kinds import VEHICLES

Chassis = Literal["skid", "ackermann", "boat", "copter", "sub"]
Firmware = Literal["rover", "copter", "sub", "plane", "px4"]

_DEG = math.pi / 180.0


@dataclass(frozen=True, slots=True)
class Place:
    """Name a point on Earth."""

    lat_deg: float
    lon_deg: float
    alt_m: float


# Where ArduPilot's and PX4's own simulators start.
CANBERRA = Place(-35.363262, 149.165237, 584.0)
ZURICH = Place(47.397742, 8.545594, 488.0)


@dataclass(frozen=True, slots=True)
class VehicleProfile:
    """Describe one kind of vehicle.

    Attributes:
        loop_hz: the flight controller's main loop; it bounds the message rates and times them.
        rate_share: message rates above this share of the loop's are denied.
        tick_us: the simulation's step, a whole number of which make 100 ms.
        yaw_rate_max_radps, yaw_acceleration_radps2, yaw_lag_s: how the chassis can turn.
        yaw_gain_per_s: turn rate asked per radian of heading error.
        coast_radps2: how quickly a turn dies out when nothing drives it.
        turn_radius_m: the tightest circle, 0 for a vehicle that turns on the spot.
        hover_m: height at which it waits in the air (positive) or the water (negative).
        currents_a: battery current at rest, when moving or hovering, and more per rad/s of turn.
        jitter_rad: standard deviation of roll and pitch of a hovering vehicle.
        vibration_mps2: accelerometer noise that the running motors add.
        slope_rad, wave_rad: how much the ground or the water tilts it, at most.
        lean_rad_per_mps2: how far its own acceleration tilts it: out of a bend (negative) or into it.
    """

    name: str
    firmware: Firmware
    chassis: Chassis
    mav_type: MavType
    place: Place
    guided_mode: int
    initial_mode: int
    loop_hz: int = 50
    rate_share: float = 0.8
    tick_us: int = 20_000
    yaw_rate_max_radps: float = 120.0 * _DEG
    yaw_acceleration_radps2: float = 120.0 * _DEG
    yaw_lag_s: float = 0.06
    yaw_gain_per_s: float = 2.0
    coast_radps2: float = 200.0 * _DEG
    turn_radius_m: float = 0.0
    speed_max_mps: float = 3.0
    hover_m: float = 0.0
    currents_a: tuple[float, float, float] = (0.6, 3.0, 2.5)
    jitter_rad: float = 0.0
    jitter_period_s: float = 2.0
    vibration_mps2: float = 0.0
    slope_rad: float = 0.0
    lean_rad_per_mps2: float = 0.0
    wave_rad: float = 0.0
    yaw_unrest_radps: float = 0.0

    @property
    def leans_to_move(self) -> bool:
        """Tell whether a tilt pushes the vehicle sideways, so that its accelerometer hardly shows it.

        A sub is held upright by its buoyancy and shows its whole tilt.
        """
        return self.chassis == "copter"

    @property
    def hovers(self) -> bool:
        """Tell whether it is held in air or water by its motors."""
        return self.hover_m != 0.0

    @property
    def takes_targets(self) -> bool:
        """Tell whether it turns on the spot when told to: ArduPilot's quadplanes by sticks alone."""
        return self.firmware != "plane"

    @property
    def vtol_state(self) -> MavVtolState:
        """Tell what EXTENDED_SYS_STATE says of it: what has wings is simulated on its rotors alone."""
        return MavVtolState.MC if VEHICLES[self.mav_type] == "plane" else MavVtolState.UNDEFINED

    @property
    def loop_us(self) -> int:
        """Return the period of the main loop."""
        return 1_000_000 // self.loop_hz


_ROVER = VehicleProfile(
    name="rover",
    firmware="rover",
    chassis="skid",
    mav_type=MavType.GROUND_ROVER,
    place=CANBERRA,
    guided_mode=RoverMode.GUIDED,
    initial_mode=RoverMode.MANUAL,
    slope_rad=1.5 * _DEG,
    lean_rad_per_mps2=-0.6 * _DEG,
    vibration_mps2=0.15,
)

_COPTER = VehicleProfile(
    name="copter",
    firmware="copter",
    chassis="copter",
    mav_type=MavType.QUADROTOR,
    place=CANBERRA,
    guided_mode=CopterMode.GUIDED,
    initial_mode=CopterMode.STABILIZE,
    loop_hz=400,
    tick_us=10_000,
    yaw_rate_max_radps=120.0 * _DEG,
    yaw_acceleration_radps2=110.0 * _DEG,
    yaw_lag_s=0.1,
    yaw_gain_per_s=1.8,
    coast_radps2=60.0 * _DEG,
    hover_m=8.0,
    currents_a=(0.5, 28.0, 1.5),
    jitter_rad=0.35 * _DEG,
    jitter_period_s=1.6,
    vibration_mps2=0.5,
    slope_rad=0.5 * _DEG,
    yaw_unrest_radps=0.15 * _DEG,
)

_PX4_COPTER = replace(
    _COPTER,
    name="px4-copter",
    firmware="px4",
    place=ZURICH,
    guided_mode=6 << 16,
    initial_mode=3 << 16,
    loop_hz=250,
    rate_share=1.0,
    yaw_rate_max_radps=200.0 * _DEG,
    yaw_acceleration_radps2=90.0 * _DEG,
    yaw_lag_s=0.12,
    yaw_gain_per_s=2.2,
    currents_a=(0.6, 18.0, 1.2),
    jitter_period_s=1.4,
    vibration_mps2=0.6,
)

PROFILES: dict[str, VehicleProfile] = {
    p.name: p
    for p in (
        _ROVER,
        replace(
            _ROVER,
            name="ackermann-rover",
            chassis="ackermann",
            yaw_lag_s=0.15,
            turn_radius_m=1.2,
            vibration_mps2=0.25,
            currents_a=(0.6, 4.0, 0.5),
        ),
        replace(
            _ROVER,
            name="boat",
            chassis="boat",
            mav_type=MavType.SURFACE_BOAT,
            slope_rad=0.0,
            yaw_rate_max_radps=60.0 * _DEG,
            yaw_acceleration_radps2=40.0 * _DEG,
            yaw_lag_s=0.35,
            yaw_gain_per_s=0.9,
            coast_radps2=12.0 * _DEG,
            currents_a=(0.8, 6.0, 8.0),
            vibration_mps2=0.1,
            lean_rad_per_mps2=1.0 * _DEG,
            wave_rad=1.5 * _DEG,
            yaw_unrest_radps=0.6 * _DEG,
        ),
        _COPTER,
        VehicleProfile(
            name="sub",
            firmware="sub",
            chassis="sub",
            mav_type=MavType.SUBMARINE,
            place=CANBERRA,
            guided_mode=SubMode.GUIDED,
            initial_mode=SubMode.MANUAL,
            loop_hz=400,
            tick_us=10_000,
            yaw_rate_max_radps=90.0 * _DEG,
            yaw_acceleration_radps2=60.0 * _DEG,
            yaw_lag_s=0.3,
            yaw_gain_per_s=1.2,
            coast_radps2=30.0 * _DEG,
            hover_m=-3.0,
            currents_a=(1.2, 7.0, 6.0),
            jitter_rad=0.6 * _DEG,
            jitter_period_s=4.0,
            vibration_mps2=0.05,
            slope_rad=0.5 * _DEG,
            yaw_unrest_radps=0.3 * _DEG,
        ),
        replace(
            _COPTER,
            name="quadplane",
            firmware="plane",
            mav_type=MavType.FIXED_WING,
            guided_mode=PlaneMode.QLOITER,
            initial_mode=PlaneMode.QSTABILIZE,
        ),
        _PX4_COPTER,
        replace(_PX4_COPTER, name="px4-vtol", mav_type=MavType.VTOL_FIXEDROTOR),
    )
}


def profile(vehicle: str) -> VehicleProfile:
    """Find a vehicle's profile by its name; raises UsageError for a name that is none."""
    try:
        return PROFILES[vehicle]
    except KeyError:
        raise UsageError(
            f"There is no simulated vehicle {vehicle!r}.", f"Choose one of: {', '.join(PROFILES)}."
        ) from None
