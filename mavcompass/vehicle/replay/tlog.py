"""The frames of a telemetry log, one after the other, as they were on the wire, and their time."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from struct import Struct
from typing import BinaryIO

from mavcompass.errors import BadRecording, UsageError
from mavcompass.files import require_file
from mavcompass.messages.frame import FRAME_STARTS, LONGEST_FRAME
from mavcompass.vehicle.wire import wire_format
from mavcompass.vehicle.wire.framing import Frame, checksum_is_right, frame_length, split_frame

_TIME_STAMP = Struct(">Q")
_PIECE = 1 << 20
_LONGEST = 2 * (LONGEST_FRAME + _TIME_STAMP.size)  # a frame, and the beginning of the next
# Nobody waits through the night between two power-ups.
LONGEST_PAUSE_S = 10.0
# So many places in a row where a frame might begin and none does: ten megabytes by chance.
_MOST_FAILED = 100_000


def tlog_frames(path: Path) -> Iterator[tuple[float, Frame]]:
    """Hand out the good frames of a .tlog with their time stamps (Unix seconds, as recorded).

    What is damaged is skipped, and so are messages that the dialect does not have.
    Raises UsageError for a file that is not there, BadRecording for an empty one.
    """
    require_file(path)
    try:
        with path.open("rb") as file:
            if not path.stat().st_size:
                raise BadRecording(f"{path} is empty.", "Give another recording.")
            yield from _frames(file)
    except OSError as error:
        reason = error.strerror or str(error)
        raise UsageError(f"{path} cannot be read: {reason}.", "Check the file's name.") from error


def _frames(file: BinaryIO) -> Iterator[tuple[float, Frame]]:
    data, at, failed = b"", 0, 0
    while piece := file.read(_PIECE):
        data, at = data[at:] + piece, 0
        starts = dict.fromkeys(FRAME_STARTS, -1)  # where the next of each is
        # What begins further on may not be whole yet, unless this was the last piece.
        end = len(data) if len(piece) < _PIECE else len(data) - _LONGEST
        while at + _TIME_STAMP.size < end:
            begin = at + _TIME_STAMP.size
            length = frame_length(data, begin)
            if length and begin + length <= len(data):
                frame = split_frame(data[begin : begin + length])
                if checksum_is_right(frame):
                    failed = 0
                    yield _TIME_STAMP.unpack_from(data, at)[0] * 1e-6, frame
                    at = begin + length
                    continue
                if wire_format(frame.message_id) is None and frame_length(
                    data, begin + length + _TIME_STAMP.size
                ):
                    at = begin + length  # another dialect's message, with a record right behind it
                    continue
                failed += 1
                if failed > _MOST_FAILED:
                    return
            for byte, start in starts.items():
                if start <= begin:
                    found = data.find(byte, begin + 1)
                    starts[byte] = len(data) + _TIME_STAMP.size if found < 0 else found
            at = min(starts.values()) - _TIME_STAMP.size
        at = min(at, len(data))


class RecordingClock:
    """Turn time stamps that may jump and pause into time from the start that does neither."""

    def __init__(self) -> None:
        self.time_s = 0.0
        self._last_s: float | None = None

    def advance(self, stamp_s: float) -> float:
        """Take the next stamp, return its time."""
        if self._last_s is not None:
            self.time_s += min(max(stamp_s - self._last_s, 0.0), LONGEST_PAUSE_S)
        self._last_s = stamp_s
        return self.time_s
