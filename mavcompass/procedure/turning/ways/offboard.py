"""Turning a flying PX4 multicopter: OFFBOARD, its setpoint stream, and the mode it had before.

PX4 takes no command to turn. It wants setpoints as a stream before it lets itself be switched to
OFFBOARD, and as long as that lasts; when they stop it leaves OFFBOARD by itself (COM_OF_LOSS_T).
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field

from mavcompass.enums import MavFrame
from mavcompass.procedure.modes import PX4_OFFBOARD, ModeKeeper
from mavcompass.procedure.script import Context, Script, pause
from mavcompass.procedure.turning.gyro_angle import GyroAngle
from mavcompass.procedure.turning.steered import Builder, Steer, SteeredTurn, TurnWay
from mavcompass.procedure.turning.targets import PLACE_AND_YAW_RATE, STAND_AND_YAW_RATE, send_target

_STREAM_S = 0.1
_STREAM_BEFORE_S = 1.2
_LATELY_MS = 1000


@dataclass(slots=True)
class OffboardTurn:
    """Turn by yaw rate setpoints at one place, in OFFBOARD from the first turn to the release.

    The place is where the vehicle was when it entered OFFBOARD: a velocity of zero alone would let it drift
    as fast as its estimator's velocity is off. `modes` knows the mode before, which it puts back, and the
    vehicle's place; without it OFFBOARD must already be there, and a standstill is all that is asked for.
    """

    way: TurnWay
    modes: ModeKeeper | None = field(default=None, compare=False)
    _steered: SteeredTurn = field(init=False, compare=False)
    _wanted_radps: float = field(default=0.0, compare=False)
    _next_s: float = field(default=-math.inf, compare=False)
    _streaming: bool = field(default=False, compare=False)
    _watching: bool = field(default=False, compare=False)
    _place_ned_m: tuple[float, float, float] | None = field(default=None, compare=False)

    def __post_init__(self) -> None:
        self._steered = SteeredTurn.by(_Wish(self), self.way)

    @property
    def name(self) -> str:
        """Return what the person is told."""
        return self.way.name

    def turn(self, context: Context, gyro: GyroAngle, angle_rad: float) -> Script[bool]:
        """Turn; on the first turn start the stream and switch to OFFBOARD."""
        if not self._streaming and not (yield from self._enter(context)):
            return False
        return (yield from self._steered.turn(context, gyro, angle_rad))

    def _enter(self, context: Context) -> Script[bool]:
        self._streaming, self._place_ned_m = True, self._place()
        if not self._watching:
            # As a watch it is called with every event, whatever the procedure does meanwhile.
            context.watches.append(lambda now_s: self._stream(context, now_s))
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

    def _stream(self, context: Context, now_s: float) -> None:
        if self._streaming and now_s >= self._next_s:
            self._send(context)
            self._next_s = now_s + _STREAM_S

    def _send(self, context: Context) -> None:
        rate_radps = self._wanted_radps
        if self._place_ned_m is None:
            send_target(context, STAND_AND_YAW_RATE, yaw_rate_radps=rate_radps)
            return
        send_target(
            context,
            PLACE_AND_YAW_RATE,
            MavFrame.LOCAL_NED,
            yaw_rate_radps=rate_radps,
            place_ned_m=self._place_ned_m,
        )

    def hold(self, context: Context) -> None:
        """Stand; the stream goes on."""
        self._wanted_radps = 0.0

    def halt(self, context: Context) -> None:
        """Stand, now."""
        self._wanted_radps = 0.0
        if self._streaming:
            self._send(context)
            self._send(context)

    def release(self, context: Context) -> Script[None]:
        """Put the old mode back, streaming until it is there, and end the stream."""
        if not self._streaming:
            return
        if self.modes is not None:
            yield from self._streaming_beside(context, self.modes.restore(context))
        self._streaming = False

    def _streaming_beside(self, context: Context, script: Script[bool | None]) -> Script[bool]:
        """Keep the stream up beside a script: after a stop no watch is called any more."""
        try:
            wake_s = next(script)
            while True:
                self._stream(context, context.now)
                event = yield min(wake_s, context.now + _STREAM_S)
                wake_s = script.send(event)
        except StopIteration as end:
            return bool(end.value)


@dataclass(frozen=True, slots=True)
class _Wish(Steer):
    """Be the steering of a stream: only note the wish, the stream carries it."""

    offboard: OffboardTurn
    name: str = "yaw rate setpoints"

    def turn(self, context: Context, rate_radps: float, left_rad: float) -> None:
        self.offboard._wanted_radps = rate_radps

    def stand(self, context: Context) -> None:
        self.offboard._wanted_radps = 0.0


WAYS: dict[str, Builder] = {"yaw rate setpoints in OFFBOARD": OffboardTurn}
