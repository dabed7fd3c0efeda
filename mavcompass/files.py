"""Files that a person names: only those that have an end are read."""

from __future__ import annotations

import stat
from pathlib import Path

from mavcompass.errors import UsageError


def require_file(path: Path) -> None:
    """Raise UsageError for what is no file: not there, a folder, or without an end (a pipe, a device).

    It is not opened: a pipe would wait for a writer, and for ever.
    """
    try:
        mode = path.stat().st_mode
    except FileNotFoundError:
        raise UsageError(f"There is no file {path}.", "Check the name.") from None
    except OSError as error:
        raise UsageError(f"{path} cannot be read: {error.strerror}.", "Check its permissions.") from None
    if stat.S_ISDIR(mode):
        raise UsageError(f"{path} is a folder.", "Give one recording in it.")
    if not stat.S_ISREG(mode):
        raise UsageError(f"{path} is a pipe or device, which has no end.", "Give a file.")
