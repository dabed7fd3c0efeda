"""Make the pictures of README and documentation from the simulator, light and dark, into docs/pictures.

    .venv/bin/python scripts/documentation/pictures.py

Needs Chromium (Debian: apt install chromium). Nothing in them is drawn by hand, so that they show what is.
"""

from __future__ import annotations

import html
import os
import re
import subprocess
import sys
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

PROJECT = Path(__file__).resolve().parents[2]
sys.path.insert(0, str(PROJECT / "tests" / "service" / "web"))

import ground_station  # noqa: E402
from chromium import Page, find_chromium  # noqa: E402

PICTURES = PROJECT / "docs" / "pictures"
PHONE, REPORT, TERMINAL, STATION = (390, 844), (1000, 760), (900, 560), (980, 560)
MOST_BYTES = 150_000
TERMINAL_COMMAND = "calibrate sim:rover --yes"
SHOWN = PICTURES / "terminal.txt"  # by which a test finds the picture stale
_TERMINAL = """<meta charset="utf-8"><style>
:root {{ color-scheme: light dark }}
body {{ margin: 0; padding: 14px 18px; background: light-dark(#f8fafc, #0f172a) }}
pre {{ margin: 0; font: 13px/1.5 "DejaVu Sans Mono", monospace; white-space: pre-wrap;
       color: light-dark(#0f172a, #e2e8f0) }}
b {{ color: light-dark(#0f766e, #5eead4) }}
</style><pre><b>$ ./scripts/mavcompass {command}</b>
{output}</pre>"""


def run(folder: Path, *words: str) -> str:
    """Run a command of the program in a folder and return all that it says."""
    done = subprocess.run(
        [sys.executable, "-m", "mavcompass", *words],
        cwd=folder,
        env=environment(),
        capture_output=True,
        text=True,
        check=True,
    )
    return done.stderr + done.stdout


def environment() -> dict[str, str]:
    """Let the program keep its files in the folder where it works."""
    called = {"MAVCOMPASS_CALLED": "./scripts/mavcompass", "MAVCOMPASS_UNDO_DIR": "undo"}
    return {**os.environ, **called, "PYTHONPATH": str(PROJECT)}


def terminal_text(folder: Path) -> str:
    """Return what the terminal's picture shows; what differs from day to day is spelt the same.

    So is how often one is told to wait, once a second of this computer's.
    """
    said = re.sub(
        r"^(All is written;.*\n)(?:All is written;.*\n)*",
        r"\1",
        run(folder, *TERMINAL_COMMAND.split()),
        flags=re.M,
    )
    return re.sub(r"undo/\d+-\d+-", "undo/00000001-20260501100000-", said)


def write_pages(folder: Path) -> dict[str, tuple[Path, tuple[int, int]]]:
    """Write the pages that are looked at, with the size of the window."""
    said = terminal_text(folder)
    SHOWN.write_text(said, encoding="utf-8")
    terminal = folder / "terminal.html"
    shown = _TERMINAL.format(command=TERMINAL_COMMAND, output=html.escape(said))
    terminal.write_text(shown, encoding="utf-8")
    run(folder, "calibrate", "sim:boat", "--yes", "--report", "calibration.html")
    record_flight(folder / "flight.csv")
    run(folder, "gap", "diagnose", "flight.csv", "--report", "gap.html")
    station = folder / "station.html"
    station.write_text(ground_station.page(folder, environment()), encoding="utf-8")
    return {
        "terminal": (terminal, TERMINAL),
        "ground-station": (station, STATION),
        "calibration": (folder / "calibration.html", REPORT),
        "gap": (folder / "gap.html", REPORT),
    }


def record_flight(path: Path) -> None:
    """Record a simulated flight beside a magnet that the calibration does not know."""
    from mavcompass.gap.trial.cases import Recipe, make_track
    from mavcompass.logs import write_track_csv
    from mavcompass.simulation import effects

    magnet = effects.parse("hard_iron:x=28,y=-46,z=12")
    write_track_csv(make_track(Recipe("figure-8", duration_s=90.0, seed=51), [magnet]), path)


@contextmanager
def service(folder: Path) -> Iterator[str]:
    """Run the service with a simulated rover; gives its page's address."""
    command = ["serve", "sim:rover", "--http", "127.0.0.1:0", "--storage", str(folder / "service")]
    with subprocess.Popen(
        [sys.executable, "-m", "mavcompass", *command],
        cwd=folder,
        env=environment(),
        stdout=subprocess.PIPE,
        text=True,
    ) as running:
        try:
            assert running.stdout is not None
            for line in running.stdout:
                if found := re.search(r"http://\S+", line):
                    yield found[0]
                    break
        finally:
            running.terminate()


def main() -> None:
    """Make all of them."""
    program = find_chromium()
    if program is None:
        sys.exit("pictures: there is no Chromium here (Debian: apt install chromium).")
    with tempfile.TemporaryDirectory() as name, service(Path(name)) as url:
        pages = write_pages(Path(name))
        connected = "document.querySelector('#status').className.includes('on')"
        for scheme in ("light", "dark"):
            for picture, (page, size) in pages.items():
                take(program, page.as_uri(), size, scheme, picture, "true")
            take(program, url, PHONE, scheme, "service", connected)


def take(program: str, url: str, size: tuple[int, int], scheme: str, picture: str, ready: str) -> None:
    """Take one picture when a condition holds in the page."""
    page = Page(program, *size)
    try:
        page.show_on(*size, dark=scheme == "dark")
        page.open(url)
        page.wait(ready)
        file = PICTURES / f"{picture}-{scheme}.png"
        page.screenshot(file)
    finally:
        page.close()
    bytes_now = file.stat().st_size
    print(f"{file.relative_to(PROJECT)}  {bytes_now / 1000:.0f} kB")
    if bytes_now > MOST_BYTES:
        sys.exit(f"pictures: {file.name} is larger than {MOST_BYTES / 1000:.0f} kB.")


if __name__ == "__main__":
    main()
