"""Record what the vehicle says during a calibration as a .tlog, which every tool of the field reads."""

from __future__ import annotations

from pathlib import Path

from mavcompass.installation.private_files import private_folder, write_private
from mavcompass.messages import Incoming
from mavcompass.service.work import clock
from mavcompass.vehicle.wire import FrameWriter

# Ten minutes of a fast link; what comes after is not needed to explain a calibration.
_MOST_BYTES = 64_000_000


class Recorder:
    """Collect frames with their time of arrival, microseconds since 1970, big-endian."""

    def __init__(self) -> None:
        self._writers: dict[tuple[int, int], FrameWriter] = {}
        self._data = bytearray()
        self._offset_s: float | None = None

    def add(self, heard: Incoming) -> None:
        """Append one message."""
        if len(self._data) > _MOST_BYTES:
            return
        if self._offset_s is None:
            self._offset_s = clock.now().timestamp() - heard.time_s
        sender = (heard.system, heard.component)
        if sender not in self._writers:
            self._writers[sender] = FrameWriter(2, None)
        stamp_us = round((heard.time_s + self._offset_s) * 1e6)
        self._data += stamp_us.to_bytes(8, "big")
        self._data += self._writers[sender].write(heard.message, heard.system, heard.component)

    def save(self, path: Path) -> None:
        """Write the file. Raises OSError."""
        private_folder(path.parent)
        write_private(path, self._data, flushed=False)
