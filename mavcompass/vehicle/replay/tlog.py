"""The frames of a telemetry log, one after the other, as they were on the wire, and their time."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from struct import Struct

from mavcompass.errors import BadRecording, UsageError
from mavcompass.files import require_file
from mavcompass.logs.common.chunks import read_chunks
from mavcompass.logs.formats.tlog.frames import LONGEST_RECORD, PADDING, find_frames
from mavcompass.vehicle.wire.framing import Frame, split_frame

_TIME_STAMP = Struct(">Q")
_PIECE = 1 << 20
# Nobody waits through the night between two power-ups.
LONGEST_PAUSE_S = 10.0


def tlog_frames(path: Path) -> Iterator[tuple[float, Frame]]:
    """Hand out the good frames of a .tlog with their time stamps (Unix seconds, as recorded).

    What is damaged is skipped, and so are messages that the dialect does not have.
    Raises UsageError for a file that is not there, BadRecording for an empty one.
    """
    require_file(path)
    try:
        if not path.stat().st_size:
            raise BadRecording(f"{path} is empty.", "Give another recording.")
        covered = 0
        for chunk in read_chunks(path, longest_record=LONGEST_RECORD, padding=PADDING, chunk_bytes=_PIECE):
            good, _ = find_frames(chunk, max(covered - chunk.offset, 0))
            data = chunk.data.tobytes()
            for start, end in zip(good.start.tolist(), good.end.tolist(), strict=True):
                stamp_us = _TIME_STAMP.unpack_from(data, start - _TIME_STAMP.size)[0]
                yield stamp_us * 1e-6, split_frame(data[start:end])
                covered = chunk.offset + end
    except OSError as error:
        reason = error.strerror or str(error)
        raise UsageError(f"{path} cannot be read: {reason}.", "Check the file's name.") from error


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
