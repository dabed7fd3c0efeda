"""What can be done to a recording while it is played: time jumps, saturation, a frozen compass."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

from mavcompass.messages import HighresImu, Message, RawImu, ScaledImu
from mavcompass.units import MGAUSS_PER_GAUSS
from mavcompass.vehicle.links.autopilot import SaidMessage

Alter = Callable[[SaidMessage], SaidMessage]


@dataclass(frozen=True, slots=True)
class Alterations:
    """Say what to do; times are those of the replay.

    Attributes:
        time_jumps: (at, by) seconds: from then on the vehicle's own clock is off by so much.
        saturation_mgauss: limit of every axis of every compass.
        frozen_from_s: from then on every compass repeats its last reading.
    """

    time_jumps: tuple[tuple[float, float], ...] = ()
    saturation_mgauss: float | None = None
    frozen_from_s: float | None = None

    def begin(self) -> Alter:
        """Return the function that alters one replay, message by message."""
        if self == Alterations():
            return lambda played: played
        return _Altering(self)


class _Altering:
    def __init__(self, alterations: Alterations) -> None:
        self._alterations = alterations
        self._last_field: dict[tuple[int, int, type[Message]], tuple[float, float, float]] = {}

    def __call__(self, played: SaidMessage) -> SaidMessage:
        message = played.message
        if message is None:
            return played
        altered = self._jump(message, played.time_s)
        if isinstance(altered, RawImu | ScaledImu | HighresImu):
            altered = self._compass(altered, played)
        if altered is message:
            return played
        return SaidMessage(played.time_s, played.system, played.component, altered, played.port)

    def _jump(self, message: Message, time_s: float) -> Message:
        by_s = sum(by for at, by in self._alterations.time_jumps if time_s >= at)
        for name, per_second, bits in (("time_boot_ms", 1e3, 32), ("time_usec", 1e6, 64)):
            old = getattr(message, name, None)
            if by_s and old is not None:
                new = max(old + round(by_s * per_second), 0) % 2**bits
                message = replace(message, **{name: new})
        return message

    def _compass(self, imu: RawImu | ScaledImu | HighresImu, played: SaidMessage) -> Message:
        sensor = (played.system, played.component, type(imu))
        field = (imu.xmag, imu.ymag, imu.zmag)
        frozen_from_s = self._alterations.frozen_from_s
        if frozen_from_s is not None and played.time_s >= frozen_from_s:
            field = self._last_field.setdefault(sensor, field)
        self._last_field[sensor] = field
        limit = self._alterations.saturation_mgauss
        if limit is not None:
            most = limit / MGAUSS_PER_GAUSS if isinstance(imu, HighresImu) else round(limit)
            field = (_clip(field[0], most), _clip(field[1], most), _clip(field[2], most))
        x, y, z = field
        return imu if field == (imu.xmag, imu.ymag, imu.zmag) else replace(imu, xmag=x, ymag=y, zmag=z)  # type: ignore[arg-type]


def _clip(value: float, most: float) -> float:
    return max(-most, min(value, most))
