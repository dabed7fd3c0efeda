"""Turning a flying PX4 multicopter: OFFBOARD, its setpoint stream, and the mode it had before.

PX4 takes no command to turn. It wants setpoints as a stream before it lets itself be switched to
OFFBOARD, and as long as that lasts; when they stop it leaves OFFBOARD by itself (COM_OF_LOSS_T).
"""

from __future__ import annotations

import math
from dataclasses import dataclass

from mavcompass.enums import MavFrame
from mavcompass.procedure.modes import PX4_OFFBOARD, ModeKeeper
from mavcompass.procedure.script import Context, Script, pause
from mavcompass.procedure.turning.gyro_angle import GyroAngle
from mavcompass.procedure.turning.steered import Builder, Steer, SteeredTurn
from mavcompass.procedure.turning.targets import PLACE_AND_YAW_RATE, STAND_AND_YAW_RATE, send_target

_STREAM_S = 0.1
_STREAM_BEFORE_S = 1.2
_LATELY_MS = 1000


@dataclass(slots=True)
class Setpoints(Steer):
    """Stream yaw rate setpoints at one place; what is asked for is the rate that they carry.

    Without a place, a standstill is all that is asked for.
    """

    streaming: bool = False
    place_ned_m: tuple[float, float, float] | None = None
    _rate_radps: float = 0.0
    _next_s: float = -math.inf

    def turn(self, context: Context, rate_radps: float, left_rad: float) -> None:
        """Have them carry the rate."""
        self._rate_radps = rate_radps

    def stand(self, context: Context) -> None:
        """Have them carry none; the stream goes on."""
        self._rate_radps = 0.0

    def let_go(self, context: Context) -> None:
        """Send one now."""
        if self.streaming:
            self._send(context)

    def stream(self, context: Context, now_s: float) -> None:
        """Send the next one when it is time."""
        if self.streaming and now_s >= self._next_s:
            self._send(context)
            self._next_s = now_s + _STREAM_S

    def _send(self, context: Context) -> None:
        rate_radps, place = self._rate_radps, self.place_ned_m
        if place is None:
            send_target(context, STAND_AND_YAW_RATE, yaw_rate_radps=rate_radps)
        else:
            frame = MavFrame.LOCAL_NED
            send_target(context, PLACE_AND_YAW_RATE, frame, yaw_rate_radps=rate_radps, place_ned_m=place)


@dataclass(slots=True)
class OffboardTurn(SteeredTurn):
    """Turn by setpoints at one place, in OFFBOARD from the first turn to the release.

    The place is where the vehicle was when it entered OFFBOARD: a velocity of zero alone would let it drift
    as fast as its estimator's velocity is off. `modes` knows the mode before, which it puts back, and the
    vehicle's place; without it OFFBOARD must already be there.
    """

    steer: Setpoints
    modes: ModeKeeper | None = None
    _watching: bool = False

    def turn(self, context: Context, gyro: GyroAngle, angle_rad: float) -> Script[bool]:
        """Turn; on the first turn start the stream and switch to OFFBOARD."""
        if not self.steer.streaming and not (yield from self._enter(context)):
            return False
        return (yield from SteeredTurn.turn(self, context, gyro, angle_rad))

    def _enter(self, context: Context) -> Script[bool]:
        self.steer.streaming, self.steer.place_ned_m = True, self._place()
        if not self._watching:
            # As a watch it is called with every event, whatever the procedure does meanwhile.
            context.watches.append(lambda now_s: self.steer.stream(context, now_s))
            self._watching = True
        yield from pause(context, _STREAM_BEFORE_S)
        return self.modes is None or (yield from self.modes.change(context, PX4_OFFBOARD))

    def _place(self) -> tuple[float, float, float] | None:
        """Return where the vehicle says that it is; None where it has not said so lately."""
        state = None if self.modes is None else self.modes.state
        if state is None or state.local is None or state.attitude is None:
            return None
        local = state.local
        if abs(state.attitude.time_boot_ms - local.time_boot_ms) > _LATELY_MS:
            return None
        return local.x, local.y, local.z

    def release(self, context: Context) -> Script[None]:
        """Put the old mode back, streaming until it is there, and end the stream."""
        if self.steer.streaming and self.modes is not None:
            yield from self._streaming_beside(context, self.modes.restore(context))
        self.steer.streaming = False

    def _streaming_beside(self, context: Context, script: Script[None]) -> Script[None]:
        """Keep the stream up beside a script: after a stop no watch is called any more."""
        try:
            wake_s = next(script)
            while True:
                self.steer.stream(context, context.now)
                event = yield min(wake_s, context.now + _STREAM_S)
                wake_s = script.send(event)
        except StopIteration:
            return


WAYS: dict[str, Builder] = {
    "yaw rate setpoints in OFFBOARD": lambda way, modes: OffboardTurn(Setpoints(), way, modes=modes)
}
