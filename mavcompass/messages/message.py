"""What every MAVLink message is, how it arrives, and the layout of frames; places count from the first byte.

    version 1: FE length sequence system component id                         payload checksum
    version 2: FD length incompatible compatible sequence system component id payload checksum [signature]

The id takes one byte in version 1, three in version 2; version 2 cuts zeros off the payload's end. The
checksum is CRC-16/MCRF4XX over all but the first byte, then the message's own extra byte. A signature is
the link's id, a 48 bit time in units of 10 us since 2015 and six bytes of SHA-256 over key and frame.
"""

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


V1, V2 = 0xFE, 0xFD
FRAME_STARTS = (V1, V2)
LENGTH_AT, FLAGS_AT = 1, 2
ADDRESS_AT_1, ADDRESS_AT_2 = 3, 5
ID_AT_1, ID_AT_2 = 5, 7
HEADER_BYTES_1, HEADER_BYTES_2 = 6, 10
CHECKSUM_BYTES = 2
SIGNATURE_BYTES = 13
# The incompatible flag that is known; a frame with another cannot be understood.
SIGNED = 0x01
LONGEST_FRAME = HEADER_BYTES_2 + 255 + CHECKSUM_BYTES + SIGNATURE_BYTES
