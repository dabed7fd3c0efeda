"""The pilot's radio: sticks, and what ground stations put in their place."""

from __future__ import annotations

from mavcompass.messages import ManualControl, RcChannelsOverride

OVERRIDE_TIMEOUT_S = 3.0
_CENTRE, _LOW, _HIGH = 1500, 1000, 1800
_IGNORE, _RELEASE = 65535, 0
_UNUSED_AXIS, _FULL_AXIS = 32767, 1000


class Radio:
    """Hold the pulse widths of eight channels: roll or steering, pitch, throttle, yaw, switches."""

    def __init__(self, throttle_low: bool) -> None:
        throttle = _LOW if throttle_low else _CENTRE
        self._rest = (_CENTRE, _CENTRE, throttle, _CENTRE, _HIGH, _LOW, _LOW, _HIGH)
        self._held: dict[int, tuple[int, float]] = {}
        self._overrides: dict[int, tuple[int, float]] = {}

    def channel(self, number: int, now_s: float) -> int:
        """Return a channel's pulse width: the pilot's hand, then an override, then the rest position."""
        for source in (self._held, self._overrides):
            if number in source:
                pwm, until_s = source[number]
                if now_s <= until_s:
                    return pwm
                del source[number]
        return self._rest[number - 1]

    def channels(self, now_s: float) -> tuple[int, ...]:
        """Return all channels."""
        return tuple(self.channel(n, now_s) for n in range(1, len(self._rest) + 1))

    def hold(self, channel: int, pwm: int, until_s: float) -> None:
        """Let the pilot hold a channel."""
        self._held[channel] = (pwm, until_s)

    def override(self, message: RcChannelsOverride | ManualControl, now_s: float) -> None:
        """Take a ground station's values; they are forgotten after three seconds."""
        until_s = now_s + OVERRIDE_TIMEOUT_S
        if isinstance(message, ManualControl):
            axes = {1: message.y, 2: -message.x, 3: message.z, 4: message.r}
            for number, value in axes.items():
                if abs(value) < _UNUSED_AXIS:
                    deflection = max(-_FULL_AXIS, min(value, _FULL_AXIS))
                    self._overrides[number] = (_CENTRE + deflection // 2, until_s)
            return
        for number in range(1, 9):
            pwm = getattr(message, f"chan{number}_raw")
            if pwm == _RELEASE:
                self._overrides.pop(number, None)
            elif pwm != _IGNORE:
                self._overrides[number] = (pwm, until_s)
