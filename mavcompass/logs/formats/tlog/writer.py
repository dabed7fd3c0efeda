"""TlogWriter: record MAVLink frames as ground stations do."""

from __future__ import annotations

from pathlib import Path
from struct import Struct
from typing import BinaryIO

_TIME_STAMP = Struct(">Q")


class TlogWriter:
    """Write a telemetry log (.tlog): each frame after its time, eight bytes, microseconds of Unix time.

    Use it as a context manager, or call `close`. What was appended is complete on disk after `flush`.
    """

    def __init__(self, path: str | Path) -> None:
        """Create the file; raises OSError where that is not possible."""
        self._file: BinaryIO = Path(path).open("wb")

    def append(self, time_unix_us: int, frame: bytes) -> None:
        """Append one whole MAVLink frame, as it was on the wire."""
        self._file.write(_TIME_STAMP.pack(time_unix_us) + frame)

    def flush(self) -> None:
        """Hand everything to the operating system."""
        self._file.flush()

    def close(self) -> None:
        """Finish the file."""
        self._file.close()

    def __enter__(self) -> TlogWriter:
        """Return the writer itself."""
        return self

    def __exit__(self, *_: object) -> None:
        """Finish the file."""
        self.close()
