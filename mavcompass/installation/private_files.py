"""Files that only their owner can read, and that are whole or absent."""

from __future__ import annotations

import fcntl
import os
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

from mavcompass.files import replacing


def state_directory() -> Path:
    """Return where the program keeps what must outlive it: mavcompass in the XDG state folder."""
    state = os.environ.get("XDG_STATE_HOME") or Path.home() / ".local" / "state"
    return Path(state) / "mavcompass"


def private_folder(folder: Path) -> None:
    """Make a folder that its owner alone can enter; one that is there stays as it is: it may be anybody's."""
    folder.mkdir(mode=0o700, parents=True, exist_ok=True)


@contextmanager
def locked(folder: Path) -> Iterator[None]:
    """Keep other processes that do so, too, from changing what is in a folder meanwhile."""
    handle = os.open(folder, os.O_RDONLY)
    try:
        fcntl.flock(handle, fcntl.LOCK_EX)
        yield
    finally:
        os.close(handle)


def private_file(path: Path) -> None:
    """Make an empty file that its owner alone can read; one that is there and is his own is closed to others.

    Raises OSError.
    """
    os.close(os.open(path, os.O_CREAT | os.O_WRONLY, 0o600))
    with suppress(OSError):
        path.chmod(0o600)


def write_private(path: Path, content: str | bytes | bytearray, flushed: bool = True) -> None:
    """Replace a file at once, and see it onto the disk: after a power cut it is whole or absent.

    Raises OSError, nothing being left of the new one.
    """
    with replacing(path, 0o600) as half, half.open("wb") as file:
        file.write(content.encode() if isinstance(content, str) else content)
        file.flush()
        if flushed:
            os.fsync(file.fileno())
    if flushed:
        folder = os.open(path.parent, os.O_RDONLY)
        try:
            os.fsync(folder)  # the file's name, too
        finally:
            os.close(folder)
