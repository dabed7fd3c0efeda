"""What is written to a file that a person names: whole, or not at all."""

from __future__ import annotations

import errno
import os
import threading
from pathlib import Path

import pytest

from mavcompass.errors import UsageError
from mavcompass.files import replacing, write_text
from mavcompass.installation.private_files import write_private


def write_half(path: Path) -> None:
    with replacing(path) as file:
        file.write_text("new, but")
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))


def test_a_full_disk_leaves_the_older_file_or_none(tmp_path: Path) -> None:
    (kept := tmp_path / "kept.param").write_text("old")
    for path in (kept, tmp_path / "none.param"):
        with pytest.raises(OSError, match="No space"):
            write_half(path)
    assert {path.name: path.read_text() for path in tmp_path.iterdir()} == {"kept.param": "old"}


def test_what_cannot_be_written_is_told() -> None:
    with pytest.raises(UsageError, match=r"The report could not be written to /dev/full \(No space left"):
        write_text(Path("/dev/full"), "much", "The report")


def test_a_pipe_and_a_link_stay_what_they_are(tmp_path: Path) -> None:
    os.mkfifo(pipe := tmp_path / "pipe")
    (link := tmp_path / "link").symlink_to(target := tmp_path / "target")
    writer = threading.Thread(target=write_text, args=(pipe, "through"))
    writer.start()
    assert pipe.read_text() == "through"
    writer.join()
    write_text(link, "new")
    assert link.is_symlink() and target.read_text() == "new"


def test_rights_stay_and_private_is_private(tmp_path: Path) -> None:
    (path := tmp_path / "result.json").write_text("old")
    path.chmod(0o640)
    write_text(path, "new")
    assert path.stat().st_mode & 0o777 == 0o640
    write_private(path, "secret")
    assert path.stat().st_mode & 0o777 == 0o600 and path.read_text() == "secret"


def test_a_link_that_somebody_laid_beside_it_is_not_followed(tmp_path: Path) -> None:
    (victim := tmp_path / "victim").write_text("mine")
    (tmp_path / "result.json.part").symlink_to(victim)
    write_text(tmp_path / "result.json", "new")
    assert victim.read_text() == "mine" and (tmp_path / "result.json").read_text() == "new"
