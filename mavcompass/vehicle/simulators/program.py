"""A simulator's program: told of its flight, started in a folder of its own, ended with all it started."""

from __future__ import annotations

import os
import signal
import subprocess
from collections.abc import Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Self

from mavcompass.errors import UsageError

_END_S = 5.0
_SAYS_S = 30.0
_LAST_LINES = 3
_OUTPUT_FILE = "simulator.txt"


@dataclass(frozen=True, slots=True)
class Flight:
    """Hold where a flight begins, and of what.

    Attributes:
        kind: "rover", "boat" or "copter". pivots: it turns on the spot.
        home: latitude deg, longitude deg, altitude m; None for anywhere.
        heading_deg: where the nose points.
    """

    kind: str
    pivots: bool
    home: tuple[float, float, float] | None
    heading_deg: float


class RunningProgram:
    """Be a running program. Use it as a context manager: at the end it and its children are gone.

    What it says goes to a file in its folder.
    """

    def __init__(
        self, command: Sequence[str | Path], folder: Path, environment: Mapping[str, str] | None = None
    ) -> None:
        """Start it in `folder`, without a terminal, in this environment (default: ours).

        Raises UsageError where it cannot be started.
        """
        self._output = folder / _OUTPUT_FILE
        with self._output.open("ab") as said:
            try:
                # A session of its own, so that Ctrl-C reaches us alone and we end it in order.
                self._process = subprocess.Popen(
                    [str(word) for word in command],
                    cwd=folder,
                    stdin=subprocess.DEVNULL,
                    stdout=said,
                    stderr=subprocess.STDOUT,
                    start_new_session=True,
                    env=environment,
                )
            except OSError as error:
                raise UsageError(*_cannot_start(command[0], error)) from error

    def __enter__(self) -> Self:
        """Return itself."""
        return self

    def __exit__(self, *_: object) -> None:
        """End it."""
        self.end()

    @property
    def has_ended(self) -> bool:
        """Tell whether it has ended by itself."""
        return self._process.poll() is not None

    def last_words(self) -> str:
        """Return the last lines that it said, for a person."""
        lines = self._output.read_text(encoding="utf-8", errors="replace").split("\n")
        kept = [line.strip() for line in lines if line.strip()]
        return " / ".join(kept[-_LAST_LINES:])

    def end(self) -> None:
        """Ask it to end, and make it end where it does not; calling it again does nothing."""
        for number in (signal.SIGTERM, signal.SIGKILL):
            with suppress(ProcessLookupError):
                os.killpg(self._process.pid, number)
            with suppress(subprocess.TimeoutExpired):
                self._process.wait(_END_S)
                break
        # What it started and left behind is of the same group.
        with suppress(ProcessLookupError, PermissionError):
            os.killpg(self._process.pid, signal.SIGKILL)


def help_of(program: Path) -> str:
    """Return what a program says when asked for help.

    Raises UsageError where there is no such program, or it cannot be run.
    """
    if not program.is_file():
        raise UsageError(
            f"There is no program {program}.",
            "Give --sitl the simulator's own program, such as ardupilot/build/sitl/bin/arducopter.",
        )
    if not os.access(program, os.X_OK):
        raise UsageError(
            f"{program} is not a program that may be run.",
            f"Make it one (chmod +x {program}), or name another.",
        )
    try:
        asked = subprocess.run(
            [program.absolute(), "--help"],
            stdin=subprocess.DEVNULL,
            capture_output=True,
            timeout=_SAYS_S,
            check=False,
        )
    except subprocess.TimeoutExpired as error:
        raise UsageError(
            f"{program} --help did not end within {_SAYS_S:.0f} s.",
            "Name the simulator's own program; on a busy computer, run again.",
        ) from error
    except OSError as error:
        raise UsageError(*_cannot_start(program, error)) from error
    return (asked.stdout + asked.stderr).decode("utf-8", "replace")


def _cannot_start(program: str | Path, error: OSError) -> tuple[str, str]:
    return (
        f"{program} could not be started ({error.strerror}).",
        "Check that it was built for this computer, then run again.",
    )
