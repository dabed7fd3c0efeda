"""Files that a person names: recordings are those that have an end, texts are read as far as a text goes."""

from __future__ import annotations

import hashlib
import stat
from pathlib import Path

from mavcompass.errors import UsageError

# The largest of them, a diagnosis, has some hundred kilobytes.
_MOST_TEXT_BYTES = 16 << 20


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
        raise UsageError(f"{path} is a folder.", "Give one file in it.")
    if not stat.S_ISREG(mode):
        raise UsageError(f"{path} is a pipe or device, which has no end.", "Give a file.")


def read_text(path: Path, encoding: str = "utf-8") -> str:
    """Read a text: parameters, a configuration, a diagnosis; also what another program writes into a pipe.

    Raises UsageError for what is longer than any, OSError and UnicodeDecodeError as `Path.read_text`.
    """
    with path.open("rb") as file:
        content = file.read(_MOST_TEXT_BYTES + 1)
    if len(content) > _MOST_TEXT_BYTES:
        raise UsageError(
            f"{path} has more than {_MOST_TEXT_BYTES >> 20} MB.", "Give a file of the kind asked for."
        )
    return content.decode(encoding)


def sha256_of(path: Path) -> str:
    """Compute a file's checksum, a piece at a time."""
    with path.open("rb") as file:
        return hashlib.file_digest(file, "sha256").hexdigest()
