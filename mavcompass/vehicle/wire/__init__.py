"""MAVLink frames: bytes into messages and back."""

from mavcompass.vehicle.wire.codec import decode, encode, wire_format
from mavcompass.vehicle.wire.framing import Frame, FrameParser, FrameWriter
from mavcompass.vehicle.wire.signing import Signing

__all__ = [
    "Frame",
    "FrameParser",
    "FrameWriter",
    "Signing",
    "decode",
    "encode",
    "wire_format",
]
