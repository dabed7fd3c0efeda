"""A few hundred damaged recordings, tens of thousands with `--more 50`.

A message that was never sent passes a telemetry log's checksum once in 65 536 damaged ones: one in a long
run is the checksum's and not the reader's.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from mutations import checked_rows, mutate, originals, read_or_refuse

FILES = 80


@pytest.mark.parametrize("suffix", [".tlog", ".bin", ".log", ".csv", ".ulg"])
def test_damaged_recordings_are_read_as_far_as_they_go_or_refused(
    tmp_path: Path, suffix: str, more: int
) -> None:
    content = originals(tmp_path / "originals")[suffix]
    path = tmp_path / f"damaged{suffix}"
    read = 0
    for seed in range(more * FILES):
        path.write_bytes(mutate(content, np.random.default_rng(seed)))
        read += read_or_refuse(path) is not None
    assert read > 0


def test_no_message_is_read_that_was_not_sent(tmp_path: Path, more: int) -> None:
    content = originals(tmp_path / "originals")[".tlog"]
    sent = checked_rows(tmp_path / "originals" / "original.tlog")
    path = tmp_path / "damaged.tlog"
    for seed in range(more * FILES):
        path.write_bytes(mutate(content, np.random.default_rng([1000, seed])))
        assert checked_rows(path) <= sent, seed
