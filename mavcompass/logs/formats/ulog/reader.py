"""Read PX4's own log (ULog, .ulg) into a Track."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from mavcompass.errors import NoMagnetometer
from mavcompass.logs.common import changes, damage
from mavcompass.logs.formats.ulog.columns import TOPICS, columns, utc_offset_s, vehicle
from mavcompass.logs.formats.ulog.compasses import MAG_TOPICS, compasses
from mavcompass.logs.formats.ulog.messages import Topic, ULogContents, read_messages
from mavcompass.track import Track


def read_ulog(path: Path) -> Track:
    """Read a ULog. Raises BadRecording where the file has no magnetometer or is none."""
    contents = read_messages(path, {*MAG_TOPICS, *TOPICS})
    topics: dict[str, list[Topic]] = {}
    for topic in contents.topics:
        topics.setdefault(topic.name, []).append(topic)
    history = changes(contents.parameters, [0.0])
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
        notes=(*_notes_about_the_file(contents), *notes),
        **measured,
    )


def _notes_about_the_file(contents: ULogContents) -> list[str]:
    notes = damage(contents.skipped_bytes, contents.skipped_stretches, f"{contents.messages} messages")
    lost = contents.dropouts_ms
    if lost:
        notes.append(f"The logger dropped out {len(lost)} times, for {sum(lost) * 1.0e-3:.1f} s in all.")
    return notes
