"""What every MAVLink message is, and how it arrives."""

from __future__ import annotations

import re
from dataclasses import dataclass
from functools import cache


@dataclass(frozen=True, slots=True)
class Message:
    """Be one MAVLink message."""

    @classmethod
    @cache
    def wire_name(cls) -> str:
        """Return the dialect's name: RawImu is RAW_IMU."""
        return re.sub(r"(?<=[a-z])(?=[A-Z])", "_", cls.__name__).upper()


@dataclass(frozen=True, slots=True)
class Incoming:
    """Wrap a message heard on a link with its sender and the link's time of arrival, in seconds."""

    time_s: float
    system: int
    component: int
    message: Message
