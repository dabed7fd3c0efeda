"""Measure the memory of reading large recordings, in a process that does nothing else.

    scripts/bench memory [-- --megabytes 1000]

The recordings are those that `readers.py` makes, their messages repeated up to the size.
"""

from __future__ import annotations

import argparse
import json
import resource
import subprocess
import sys
import tempfile
import time
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from readers import MADE_MESSAGES, make_dataflash, make_tlog

QUICK = ("--megabytes", "50")


def main(argv: Sequence[str] | None = None) -> dict[str, Any]:
    """Measure both formats; return the figures."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--megabytes", type=int, default=300)
    parser.add_argument("--read", type=Path, help=argparse.SUPPRESS)
    options = parser.parse_args(argv)
    if options.read:
        report_memory(options.read)
        return {}
    with tempfile.TemporaryDirectory() as folder:
        made = [
            make_tlog(Path(folder) / "made.tlog", MADE_MESSAGES),
            make_dataflash(Path(folder) / "made.bin", MADE_MESSAGES),
        ]
        figures = [measure_memory(path, options.megabytes) for path in made]
    checks = [
        {
            "what": f"peak MB for {figure['file_mb']:.0f} MB {figure['suffix']}",
            "value": figure["peak_mb"],
            "at_most": figure["allowed_mb"],
        }
        for figure in figures
    ]
    return {"files": figures, "checks": checks}


def measure_memory(made: Path, megabytes: int) -> dict[str, Any]:
    """Repeat a made log's messages up to the size and read it in a process of its own."""
    content = made.read_bytes()
    start = max(content.rfind(b"\xa3\x95\x80") + 89, 0) if made.suffix == ".bin" else 0
    with tempfile.NamedTemporaryFile(suffix=made.suffix, dir=made.parent) as file:
        file.write(content[:start])
        for _ in range(max(1, megabytes * 1_000_000 // len(content))):
            file.write(content[start:])
        file.flush()
        command = [sys.executable, __file__, "--read", file.name]
        figures: dict[str, Any] = json.loads(subprocess.run(command, capture_output=True, check=True).stdout)
        size_mb = Path(file.name).stat().st_size / 1e6
    allowed = 1.5 * figures["columns_mb"] + 100.0
    print(
        f"\nmemory, {size_mb:.0f} MB {made.suffix}: peak {figures['peak_mb']:.0f} MB, "
        f"columns {figures['columns_mb']:.0f} MB (1.5 x columns + 100 MB = {allowed:.0f} MB), "
        f"{figures['seconds']:.1f} s"
    )
    return {"file_mb": size_mb, "suffix": made.suffix, "allowed_mb": allowed, **figures}


def report_memory(path: Path) -> None:
    """Read a recording; print the peak of resident memory and the size of the Track's columns."""
    from mavcompass.logs import read_track
    from mavcompass.track import Series

    start = time.process_time()
    track = read_track(path)
    taken = time.process_time() - start
    series = [getattr(track, name) for name in track.__slots__]
    series = [one for one in series if isinstance(one, Series)] + [
        c.reported for c in track.compasses.values()
    ]
    arrays = {id(array): array for one in series for array in (one.time_s, one.values)}
    columns_mb = sum(array.nbytes for array in arrays.values()) / 1e6
    peak_mb = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss * 1024 / 1e6
    print(json.dumps({"peak_mb": peak_mb, "columns_mb": columns_mb, "seconds": taken}))


if __name__ == "__main__":
    main()
