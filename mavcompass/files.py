"""Files that a person names: recordings have an end, texts are read as far as one goes, results are whole."""

from __future__ import annotations

import hashlib
import os
import shutil
import stat
from collections.abc import Iterator
from contextlib import contextmanager, suppress
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


@contextmanager
def replacing(path: Path, mode: int = 0o666) -> Iterator[Path]:
    """Give a file to write in place of another: an older one stays until the new one is whole.

    What is no plain file in a folder of one's own (a pipe, a device, a link) is written into as it is.
    It is made empty, with `mode`. Raises OSError, nothing being left of the new one.
    """
    is_own = path.is_file() and os.access(path.parent, os.W_OK)
    if path.is_symlink() or (path.exists() and not is_own):
        yield path
        return
    half = path.with_name(path.name + ".part")
    with suppress(FileNotFoundError):
        half.unlink()  # of a program that was killed; a link that somebody laid there is not followed
    os.close(os.open(half, os.O_CREAT | os.O_EXCL | os.O_WRONLY, mode))
    try:
        yield half
        half.replace(path)
    except BaseException:
        with suppress(OSError):
            half.unlink()
        raise


def write_text(path: Path, text: str, what: str = "The result") -> None:
    """Write a text to a file that a person named; see `replacing`. Raises UsageError where that fails."""
    try:
        with replacing(path) as file:
            file.write_text(text, encoding="utf-8")
            if path.is_file() and file != path:
                shutil.copymode(path, file)
    except OSError as error:
        raise UsageError(
            f"{what} could not be written to {path} ({error.strerror}).",
            "Name a file in a folder that you may write to, on a disk with room.",
        ) from error


def sha256_of(path: Path) -> str:
    """Compute a file's checksum, a piece at a time."""
    with path.open("rb") as file:
        return hashlib.file_digest(file, "sha256").hexdigest()
