"""What can go wrong, named by what the person can do about it.

MavCompassError
 +-- UsageError          2  the command or the configuration is wrong: correct it and call again
 +-- LinkError           3  nothing can be heard or said
 |    +-- NoVehicle          no autopilot's heartbeat was heard: check the address, the cable, the power
 |    +-- LinkLost           it was heard and fell silent: bring the link back and run again
 |    +-- NoReply            it is alive but did not answer a request: it may not know the request
 +-- BadRecording        4  the file cannot be used: give another recording
 |    +-- NoMagnetometer     no compass was recorded; what else it tells of the vehicle is kept
 +-- PoorCalibration     5  the data do not give a calibration worth writing: its reasons say what to change
 +-- WriteFailed         6  parameters could not be written: undone, or `restore_command` puts them back
 +-- Refused             7  stopped for safety: the vehicle, the pilot or this program said no

A calibration that is written while the autopilot still steers by another heading ends with 8, and no error.

Every message is one sentence about what happened and what it means; `remedy` is the next step.
"""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

from mavcompass.printable import printable


class MavCompassError(Exception):
    """Tell a person what happened; `remedy` says what to do next, `exit_code` is the program's.

    Names of files and what a vehicle said may stand in it as they are: they are made printable here. Only
    what is a list has `lines`, below its first sentence.
    """

    exit_code = 1

    def __init__(self, what: str, remedy: str = "", lines: tuple[str, ...] = ()) -> None:
        super().__init__(what)
        self.what = "\n  ".join(map(printable, (what, *lines))) + ("\n" if lines else "")
        self.remedy = printable(remedy)

    def __str__(self) -> str:
        return f"{self.what} {self.remedy}".strip()


class UsageError(MavCompassError):
    """Report a wrong argument, address or configuration."""

    exit_code = 2


class LinkError(MavCompassError):
    """Report that nothing can be heard or said on the link."""

    exit_code = 3


class NoVehicle(LinkError):
    """Report that no autopilot was heard."""


class LinkLost(LinkError):
    """Report that the vehicle was heard and fell silent."""


class NoReply(LinkError):
    """Report that a living vehicle left a request unanswered."""


class BadRecording(MavCompassError):
    """Report a recording from which nothing useful can be read."""

    exit_code = 4


class NoMagnetometer(BadRecording):
    """Report a recording without a compass's readings; it may hold the vehicle's parameters."""

    def __init__(self, what: str, remedy: str, parameters: Mapping[str, float] | None = None) -> None:
        super().__init__(what, remedy)
        self.parameters = dict(parameters or {})


class PoorCalibration(MavCompassError):
    """Report data that do not give a calibration worth writing."""

    exit_code = 5

    def __init__(self, what: str, remedy: str = "", reasons: tuple[str, ...] = ()) -> None:
        super().__init__(what, remedy)
        self.reasons = reasons


class WriteFailed(MavCompassError):
    """Report parameters that could not be written, and how the old ones come back."""

    exit_code = 6

    def __init__(
        self,
        what: str,
        remedy: str = "",
        undo_file: Path | None = None,
        restore_command: str = "",
    ) -> None:
        super().__init__(what, remedy)
        self.undo_file = undo_file
        self.restore_command = restore_command


class Refused(MavCompassError):
    """Report a stop for safety."""

    exit_code = 7
