"""The frames of a telemetry log, one after the other, as they were on the wire."""

from __future__ import annotations

from collections.abc import Iterator
from mmap import ACCESS_READ, mmap
from pathlib import Path
from struct import Struct

from mavcompass.errors import BadRecording, UsageError
from mavcompass.vehicle.wire import wire_format
from mavcompass.vehicle.wire.framing import Frame, checksum_is_right, frame_length, split_frame

_TIME_STAMP = Struct(">Q")


def tlog_frames(path: Path) -> Iterator[tuple[float, Frame]]:
    """Hand out the good frames of a .tlog with their time stamps (Unix seconds, as recorded).

    What is damaged is skipped, and so are messages that the dialect does not have.
    Raises UsageError for a file that is not there, BadRecording for an empty one.
    """
    try:
        with path.open("rb") as file:
            if not file.seek(0, 2):
                raise BadRecording(f"{path} is empty.", "Give another recording.")
            with mmap(file.fileno(), 0, access=ACCESS_READ) as data:
                yield from _frames(data)
    except OSError as error:
        reason = error.strerror or str(error)
        raise UsageError(f"{path} cannot be read: {reason}.", "Check the file's name.") from error


def _frames(data: mmap) -> Iterator[tuple[float, Frame]]:
    at, end = 0, len(data)
    while at + _TIME_STAMP.size < end:
        begin = at + _TIME_STAMP.size
        length = frame_length(data, begin)
        if not length or begin + length > end:
            at += 1
            continue
        frame = split_frame(data[begin : begin + length])
        if checksum_is_right(frame):
            yield _TIME_STAMP.unpack_from(data, at)[0] * 1e-6, frame
            at = begin + length
        elif wire_format(frame.message_id) is None and frame_length(data, begin + length + _TIME_STAMP.size):
            at = begin + length  # another dialect's message, with a record right behind it
        else:
            at += 1
