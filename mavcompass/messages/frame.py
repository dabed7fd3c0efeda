"""The layout of MAVLink frames, versions 1 and 2; places count from a frame's first byte.

    version 1: FE length sequence system component id                         payload checksum
    version 2: FD length incompatible compatible sequence system component id payload checksum [signature]

The id takes one byte in version 1, three in version 2; version 2 cuts zeros off the payload's end. The
checksum is CRC-16/MCRF4XX over all but the first byte, then the message's own extra byte. A signature is
the link's id, a 48 bit time in units of 10 us since 2015 and six bytes of SHA-256 over key and frame.
"""

from __future__ import annotations

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
