"""Read PX4's own log (ULog, .ulg) into a Track."""

from __future__ import annotations

import contextlib
import io
from pathlib import Path
from typing import Any

import numpy as np

from mavcompass.errors import BadRecording, NoMagnetometer
from mavcompass.installation.parts import require
from mavcompass.logs.common import Seen, changes
from mavcompass.logs.formats.ulog.bounded import bounded_ulog, open_forward
from mavcompass.logs.formats.ulog.columns import TOPICS, columns, utc_offset_s, vehicle
from mavcompass.logs.formats.ulog.compasses import MAG_TOPICS, compasses
from mavcompass.track import Track

_MICRO = 1.0e-6


def read_ulog(path: Path) -> Track:
    """Read a ULog through pyulog.

    Raises UsageError where pyulog is not installed, BadRecording where the file has no magnetometer or
    is too damaged.
    """
    log = _parse(path)
    topics: dict[str, list[Any]] = {}
    for data in sorted(log.data_list, key=lambda data: int(data.multi_id)):
        if len(data.data.get("timestamp", ())):
            topics.setdefault(data.name, []).append(data)
    history = changes(_parameters(log), [0.0])
    parameters = {change.name: change.value for change in history}
    found, notes = compasses(topics, history, parameters)
    if not found:
        raise NoMagnetometer(
            f"{path} holds no magnetometer: none of {', '.join(MAG_TOPICS)} has samples.",
            "Set SDLOG_PROFILE to include the sensors (bit 0 or 4) and record again.",
            parameters,
        )
    measured: dict[str, Any] = dict(columns(topics, parameters))
    return Track(
        source=str(path),
        autopilot="px4",
        vehicle=vehicle(topics),
        compasses=found,
        utc_offset_s=utc_offset_s(topics),
        parameters=parameters,
        notes=(*_notes_about_the_file(log), *notes),
        **measured,
    )


def _parse(path: Path) -> Any:
    require("A PX4 recording (.ulg)")
    try:
        # pyulog prints what it stumbles over; what matters is told in the notes.
        with contextlib.redirect_stdout(io.StringIO()), open_forward(path) as file:
            return bounded_ulog()(file, [*MAG_TOPICS, *TOPICS])
    except Exception as error:
        # On a damaged file pyulog raises whatever its parsing runs into.
        raise BadRecording(
            f"{path} is a ULog that cannot be read: {error or type(error).__name__}.",
            "Copy it from the autopilot's card again, or give another recording.",
        ) from None


def _parameters(log: Any) -> list[Seen]:
    first = [(0, name, value) for name, value in log.initial_parameters.items()]
    # A damaged type makes a parameter's value anything but a number.
    return [
        Seen(int(us) * _MICRO, name, float(value), announced=number >= len(first))
        for number, (us, name, value) in enumerate([*first, *log.changed_parameters])
        if isinstance(value, int | float)
    ]


def _notes_about_the_file(log: Any) -> list[str]:
    notes = []
    if log.file_corruption:
        notes.append("The file is damaged; what could be read was read.")
    if log.dropouts:
        lost_s = float(np.sum([dropout.duration for dropout in log.dropouts])) * 1.0e-3
        notes.append(f"The logger dropped out {len(log.dropouts)} times, for {lost_s:.1f} s in all.")
    return notes
