"""A simulated vehicle follows a profile: ready, armed, in the air, and then target after target.

Everything is timed by the vehicle's own clock, so a simulator may run faster than real time. This is for
simulators alone: it arms, takes off and drives without asking anybody.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from types import MappingProxyType

from mavcompass import messages as mav
from mavcompass.enums import MavCmd, MavFrame, MavParamType
from mavcompass.errors import NoReply, Refused
from mavcompass.messages.bits import single_from_bits
from mavcompass.procedure.commands import DISABLED_US, command
from mavcompass.procedure.flying.profile import Profile
from mavcompass.procedure.modes import PX4_OFFBOARD, ModeKeeper, command_mode
from mavcompass.procedure.motion import Permissions, Readiness
from mavcompass.procedure.script import Context, Script, expect, pause, request
from mavcompass.procedure.vehicle_state import VehicleIdentity, VehicleState, find_vehicle

_ATTITUDE = 30
# EKF_STATUS_REPORT.flags: attitude, horizontal velocity, absolute horizontal position.
_KNOWS_ITS_PLACE = 1 | 2 | 16
_PLACE_PATIENCE_S = 120.0
_ARMING_TRIES, _ARMING_AGAIN_S = 8, 1.0
_TO_THE_BEGIN_S, _NEAR_M, _LEVEL_RAD = 40.0, 1.5, math.radians(4.0)
_SETTLE_S = 4.0
_OFFBOARD_TRIES, _STREAM_BEFORE_S = 6, 1.5
_TARGET_S = 0.09
# Rate of turn per radian that a rover's yaw lags the profile's.
_YAW_GAIN_PER_S = 0.7
# A vehicle whose clock does not go on for so long will not finish.
_STANDSTILL_S = 20.0
# type_mask: what is to be ignored.
_SPEED_AND_YAW_RATE = 0x5C7
_PLACE_SPEED_AND_YAW = 0x1C0
_QUIET_PARAMETERS_S = 1.5


def flight_rates(rate_hz: float, autopilot: str) -> dict[int, float]:
    """List how often the simulator shall tell what, Hz, by number of the message: as telemetry does.

    0 is for what it shall not send: PX4's HIGHRES_IMU is less what its estimator takes for the compass's
    bias, which is not told.
    """
    imu_hz = min(max(rate_hz, 5.0), 50.0)
    slow_hz = min(imu_hz, 10.0)
    raw_imu, scaled_imu, battery, highres_imu = 27, 26, 147, 105
    local, place, hud, servo, receiver, status, ekf, pressure = 32, 33, 74, 36, 24, 1, 193, 29
    rates = {message: slow_hz for message in (local, place, hud, servo, battery)}
    rates |= {receiver: 5.0, status: 4.0, ekf: 4.0, pressure: 2.0, _ATTITUDE: max(imu_hz, 10.0)}
    return rates | ({raw_imu: imu_hz} if autopilot == "ardupilot" else {highres_imu: 0.0, scaled_imu: imu_hz})


@dataclass(slots=True)
class _Clock:
    """Keep the vehicle's time, and notice where it stands still."""

    time_s: float = -math.inf
    moved_s: float = math.inf
    attitude: mav.Attitude = field(default_factory=mav.Attitude)

    def hear(self, heard: mav.Incoming) -> None:
        if isinstance(heard.message, mav.Attitude):
            self.attitude, self.time_s, self.moved_s = (
                heard.message,
                heard.message.time_boot_ms / 1000.0,
                heard.time_s,
            )

    def stands(self, now_s: float) -> str | None:
        if now_s - self.moved_s > _STANDSTILL_S:
            return "The simulator's clock stands still."
        return None


def fly_profile(
    context: Context,
    profile: Profile,
    recording: Callable[[bool], None],
    parameters: Mapping[str, float] = MappingProxyType({}),
) -> Script[VehicleIdentity]:
    """Make a simulated vehicle fly a profile; `recording` is told when the flight begins and when it ends.

    `parameters` are set before, where the simulator does not take them as it starts.

    Raises Refused where the vehicle is of another kind, or will not be armed or fly; LinkError where it does
    not answer.
    """
    context.show("start", "Waiting for the simulated vehicle.", 0.0)
    identity = yield from find_vehicle(context, timeout_s=30.0)
    if (identity.kind == "copter") != (profile.kind == "copter"):
        raise Refused(
            f"The simulator flies a {identity.kind}, the recording is of a {profile.kind}.",
            "Name the program of the recording's kind with --sitl (ardurover, arducopter).",
        )
    state, clock = VehicleState(), _Clock()
    context.listeners += [state.hear, clock.hear]
    context.watches.append(clock.stands)
    yield from _set(context, parameters)
    wanted = flight_rates(profile.rate_hz, identity.autopilot)
    for number, hertz in wanted.items():
        yield from _set_rate(context, number, hertz)
    yield from _until_it_knows_its_place(context, identity, state, clock)
    yield from _ready(context, identity, state, profile)
    if identity.autopilot == "px4":
        yield from _into_offboard(context, profile, state, clock)
    if profile.kind == "copter":
        yield from _to_the_begin(context, profile, state, clock)
    yield from _read_parameters(context)
    # What a vehicle that is faster than this computer told before is heard once this is answered.
    _target(context, profile, 0, clock, still=True)
    yield from _set_rate(context, _ATTITUDE, wanted[_ATTITUDE])
    recording(True)
    yield from _follow(context, profile, clock)
    recording(False)
    return identity


def _set_rate(context: Context, number: int, hertz: float) -> Script[None]:
    every_us = 1e6 / hertz if hertz else float(DISABLED_US)
    yield from command(context, MavCmd.SET_MESSAGE_INTERVAL, float(number), every_us, what="a message rate")


def _set(context: Context, parameters: Mapping[str, float]) -> Script[None]:
    """Set parameters; a whole number is sent as PX4 takes one, by its bits."""
    for name, value in parameters.items():
        yield from _set_one(context, name, value)


def _set_one(context: Context, name: str, value: float) -> Script[None]:
    whole = isinstance(value, int)
    yield from request(
        context,
        mav.ParamSet(
            context.system,
            context.component,
            name,
            single_from_bits(int(value) & 0xFFFFFFFF) if whole else value,
            MavParamType.INT32 if whole else MavParamType.REAL32,
        ),
        mav.ParamValue,
        lambda answer: answer.param_id == name,
        f"the parameter {name}",
    )


def _until_it_knows_its_place(
    context: Context, identity: VehicleIdentity, state: VehicleState, clock: _Clock
) -> Script[None]:
    context.show("start", "Waiting until the simulated vehicle knows its place.")
    while clock.time_s == -math.inf:
        yield context.now + 0.2
    give_up_s = clock.time_s + _PLACE_PATIENCE_S
    while not _knows_its_place(identity, state):
        if clock.time_s > give_up_s:
            said = f" It said: {state.texts[-1]}." if state.texts else ""
            raise Refused(
                f"The simulated vehicle did not find its place in {_PLACE_PATIENCE_S:.0f} s.{said}",
                "Fly the simulator by hand, and use `mavcompass gap compare`.",
            )
        yield context.now + 0.2


def _knows_its_place(identity: VehicleIdentity, state: VehicleState) -> bool:
    if identity.autopilot != "ardupilot":
        return state.local is not None and state.place is not None
    return state.ekf is not None and state.ekf.flags & _KNOWS_ITS_PLACE == _KNOWS_ITS_PLACE


def _ready(
    context: Context, identity: VehicleIdentity, state: VehicleState, profile: Profile
) -> Script[None]:
    """Bring it into GUIDED, arm it, take off to the profile's first height."""
    height_m = max(-float(profile.position_m[0, 2]), 0.0) if profile.kind == "copter" else 0.0
    for attempt in range(_ARMING_TRIES):
        modes = ModeKeeper(state, identity.autopilot)
        permissions = Permissions(set_mode=True, arm=True, takeoff_m=height_m)
        try:
            yield from Readiness(identity, state, modes, permissions).make(context)
            return
        except Refused:
            if attempt == _ARMING_TRIES - 1:
                raise
            yield from pause(context, _ARMING_AGAIN_S)


def _into_offboard(context: Context, profile: Profile, state: VehicleState, clock: _Clock) -> Script[None]:
    """Bring a PX4 into OFFBOARD, which it enters only while targets come."""
    for _ in range(_OFFBOARD_TRIES):
        until_s = clock.time_s + _STREAM_BEFORE_S
        while clock.time_s < until_s:
            _target(context, profile, 0, clock, still=True)
            yield from _next_attitude(context)
        command_mode(context, "px4", PX4_OFFBOARD)
        if state.mode == PX4_OFFBOARD:
            return
    raise Refused(
        "The simulated vehicle did not enter OFFBOARD.",
        "Fly the simulator by hand, and use `mavcompass gap compare`.",
    )


def _to_the_begin(context: Context, profile: Profile, state: VehicleState, clock: _Clock) -> Script[None]:
    """Fly a copter to where the profile begins, and let it come to rest there."""
    context.show("start", "Flying to where the recording begins.")
    end_s = clock.time_s + _TO_THE_BEGIN_S
    rest_s = math.inf
    while clock.time_s < min(end_s, rest_s):
        _target(context, profile, 0, clock, still=True)
        yield from _next_attitude(context)
        if rest_s == math.inf and state.local is not None:
            here = (state.local.x, state.local.y, state.local.z)
            near = math.dist(here, profile.position_m[0].tolist()) < _NEAR_M
            if near and abs(_lag(profile, 0, clock)) < _LEVEL_RAD:
                rest_s = clock.time_s + _SETTLE_S


def _follow(context: Context, profile: Profile, clock: _Clock) -> Script[None]:
    began_s, told_s, next_s = clock.time_s, -math.inf, -math.inf
    while (elapsed_s := clock.time_s - began_s) < profile.duration_s:
        if clock.time_s >= next_s:
            _target(context, profile, profile.at(elapsed_s), clock)
            next_s = clock.time_s + _TARGET_S
        if clock.time_s >= told_s + 5.0:
            told_s = clock.time_s
            text = f"Flying the recording's motion: {elapsed_s:.0f} of {profile.duration_s:.0f} s."
            context.show("fly", text, elapsed_s / profile.duration_s)
        yield from _next_attitude(context)


def _next_attitude(context: Context) -> Script[None]:
    yield from expect(context, mav.Attitude, timeout_s=0.5)


def _lag(profile: Profile, index: int, clock: _Clock) -> float:
    """Return how far the vehicle's yaw is behind the profile's, within half a turn."""
    return math.remainder(float(profile.yaw_rad[index]) - clock.attitude.yaw, 2.0 * math.pi)


def _target(context: Context, profile: Profile, index: int, clock: _Clock, still: bool = False) -> None:
    """Ask for the profile at one time: place, speed and yaw of what flies; speed and rate of what drives."""
    rate = 0.0 if still else float(profile.yaw_rate_radps[index])
    if profile.kind == "copter":
        x, y, z = profile.position_m[index].tolist()
        vx, vy, vz = (0.0, 0.0, 0.0) if still else profile.velocity_mps[index].tolist()
        frame, mask, yaw = MavFrame.LOCAL_NED, _PLACE_SPEED_AND_YAW, float(profile.yaw_rad[index])
        yaw = math.remainder(yaw, 2.0 * math.pi)
    else:
        x = y = z = vy = vz = yaw = 0.0
        vx = float(profile.forward_mps[index])
        rate += _YAW_GAIN_PER_S * _lag(profile, index, clock)
        frame, mask = MavFrame.BODY_NED, _SPEED_AND_YAW_RATE
    context.send(
        mav.SetPositionTargetLocalNed(
            time_boot_ms=clock.attitude.time_boot_ms,
            target_system=context.system,
            target_component=context.component,
            coordinate_frame=frame,
            type_mask=mask,
            x=x, y=y, z=z, vx=vx, vy=vy, vz=vz,
            yaw=yaw,
            yaw_rate=rate,
        )
    )  # fmt: skip


def _read_parameters(context: Context) -> Script[None]:
    """Let the vehicle tell all its parameters, so that they are in the recording."""
    context.show("start", "Reading the simulated vehicle's parameters.")
    context.send(mav.ParamRequestList(context.system, context.component))
    heard = yield from expect(context, mav.ParamValue, timeout_s=5.0)
    if heard is None:
        raise NoReply(
            "The simulated vehicle did not tell its parameters.", "Run again; a busy computer may be why."
        )
    while heard is not None and heard.param_index != heard.param_count - 1:
        heard = yield from expect(context, mav.ParamValue, timeout_s=_QUIET_PARAMETERS_S)
